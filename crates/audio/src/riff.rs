//! The chunks of WAV files, as recorders and editors write them.
//!
//! Deviations that other readers accept are accepted: the size of the whole file is ignored, `fmt `
//! may have any length from 14 bytes on and may follow the samples, pad bytes may be missing, channel
//! masks are ignored, and a length that was never written ends with the file. RF64 and BW64 files
//! state their length in a chunk `ds64`.

use std::io::{self, ErrorKind, Read, Seek, SeekFrom};
use std::ops::Range;

use crate::DecodeError;

const PCM: u16 = 1;
const FLOAT: u16 = 3;
const A_LAW: u16 = 6;
const MU_LAW: u16 = 7;
const MP3: u16 = 0x55;
const EXTENSIBLE: u16 = 0xfffe;

/// Most channels of the format reader, one for each loudspeaker position.
const MOST_CHANNELS: u16 = 26;

/// Most chunks before the samples.
const MOST_CHUNKS: usize = 10_000;

/// Lengths from here on stand for an unknown length where the file is shorter: programs that write
/// into a pipe state the largest number that their reader accepts.
const UNKNOWN: u64 = 0x7fff_f000;

/// Chunks that identify an omitted pad byte before them.
const KNOWN: [&[u8; 4]; 16] = [
    b"fmt ", b"data", b"fact", b"LIST", b"JUNK", b"junk", b"bext", b"cue ", b"smpl", b"PEAK",
    b"id3 ", b"ID3 ", b"iXML", b"axml", b"PAD ", b"FLLR",
];

/// The samples of a WAV file.
#[derive(Debug)]
pub(crate) struct Wav {
    /// A plain header for the samples; empty if the samples are an MP3 stream.
    pub header: Vec<u8>,
    /// The bytes of the samples, within the file.
    pub samples: Range<u64>,
    /// True if the writer never stated the length.
    pub is_length_unknown: bool,
}

impl Wav {
    /// The samples of a WAV file of `bytes` bytes; none for other files, other encodings, and
    /// files without format or samples.
    ///
    /// # Errors
    /// As of the reader; [`DecodeError::BigEndian`], [`DecodeError::Channels`].
    pub fn find(reader: &mut (impl Read + Seek), bytes: u64) -> Result<Option<Self>, DecodeError> {
        let Some(head) = at::<12>(reader, 0)? else {
            return Ok(None);
        };
        let is_wav = match (&head[..4], &head[8..]) {
            (b"RIFX", b"WAVE") => return Err(DecodeError::BigEndian),
            (b"RIFF" | b"RF64" | b"BW64", form) => form == b"WAVE",
            _ => false,
        };
        let (mut format, mut data, mut length) = (None, None, None);
        let mut place = 12;
        for _ in 0..if is_wav { MOST_CHUNKS } else { 0 } {
            let Some((id, size)) = chunk(reader, place)? else {
                break;
            };
            let start = place + 8;
            match &id {
                b"ds64" => {
                    let sizes = at::<16>(reader, start)?;
                    length = sizes.and_then(|sizes| Some(u64::from_le_bytes(*sizes.last_chunk()?)));
                }
                b"fmt " => format = Format::read(reader, start, size)?,
                b"data" => data = data.or(Some((start, size))),
                _ => {}
            }
            if let (Some(format), Some((start, size))) = (format, data) {
                let length = length.filter(|_| size == u32::MAX);
                return Self::of(reader, format, start..bytes, size, length);
            }
            place = behind(reader, start, size)?;
        }
        Ok(None)
    }

    /// The samples of a chunk with this `size` at the start of `rest`, or of the `length` of a file
    /// with 64-bit lengths.
    fn of(
        reader: &mut (impl Read + Seek),
        format: Format,
        rest: Range<u64>,
        size: u32,
        length: Option<u64>,
    ) -> Result<Option<Self>, DecodeError> {
        let stated = length.unwrap_or(size.into());
        let left = rest.end.saturating_sub(rest.start);
        let limit = if length.is_some() { u64::MAX } else { UNKNOWN };
        let is_length_unknown = match stated {
            0 => !ends_in_chunks(reader, rest.clone())?,
            stated => stated >= limit && stated > left,
        };
        let (stated, length) = match is_length_unknown {
            true => (u64::MAX, left),
            false => (stated, stated.min(left)),
        };
        let stated = u32::try_from(stated).unwrap_or(u32::MAX);
        let header = format.header(stated)?;
        Ok(header.map(|header| Self {
            header,
            samples: rest.start..rest.start + length,
            is_length_unknown,
        }))
    }
}

/// The encoding of samples.
#[derive(Clone, Copy, Debug)]
struct Format {
    tag: u16,
    channels: u16,
    rate: u32,
    /// Bits of a stored sample, a multiple of 8.
    bits: u16,
}

impl Format {
    /// Reads a `fmt ` chunk; none if it is cut off.
    fn read(reader: &mut (impl Read + Seek), place: u64, size: u32) -> io::Result<Option<Self>> {
        let Some(base) = at::<14>(reader, place)?.filter(|_| size >= 14) else {
            return Ok(None);
        };
        let word = |place: usize| u16::from_le_bytes([base[place], base[place + 1]]);
        let (channels, block) = (word(2), word(12));
        let mut more = |offset: u32| -> io::Result<Option<u16>> {
            let bytes = at::<2>(reader, place + u64::from(offset))?;
            Ok(bytes.filter(|_| size >= offset + 2).map(u16::from_le_bytes))
        };
        let tag = match word(0) {
            // The format is in the first bytes of an identifier.
            EXTENSIBLE => more(24)?.unwrap_or(PCM),
            tag => tag,
        };
        let stored = (block / channels.max(1)).saturating_mul(8);
        let bits = match more(14)?.map(|bits| bits.div_ceil(8).saturating_mul(8)) {
            None | Some(0) => stored,
            // The upper bytes of four.
            Some(24) if stored == 32 => stored,
            Some(bits) => bits,
        };
        Ok(Some(Self {
            tag,
            channels,
            rate: u32::from_le_bytes([base[4], base[5], base[6], base[7]]),
            bits,
        }))
    }

    /// A header for `size` bytes of samples ([`u32::MAX`] for an unknown number), empty for an MP3
    /// stream; none for other encodings. Fails with [`DecodeError::Channels`].
    fn header(self, size: u32) -> Result<Option<Vec<u8>>, DecodeError> {
        match self.tag {
            MP3 => return Ok(Some(Vec::new())),
            PCM | FLOAT | A_LAW | MU_LAW => {}
            _ => return Ok(None),
        }
        if !(1..=MOST_CHANNELS).contains(&self.channels) {
            return Err(DecodeError::Channels {
                found: self.channels,
                most: MOST_CHANNELS,
            });
        }
        let block = self.channels.wrapping_mul(self.bits / 8);
        let mut header = b"RIFF\xff\xff\xff\xffWAVEfmt \x12\0\0\0".to_vec();
        header.extend(self.tag.to_le_bytes());
        header.extend(self.channels.to_le_bytes());
        header.extend(self.rate.to_le_bytes());
        header.extend(self.rate.wrapping_mul(block.into()).to_le_bytes());
        header.extend(block.to_le_bytes());
        header.extend(self.bits.to_le_bytes());
        header.extend(b"\0\0data");
        header.extend(size.to_le_bytes());
        Ok(Some(header))
    }
}

/// `N` bytes at `place`; none beyond the end.
fn at<const N: usize>(reader: &mut (impl Read + Seek), place: u64) -> io::Result<Option<[u8; N]>> {
    let mut bytes = [0; N];
    reader.seek(SeekFrom::Start(place))?;
    match reader.read_exact(&mut bytes) {
        Ok(()) => Ok(Some(bytes)),
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => Ok(None),
        Err(error) => Err(error),
    }
}

/// Name and size of the chunk at `place`.
fn chunk(reader: &mut (impl Read + Seek), place: u64) -> io::Result<Option<([u8; 4], u32)>> {
    let head = at::<8>(reader, place)?;
    Ok(head.map(|[a, b, c, d, size @ ..]| ([a, b, c, d], u32::from_le_bytes(size))))
}

/// The place of the chunk behind a chunk. A pad byte follows an odd size, but some writers omit it.
fn behind(reader: &mut (impl Read + Seek), start: u64, size: u32) -> io::Result<u64> {
    let end = start + u64::from(size);
    if size.is_multiple_of(2) {
        return Ok(end);
    }
    let next = at::<4>(reader, end)?;
    let padded = at::<4>(reader, end + 1)?;
    let is_name = |name: [u8; 4]| name.iter().all(|letter| matches!(letter, b' '..=b'~'));
    let is_omitted = next.is_some_and(|name| {
        KNOWN.contains(&&name) || is_name(name) && !padded.is_some_and(is_name)
    });
    Ok(if is_omitted { end } else { end + 1 })
}

/// True if `rest` consists of whole chunks.
fn ends_in_chunks(reader: &mut (impl Read + Seek), rest: Range<u64>) -> io::Result<bool> {
    let mut place = rest.start;
    for _ in 0..MOST_CHUNKS {
        if place >= rest.end {
            return Ok(place <= rest.end + 1);
        }
        match chunk(reader, place)? {
            Some((name, size)) if name.iter().all(|letter| matches!(letter, b' '..=b'~')) => {
                place = behind(reader, place + 8, size)?;
            }
            _ => break,
        }
    }
    Ok(false)
}
