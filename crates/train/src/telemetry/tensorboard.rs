use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Read};
use std::path::Path;

use kinegrad_data::file::regular;

use super::appended::Appended;
use crate::{Error, Preview};

/// A TensorBoard event file with scalars and images.
///
/// The file is a sequence of records: length (u64), masked CRC-32C of the length, the bytes, masked
/// CRC-32C of the bytes; all little-endian. The bytes are a protocol-buffer `Event` with
/// `wall_time` (field 1, double), `step` (2, varint), `file_version` (3, in the first record only)
/// and `summary` (5). The `value` entries (1) of a summary contain `tag` (1) and `simple_value` (2,
/// float) or `image` (4): `height` (1), `width` (2), `colorspace` (3) and `encoded_image_string`
/// (4).
#[derive(Debug)]
pub(super) struct EventFile {
    file: Appended,
}

impl EventFile {
    /// Opens the file at `path` for appending, truncated after `step`; a new file gets its first
    /// record. The file is truncated at a damaged event, which is reported to `warn`.
    pub(crate) fn open(path: &Path, step: u64, warn: &mut dyn FnMut(&str)) -> Result<Self, Error> {
        let read = || match step {
            0 => Ok(ValidPrefix::default()),
            _ => ValidPrefix::of(BufReader::new(File::open(path)?), step),
        };
        let found = match regular(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(ValidPrefix::default()),
            found => found.and_then(|_| read()),
        };
        let found = found.map_err(Error::io("read", path))?;
        let length = found.bytes;
        if found.damaged {
            warn(&format!(
                "{}: damaged after {length} bytes: the rest is cut off, and is in metrics.jsonl",
                path.display()
            ));
        }
        let mut file = Appended::open(path)?.truncate(length)?;
        if length == 0 {
            let mut event = Vec::new();
            field_bytes(&mut event, 3, b"brain.Event:2");
            file.write(&record(&event))?;
        }
        Ok(Self { file })
    }

    /// Appends the scalars of one step; `time` in seconds since 1970.
    pub(crate) fn write(
        &mut self,
        step: u64,
        time: f64,
        scalars: &[(String, f64)],
    ) -> Result<(), Error> {
        let mut summary = Vec::new();
        for (tag, value) in scalars {
            let mut entry = Vec::new();
            field_bytes(&mut entry, 1, tag.as_bytes());
            entry.push(2 << 3 | 5);
            entry.extend((*value as f32).to_le_bytes());
            field_bytes(&mut summary, 1, &entry);
        }
        self.append(step, time, &summary)
    }

    /// Appends a picture of one step, unless it is too large to be read again.
    pub(crate) fn write_image(
        &mut self,
        step: u64,
        time: f64,
        preview: &Preview,
    ) -> Result<(), Error> {
        if preview.png.len() as u64 + (1 << 16) > MAX_EVENT_BYTES {
            return Ok(());
        }
        let mut image = Vec::new();
        for (field, number) in [(1, preview.height), (2, preview.width), (3, RGB)] {
            image.push(field << 3);
            varint(&mut image, number.into());
        }
        field_bytes(&mut image, 4, &preview.png);
        let (mut entry, mut summary) = (Vec::new(), Vec::new());
        field_bytes(
            &mut entry,
            1,
            format!("previews/{}", preview.name).as_bytes(),
        );
        field_bytes(&mut entry, 4, &image);
        field_bytes(&mut summary, 1, &entry);
        self.append(step, time, &summary)
    }

    fn append(&mut self, step: u64, time: f64, summary: &[u8]) -> Result<(), Error> {
        let mut event = vec![1 << 3 | 1];
        event.extend(time.to_le_bytes());
        event.push(2 << 3);
        varint(&mut event, step);
        field_bytes(&mut event, 5, summary);
        self.file.write(&record(&event))
    }

    /// Flushes to disk.
    pub(crate) fn sync(&mut self) -> Result<(), Error> {
        self.file.sync()
    }
}

/// `colorspace` of a picture with red, green and blue.
const RGB: u32 = 3;

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn field_bytes(out: &mut Vec<u8>, field: u8, bytes: &[u8]) {
    out.push(field << 3 | 2);
    varint(out, bytes.len() as u64);
    out.extend(bytes);
}

fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes)
        .rotate_right(15)
        .wrapping_add(0xa282_ead8)
}

fn record(event: &[u8]) -> Vec<u8> {
    let length = (event.len() as u64).to_le_bytes();
    let mut out = length.to_vec();
    out.extend(masked_crc(&length).to_le_bytes());
    out.extend(event);
    out.extend(masked_crc(event).to_le_bytes());
    out
}

/// Longest event that is read.
const MAX_EVENT_BYTES: u64 = 16 << 20;

/// The part of a file that a resumed run continues.
#[derive(Debug, Default, PartialEq)]
struct ValidPrefix {
    /// Length of the complete records up to a step.
    bytes: u64,
    /// True if the prefix ends at a damaged record. A truncated record comes from a killed process.
    damaged: bool,
}

impl ValidPrefix {
    fn of(mut file: impl Read, step: u64) -> io::Result<Self> {
        let mut prefix = Self::default();
        loop {
            match read_record(&mut file)? {
                Record::Complete(event) if event_step(&event) <= step => {
                    prefix.bytes += event.len() as u64 + 16;
                }
                Record::Complete(_) | Record::End => return Ok(prefix),
                Record::Damaged => {
                    prefix.damaged = true;
                    return Ok(prefix);
                }
            }
        }
    }
}

/// The record at an offset of a file.
enum Record {
    Complete(Vec<u8>),
    /// The end of the file, perhaps within a record.
    End,
    Damaged,
}

fn read_record(file: &mut impl Read) -> io::Result<Record> {
    let mut start = Vec::new();
    file.by_ref().take(12).read_to_end(&mut start)?;
    let Some((length, crc)) = start.split_first_chunk::<8>().filter(|_| start.len() == 12) else {
        return Ok(Record::End);
    };
    let right = crc == masked_crc(length).to_le_bytes();
    let length = u64::from_le_bytes(*length);
    if !right || length > MAX_EVENT_BYTES {
        return Ok(Record::Damaged);
    }
    let mut event = Vec::new();
    file.take(length + 4).read_to_end(&mut event)?;
    if event.len() as u64 != length + 4 {
        return Ok(Record::End);
    }
    let crc = event.split_off(length as usize);
    match crc == masked_crc(&event).to_le_bytes() {
        true => Ok(Record::Complete(event)),
        false => Ok(Record::Damaged),
    }
}
/// The step of an event as [`EventFile::write`] lays it out; 0 for the first record.
fn event_step(event: &[u8]) -> u64 {
    let Some(bytes) = event.get(10..).filter(|_| event[0] == 1 << 3 | 1) else {
        return 0;
    };
    let mut step = 0;
    for (index, byte) in bytes.iter().take(10).enumerate() {
        step |= u64::from(byte & 0x7f) << (7 * index);
        if byte & 0x80 == 0 {
            break;
        }
    }
    step
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(path: &Path) -> Vec<u64> {
        let bytes = std::fs::read(path).expect("an event file");
        let mut rest = bytes.as_slice();
        let mut steps = Vec::new();
        while !rest.is_empty() {
            match read_record(&mut rest).expect("in memory") {
                Record::Complete(event) => steps.push(event_step(&event)),
                _ => panic!("complete records only"),
            }
        }
        steps
    }

    #[test]
    fn a_picture_is_one_event_of_its_step() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("events");
        let preview = |bytes: usize| Preview {
            name: "a".into(),
            width: 300,
            height: 2,
            png: vec![7; bytes],
        };
        let mut events = EventFile::open(&path, 0, &mut |text| panic!("{text}")).expect("events");
        events.write_image(9, 1.0, &preview(5)).expect("an event");
        events
            .write_image(9, 1.0, &preview(MAX_EVENT_BYTES as usize))
            .expect("left out");
        assert_eq!(steps(&path), [0, 9]);
        let bytes = std::fs::read(&path).expect("bytes");
        // Field 1 of the summary: tag (field 1), then the image (field 4).
        let image = [8, 2, 16, 0xac, 2, 24, 3, 34, 5, 7, 7, 7, 7, 7];
        let mut entry = vec![10, 10];
        entry.extend(b"previews/a");
        entry.extend([34, image.len() as u8]);
        entry.extend(image);
        assert!(bytes.windows(entry.len()).any(|window| window == entry));
    }

    #[test]
    fn reopening_cuts_back_events_beyond_the_step_and_a_torn_record() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("events");
        let mut events = EventFile::open(&path, 0, &mut |text| panic!("{text}")).expect("events");
        for step in [1, 200, 70_000] {
            events
                .write(step, 1.0e9, &[("loss".into(), 0.5)])
                .expect("an event");
        }
        drop(events);
        assert_eq!(steps(&path), [0, 1, 200, 70_000]);
        let mut torn = std::fs::read(&path).expect("bytes");
        torn.truncate(torn.len() - 3);
        std::fs::write(&path, torn).expect("torn");
        EventFile::open(&path, 200, &mut |text| panic!("{text}"))
            .expect("events")
            .write(201, 1.0e9, &[])
            .expect("an event");
        assert_eq!(steps(&path), [0, 1, 200, 201]);

        // A bit of the event of step 1, whose record follows the first of 16 and 14 bytes.
        let mut flipped = std::fs::read(&path).expect("bytes");
        flipped[45] ^= 1;
        std::fs::write(&path, flipped).expect("written");
        let mut warned = String::new();
        EventFile::open(&path, 201, &mut |text| warned = text.into()).expect("events");
        assert!(
            warned.contains("events: damaged after 31 bytes"),
            "{warned}"
        );
    }
}
