//! Number formats of the three processors.

/// The processor whose number formats a C3D file uses.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Processor {
    /// Little-endian, IEEE floats (type 84).
    Intel,
    /// Little-endian integers, VAX F floats (type 85).
    Dec,
    /// Big-endian, IEEE floats (type 86).
    Mips,
}

impl Processor {
    pub(super) fn from_type(byte: u8) -> Option<Self> {
        match byte {
            84 => Some(Self::Intel),
            85 => Some(Self::Dec),
            86 => Some(Self::Mips),
            _ => None,
        }
    }

    /// The 16-bit word at `place`, none beyond the end.
    pub(super) fn word(self, bytes: &[u8], place: usize) -> Option<u16> {
        let word = *bytes.get(place..)?.first_chunk()?;
        Some(match self {
            Self::Intel | Self::Dec => u16::from_le_bytes(word),
            Self::Mips => u16::from_be_bytes(word),
        })
    }

    /// The 32-bit float at `place`, none beyond the end.
    pub(super) fn float(self, bytes: &[u8], place: usize) -> Option<f32> {
        let float: [u8; 4] = *bytes.get(place..)?.first_chunk()?;
        Some(match self {
            Self::Intel => f32::from_le_bytes(float),
            Self::Mips => f32::from_be_bytes(float),
            Self::Dec => vax_float(float),
        })
    }
}

/// A VAX F float: two little-endian words, the high one first; the fraction is 0.1f instead of 1.f
/// and the exponent is biased by 128, so the IEEE reading is 4 times the value.
fn vax_float([a, b, c, d]: [u8; 4]) -> f32 {
    let bits = u32::from_le_bytes([c, d, a, b]);
    let exponent = (bits >> 23 & 0xff) as i32;
    if exponent == 0 {
        return 0.0;
    }
    let fraction = 1.0 + f64::from(bits & 0x7f_ffff) / f64::from(1 << 23);
    let sign = if bits >> 31 == 1 { -1.0 } else { 1.0 };
    (sign * fraction * f64::from(exponent - 129).exp2()) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vax_floats_are_a_quarter_of_their_ieee_reading() {
        // 1.0, -6.25 and 0.1 in VAX F, from the VAX Architecture Reference Manual's layout.
        let known = [
            ([0x80, 0x40, 0, 0], 1.0),
            ([0xc8, 0xc1, 0, 0], -6.25),
            ([0xcc, 0x3e, 0xcd, 0xcc], 0.1),
            ([0, 0, 0, 0], 0.0),
        ];
        for (bytes, value) in known {
            assert_eq!(Processor::Dec.float(&bytes, 0), Some(value));
        }
    }

    #[test]
    fn words_follow_the_byte_order_and_end_with_the_bytes() {
        let bytes = [1, 2, 3];
        assert_eq!(Processor::Intel.word(&bytes, 0), Some(0x0201));
        assert_eq!(Processor::Dec.word(&bytes, 1), Some(0x0302));
        assert_eq!(Processor::Mips.word(&bytes, 1), Some(0x0203));
        assert_eq!(Processor::Mips.word(&bytes, 2), None);
        assert_eq!(Processor::Intel.word(&bytes, usize::MAX), None);
        assert_eq!(Processor::Intel.float(&bytes, 0), None);
    }
}
