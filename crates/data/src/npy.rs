//! `.npy` arrays: reading with every promise of the header checked, and writing.
//!
//! A file is read whole, but never more of it than an array of [`MAX_FRAMES`] could fill, and
//! nothing is allocated on the word of a header.

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;

use kinegrad_motion::{Motion, phrase::CHANNELS};
use npyz::{DType, NpyHeader, Order, WriterBuilder};

use crate::{Error, FileError, atomic};

/// Most frames a phrase or song may have: two hours at 30 frames per second. A longer array is
/// refused before it is read.
pub const MAX_FRAMES: usize = 216_000;

/// NumPy refuses longer headers too.
const MAX_HEADER_BYTES: usize = 10_000;

/// An array in C order.
#[derive(Debug, PartialEq)]
pub struct Array {
    /// Length of each axis.
    pub shape: Vec<usize>,
    /// Values, last axis fastest.
    pub values: Vec<f32>,
}

/// Reads the array of float32 or float64 numbers in the `.npy` file at `path`.
///
/// # Errors
/// [`FileError`] for a file that cannot be read or is no such array.
pub fn read_array(path: &Path) -> Result<Array, FileError> {
    let bytes = read_bounded(path, MAX_ARRAY_BYTES)?;
    parse(&bytes, &path.display().to_string())
}

/// Writes an array of this shape as little-endian float32, whole or not at all.
///
/// # Errors
/// [`Error::Io`].
pub fn write_values(path: &Path, shape: &[usize], values: &[f32]) -> Result<(), Error> {
    atomic::write(path, |writer| {
        write_array(&mut *writer, shape, values)?;
        writer.flush()
    })
}

/// The longest file of an array that is no motion: 4096 numbers squared, and a header.
const MAX_ARRAY_BYTES: u64 = 8 * 4096 * 4096 + MAX_HEADER_BYTES as u64;

/// The longest motion file.
pub(crate) const MAX_MOTION_BYTES: u64 = max_bytes(CHANNELS);

/// Most bytes that an array with `rows` values per frame may have in its file.
pub(crate) const fn max_bytes(rows: usize) -> u64 {
    (rows * MAX_FRAMES * 8 + MAX_HEADER_BYTES + 12) as u64
}

/// Reads a motion: `[frames, 25]`, at least two frames, as the dataset stores it.
///
/// # Errors
/// [`FileError`] for a file that cannot be read, another dtype or shape, a cut-off file. Numbers
/// that are not finite pass: they are refused where a phrase is read.
pub fn read_motion(path: &Path) -> Result<Motion, FileError> {
    let bytes = read_bounded(path, MAX_MOTION_BYTES)?;
    parse_motion(&bytes, &path.display().to_string())
}

/// The bytes of the file at `path`, at most one more than `limit`.
fn read_bounded(path: &Path, limit: u64) -> Result<Vec<u8>, FileError> {
    let mut bytes = Vec::new();
    File::open(path)
        .and_then(|file| file.take(limit + 1).read_to_end(&mut bytes))
        .map_err(|reason| FileError::Read {
            file: path.display().to_string(),
            reason: reason.to_string(),
        })?;
    Ok(bytes)
}

/// Parses the bytes of a motion's `.npy` file; `file` names it in errors.
///
/// # Errors
/// As [`read_motion`].
pub fn parse_motion(bytes: &[u8], file: &str) -> Result<Motion, FileError> {
    let array = parse(bytes, file)?;
    let shape = array.shape;
    let refused = || FileError::Shape {
        file: file.to_owned(),
        found: format!("{shape:?}"),
        allowed: format!("[frames, {CHANNELS}] with 2 to {MAX_FRAMES} frames"),
    };
    match shape[..] {
        [frames, CHANNELS] if (2..=MAX_FRAMES).contains(&frames) => {
            Motion::new(array.values).map_err(|_| refused())
        }
        _ => Err(refused()),
    }
}

/// Writes `motion` as `[frames, 25]` little-endian float32 in C order, whole or not at all.
///
/// # Errors
/// [`Error::Io`].
pub fn write_motion(path: &Path, motion: &Motion) -> Result<(), Error> {
    atomic::write(path, |writer| writer.write_all(&motion_bytes(motion)))
}

/// The bytes of the `.npy` file that holds `motion`.
pub(crate) fn motion_bytes(motion: &Motion) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_array(&mut bytes, &[motion.frames(), CHANNELS], motion.as_slice())
        .expect("memory takes every byte");
    bytes
}

/// Writes `values` as a `.npy` stream of this `shape`.
pub(crate) fn write_array(
    writer: impl Write,
    shape: &[usize],
    values: &[f32],
) -> std::io::Result<()> {
    let shape: Vec<u64> = shape.iter().map(|&length| length as u64).collect();
    let mut array = npyz::WriteOptions::<f32>::new()
        .dtype(DType::new_scalar(
            "<f4".parse().map_err(std::io::Error::other)?,
        ))
        .shape(&shape)
        .writer(writer)
        .begin_nd()?;
    array.extend(values.iter().copied())?;
    array.finish()
}

/// Parses the bytes of a `.npy` file; `file` names it in errors.
pub(crate) fn parse(bytes: &[u8], file: &str) -> Result<Array, FileError> {
    let mut values = Vec::new();
    let shape = parse_onto(&mut values, bytes, file)?;
    Ok(Array { shape, values })
}

/// Parses the bytes of a `.npy` file and appends its values to `values`; its shape.
pub(crate) fn parse_onto(
    values: &mut Vec<f32>,
    bytes: &[u8],
    file: &str,
) -> Result<Vec<usize>, FileError> {
    let Header {
        double,
        order,
        shape,
        length,
        data_start,
    } = read_header(bytes, file)?;
    let data = &bytes[data_start..];
    let needed = length.saturating_mul(if double { 8 } else { 4 });
    if data.len() as u64 != needed {
        return Err(FileError::Length {
            file: file.to_owned(),
            found: data.len() as u64,
            needed,
        });
    }
    match (order, &shape[..]) {
        (Order::Fortran, &[rows, columns]) if length > 0 => {
            let mut stored = Vec::new();
            decode(&mut stored, data, double);
            values.extend((0..rows * columns).map(|i| stored[i % columns * rows + i / columns]));
        }
        (Order::Fortran, [_, _, _, ..]) => {
            return Err(FileError::Shape {
                file: file.to_owned(),
                found: format!("{shape:?}"),
                allowed: "one or two axes".to_owned(),
            });
        }
        _ => decode(values, data, double),
    }
    Ok(shape)
}

/// Appends the little-endian numbers of `data`.
fn decode(values: &mut Vec<f32>, data: &[u8], double: bool) {
    if double {
        let (numbers, _) = data.as_chunks();
        values.extend(
            numbers
                .iter()
                .map(|&number| f64::from_le_bytes(number) as f32),
        );
    } else {
        let (numbers, _) = data.as_chunks();
        values.extend(numbers.iter().map(|&number| f32::from_le_bytes(number)));
    }
}

/// What a header says.
#[derive(Debug, PartialEq)]
struct Header {
    /// Double precision, otherwise single.
    double: bool,
    order: Order,
    shape: Vec<usize>,
    /// The product of the axes.
    length: u64,
    /// Where the data begin.
    data_start: usize,
}

fn read_header(bytes: &[u8], file: &str) -> Result<Header, FileError> {
    let not_npy = |reason: String| FileError::NotNpy {
        file: file.to_owned(),
        reason,
    };
    let (text, data_start) = check_header(bytes).map_err(&not_npy)?;
    if let Some(header) = plain_header(text, data_start) {
        return Ok(header);
    }
    let header =
        NpyHeader::from_reader(&bytes[..data_start]).map_err(|e| not_npy(e.to_string()))?;
    let double = match header.dtype().descr().as_str() {
        "'<f4'" => false,
        "'<f8'" => true,
        found => {
            return Err(FileError::Dtype {
                file: file.to_owned(),
                found: found.to_owned(),
            });
        }
    };
    Ok(Header {
        double,
        order: header.order(),
        // A zero elsewhere can hide an axis longer than the file.
        shape: header.shape().iter().map(|&axis| axis as usize).collect(),
        length: header.len(),
        data_start,
    })
}

/// A header spelt as NumPy and this crate do, which is quick to read; none for any other spelling.
fn plain_header(text: &[u8], data_start: usize) -> Option<Header> {
    let text = str::from_utf8(text).ok()?.strip_prefix("{'descr': '<f")?;
    let (precision, text) = text.split_once("', 'fortran_order': ")?;
    let (order, text) = text.split_once(", 'shape': (")?;
    let (axes, end) = text.split_once(')')?;
    if end.trim_end_matches([' ', '\n']) != ", }" {
        return None;
    }
    let axis = |digits: &str| -> Option<usize> {
        let plain = digits.bytes().all(|digit| digit.is_ascii_digit());
        let zeros = digits.len() > 1 && digits.starts_with('0');
        (plain && !zeros).then(|| digits.parse().ok())?
    };
    let closed = axes.strip_suffix(", ").or(axes.strip_suffix(','));
    let shape = closed.unwrap_or(axes).split(", ").map(axis);
    let shape: Vec<usize> = shape.collect::<Option<_>>()?;
    // One number in brackets is no tuple without its comma.
    if shape.len() > 2 || (shape.len() == 1 && closed.is_none()) {
        return None;
    }
    Some(Header {
        double: match precision {
            "4" => false,
            "8" => true,
            _ => return None,
        },
        order: match order {
            "False" => Order::C,
            "True" => Order::Fortran,
            _ => return None,
        },
        // `check_header` has seen that this fits.
        length: shape.iter().map(|&axis| axis as u64).product(),
        shape,
        data_start,
    })
}

/// The header's text and where the data begin. Refuses headers on which the parser behind would
/// recurse without bound, overflow, or allocate what the file does not hold.
fn check_header(bytes: &[u8]) -> Result<(&[u8], usize), String> {
    if bytes.len() < 10 || &bytes[..6] != b"\x93NUMPY" {
        return Err("it does not begin as one".to_owned());
    }
    let (text_start, text_bytes) = match bytes[6] {
        1 => (10, usize::from(u16::from_le_bytes([bytes[8], bytes[9]]))),
        2 | 3 if bytes.len() >= 12 => {
            let length = u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]);
            (12, length as usize)
        }
        2 | 3 => return Err("its header is cut off".to_owned()),
        version => return Err(format!("format version {version} found, 1 to 3 allowed")),
    };
    if text_bytes > MAX_HEADER_BYTES {
        return Err(format!(
            "header of {text_bytes} bytes found, {MAX_HEADER_BYTES} allowed"
        ));
    }
    let text = bytes
        .get(text_start..text_start + text_bytes)
        .ok_or_else(|| "its header is cut off".to_owned())?;
    let (mut depth, mut digits, mut quote) = (0usize, 0usize, None);
    for &byte in text {
        match (quote, byte) {
            (None, b'\'' | b'"') => quote = Some(byte),
            (None, b'(' | b'[' | b'{') => depth += 1,
            (None, b')' | b']' | b'}') => depth = depth.saturating_sub(1),
            (None, b'0'..=b'9') => digits += 1,
            (Some(open), close) if open == close => quote = None,
            _ => {}
        }
        if depth > 5 {
            return Err("its header is nested too deeply".to_owned());
        }
    }
    // The product of the axes then fits in 64 bits whatever they are.
    if digits > 18 {
        return Err("its header declares an array too large to exist".to_owned());
    }
    Ok((text, text_start + text_bytes))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A `.npy` file with any header, for broken files on purpose.
    pub(crate) fn raw(descr: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
        let order = if fortran { "True" } else { "False" };
        let text = format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.as_bytes());
        bytes.extend(data);
        bytes
    }

    fn floats(values: &[f32]) -> Vec<u8> {
        values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect()
    }

    #[test]
    fn c_and_fortran_order_and_float64_give_the_same_array() {
        let expected = Array {
            shape: vec![2, 3],
            values: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
        };
        let c = raw(
            "'<f4'",
            false,
            "(2, 3)",
            &floats(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
        );
        let fortran = raw(
            "'<f4'",
            true,
            "(2, 3)",
            &floats(&[1.0, 4.0, 2.0, 5.0, 3.0, 6.0]),
        );
        let doubles: Vec<u8> = (1..=6)
            .flat_map(|value| f64::from(value).to_le_bytes())
            .collect();
        assert_eq!(parse(&c, "c").unwrap(), expected);
        assert_eq!(parse(&fortran, "f").unwrap(), expected);
        assert_eq!(
            parse(&raw("'<f8'", false, "(2, 3)", &doubles), "d").unwrap(),
            expected
        );
    }

    #[test]
    fn broken_files_are_named_with_what_was_found() {
        let four = floats(&[0.0; 4]);
        let deep = format!("{}{}", "(".repeat(2000), ")".repeat(2000));
        for (bytes, expected) in [
            (b"no array".to_vec(), "does not begin as one"),
            (
                b"\x93NUMPY\x02\x00\xff\xff\xff".to_vec(),
                "header is cut off",
            ),
            (b"\x93NUMPY\x01\x00\x09\x00{".to_vec(), "header is cut off"),
            (
                b"\x93NUMPY\x02\x00\xff\xff\xff\xff\0\0\0\0".to_vec(),
                "10000 allowed",
            ),
            (
                b"\x93NUMPY\x09\x00\x05\x00\0\0\0\0\0".to_vec(),
                "version 9 found",
            ),
            (
                raw("'<f4'", false, "(4,)", &four[..7]),
                "7 bytes of data found, 16 needed",
            ),
            (
                raw("'<f4'", false, "(3,)", &four),
                "16 bytes of data found, 12 needed",
            ),
            (raw("'>f4'", false, "(4,)", &four), "dtype '>f4' found"),
            (raw("'<i4'", false, "(4,)", &four), "dtype '<i4' found"),
            (
                raw("[('a', '<f4')]", false, "(4,)", &four),
                "dtype [('a', '<f4')",
            ),
            (raw("'|O'", false, "(4,)", &four), "dtype '|O' found"),
            (
                raw("'<f4'", false, "(9999999999, 9999999999)", &four),
                "too large",
            ),
            (
                raw("'<f4'", false, "(999999999, 999999999)", &four),
                "16 bytes of data found",
            ),
            (raw("'<f4'", false, "(-4,)", &four), "negative"),
            (raw("'<f4'", false, &deep, &four), "nested too deeply"),
        ] {
            let message = parse(&bytes, "file.npy").unwrap_err().to_string();
            assert!(message.starts_with("file.npy: "), "{message}");
            assert!(message.contains(expected), "{message} lacks {expected}");
        }
    }

    #[test]
    fn the_quick_reading_of_a_header_is_the_full_one() {
        let header = |descr: &str, order: &str, shape: &str, end: &str| {
            let dictionary =
                format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': ({shape}){end}");
            let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
            bytes.extend((dictionary.len() as u16).to_le_bytes());
            bytes.extend(dictionary.bytes());
            bytes
        };
        let mut quick = 0;
        for descr in ["'<f4'", "'<f8'", "'<f2'", "'<f44'", "\"<f4\""] {
            for order in ["True", "False", "true", "0"] {
                for shape in [
                    "3, 25", "3,25", "3, 25, ", "3, 25,", "3,", "3, ", "3", "", ",", "03, 2",
                    "0, 7", "+3, 2", "3,, ", "3, , ", " 3, 2", "1, 2, 3", "-3, 2", "3L, 2",
                ] {
                    for end in [", }\n", ", }   \n", "}", ", }", ", } x\n", ", 'a': 1, }\n"] {
                        let bytes = header(descr, order, shape, end);
                        let (text, start) = check_header(&bytes).unwrap();
                        let Some(header) = plain_header(text, start) else {
                            continue;
                        };
                        quick += 1;
                        let full = NpyHeader::from_reader(&bytes[..]).unwrap();
                        assert_eq!(full.dtype().descr(), descr);
                        assert_eq!(header.double, descr == "'<f8'");
                        assert_eq!(header.order, full.order());
                        assert_eq!(header.length, full.len());
                        let axes: Vec<u64> = header.shape.iter().map(|&a| a as u64).collect();
                        assert_eq!(axes, full.shape());
                    }
                }
            }
        }
        assert!(quick >= 48, "{quick}");
    }

    #[test]
    fn a_motion_is_written_as_the_dataset_stores_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/trajectory.npy");
        let values: Vec<f32> = (0..75).map(|i| i as f32 / 7.0).collect();
        let written = Motion::new(values.clone()).unwrap();
        write_motion(&path, &written).unwrap();
        assert_eq!(read_motion(&path).unwrap().as_slice(), &values[..]);
        let bytes = std::fs::read(&path).unwrap();
        let header = String::from_utf8_lossy(&bytes[10..80]).into_owned();
        assert!(header.contains("'<f4'") && header.contains("False") && header.contains("(3, 25"));
        assert!(bytes.ends_with(&floats(&values[74..])));
    }

    #[test]
    fn a_motion_of_another_shape_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        for (shape, values) in [
            ("(4, 24)", 96),
            ("(100,)", 100),
            ("(1, 25)", 25),
            ("(0, 25)", 0),
        ] {
            let path = folder.path().join("trajectory.npy");
            std::fs::write(
                &path,
                raw("'<f4'", false, shape, &floats(&vec![0.0; values])),
            )
            .unwrap();
            match read_motion(&path) {
                Err(FileError::Shape { allowed, .. }) => assert!(allowed.contains("25")),
                other => panic!("{shape}: {other:?}"),
            }
        }
    }

    proptest! {
        #[test]
        fn any_array_survives_a_round_trip(rows in 0usize..6, columns in 0usize..6, seed: u32) {
            let values: Vec<f32> = (0..rows * columns)
                .map(|i| f32::from_bits(seed.wrapping_mul(2 * i as u32 + 1) >> 2))
                .collect();
            let mut bytes = Vec::new();
            write_array(&mut bytes, &[rows, columns], &values).unwrap();
            prop_assert_eq!(parse(&bytes, "x").unwrap(), Array { shape: vec![rows, columns], values });
        }

        #[test]
        fn damaged_bytes_never_panic(
            place in 0usize..200, byte: u8, cut in 0usize..220, fortran: bool,
        ) {
            let mut bytes = raw("'<f4'", fortran, "(3, 5)", &[7; 60]);
            if let Some(target) = bytes.get_mut(place) {
                *target = byte;
            }
            bytes.truncate(cut);
            if let Ok(array) = parse(&bytes, "x") {
                prop_assert_eq!(array.shape.iter().product::<usize>(), array.values.len());
            }
        }

        #[test]
        fn any_header_text_never_panics(text in "[-{}()\\[\\]',:a-z0-9<>|_ \\\\]{0,120}") {
            let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
            bytes.extend((text.len() as u16).to_le_bytes());
            bytes.extend(text.as_bytes());
            let _ = parse(&bytes, "x");
        }
    }
}
