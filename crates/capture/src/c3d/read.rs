//! Reading C3D bytes.

use super::parameters::Parameters;
use super::{C3d, Processor};
use crate::Error;
use crate::error::quote;

/// Bytes of a block, the unit of the header's pointers.
const BLOCK: usize = 512;

/// Second byte of every C3D file.
const KEY: u8 = 0x50;

/// Numbers of a point: x, y, z and the residual with the camera mask.
const POINT: usize = 4;

/// Parameters LABELS, LABELS2, ... that 65535 points need at 255 labels each.
const LABEL_PARAMETERS: usize = 257;

impl C3d {
    /// Reads a C3D file from its bytes; `file` is its name for messages.
    ///
    /// Parameters take precedence over the header, except for the number of frames: the parameters
    /// state this number only where the header's 16 bits are full. Where both state another start of
    /// the data, the start that fits counts. A point is missing where its residual is negative or a
    /// number is NaN.
    ///
    /// # Errors
    /// [`Error::Format`].
    pub fn parse(bytes: &[u8], file: &str) -> Result<Self, Error> {
        Reader::new(bytes, file)?.read()
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    file: &'a str,
    processor: Processor,
    parameters: Parameters<'a>,
}

impl<'a> Reader<'a> {
    fn new(bytes: &'a [u8], file: &'a str) -> Result<Self, Error> {
        let no_c3d = "the file is no C3D file, or an empty or damaged one";
        let wrong = |section, offset, found: String, allowed, hint| {
            let place = format!("{section} at byte {offset}");
            Err(Error::format(file, place, found, allowed, hint))
        };
        if bytes.len() < 2 * BLOCK {
            let found = format!("{} bytes", bytes.len());
            let allowed = "at least two blocks of 512 bytes";
            return wrong("header", 0, found, allowed, no_c3d);
        }
        if bytes[1] != KEY || bytes[0] == 0 {
            let found = format!("{:#04x} {:#04x}", bytes[0], bytes[1]);
            let allowed = "the number of the parameter block and 0x50";
            return wrong("header", 0, found, allowed, no_c3d);
        }
        let start = (usize::from(bytes[0]) - 1) * BLOCK;
        let (section, place) = ("parameter section", start + 3);
        let Some(kind) = bytes.get(place) else {
            let found = "the end of the file".to_string();
            return wrong(section, place, found, "its head", no_c3d);
        };
        let Some(processor) = Processor::from_type(*kind) else {
            let allowed = "the processor type 84 (Intel), 85 (DEC) or 86 (MIPS)";
            return wrong(section, place, kind.to_string(), allowed, no_c3d);
        };
        let parameters = match Parameters::read(bytes, start + 4, processor) {
            Ok(parameters) => parameters,
            Err(place) => {
                let found = "a parameter that reaches beyond the file".to_string();
                let hint = "the file may be cut off";
                return wrong(section, place, found, "a whole parameter", hint);
            }
        };
        Ok(Self {
            bytes,
            file,
            processor,
            parameters,
        })
    }

    /// The error about the header or, where it exists, the parameter `POINT:name`.
    fn point_error(
        &self,
        name: &str,
        header_offset: usize,
        found: String,
        allowed: &str,
        hint: &'static str,
    ) -> Error {
        let (section, offset) = match self.parameters.find("POINT", name) {
            Some(parameter) => (format!("POINT:{name}"), parameter.offset),
            None => ("header".to_string(), header_offset),
        };
        let place = format!("{section} at byte {offset}");
        Error::format(self.file, place, found, allowed, hint)
    }

    /// A word of the header, whose block is known to exist.
    fn header(&self, offset: usize) -> u16 {
        self.processor.word(self.bytes, offset).unwrap_or_default()
    }

    /// `POINT:name`, otherwise the header's value.
    fn point_number(&self, name: &str, header: impl FnOnce() -> f64) -> f64 {
        let number = self.parameters.number("POINT", name, 0);
        number.unwrap_or_else(header)
    }

    fn header_float(&self, offset: usize) -> f64 {
        let float = self.processor.float(self.bytes, offset);
        float.map_or(0.0, f64::from)
    }

    fn read(self) -> Result<C3d, Error> {
        let points_per_frame = self.point_number("USED", || f64::from(self.header(2)));
        if !(1.0..=f64::from(u16::MAX)).contains(&points_per_frame) {
            let found = format!("{points_per_frame} points");
            let hint = "a file of analog samples alone holds no motion";
            return Err(self.point_error("USED", 2, found, "from 1 to 65535 points", hint));
        }
        let rate = self.point_number("RATE", || self.header_float(20));
        if !(rate.is_finite() && rate > 0.0) {
            let hint = "export the file again with its frame rate";
            let allowed = "a positive number of frames per second";
            return Err(self.point_error("RATE", 20, rate.to_string(), allowed, hint));
        }
        let scale = self.point_number("SCALE", || self.header_float(12));
        if !scale.is_finite() || scale == 0.0 {
            let hint =
                "a negative scale means float storage, a positive one is the unit of integers";
            let allowed = "a number other than 0";
            return Err(self.point_error("SCALE", 12, scale.to_string(), allowed, hint));
        }
        let points_per_frame = points_per_frame as usize;
        let points = self.points(points_per_frame, scale as f32)?;
        let first_frame = self.actual_field("ACTUAL_START_FIELD");
        Ok(C3d {
            file: self.file.to_string(),
            processor: self.processor,
            labels: self.labels(points_per_frame),
            rate,
            metres_per_unit: self.metres_per_unit()?,
            first_frame: first_frame.unwrap_or(self.header(6).into()),
            points_per_frame,
            points,
        })
    }

    /// The labels of the points, from the parameters LABELS, LABELS2, ...
    fn labels(&self, points: usize) -> Vec<String> {
        let mut labels = Vec::new();
        let more = (2..=LABEL_PARAMETERS).map(|part| format!("LABELS{part}"));
        for name in std::iter::once("LABELS".to_string()).chain(more) {
            let before = labels.len();
            let part = self.parameters.strings("POINT", &name);
            labels.extend(part.take(points - before));
            if labels.len() == before {
                break;
            }
        }
        labels
    }

    fn metres_per_unit(&self) -> Result<f64, Error> {
        let units = self.parameters.strings("POINT", "UNITS").next();
        match units.unwrap_or_default().to_ascii_lowercase().as_str() {
            "" | "mm" => Ok(0.001),
            "cm" => Ok(0.01),
            "m" => Ok(1.0),
            "in" | "inch" | "inches" => Ok(0.0254),
            unit => {
                let hint = "export the file again in millimetres";
                Err(self.point_error("UNITS", 0, quote(unit), "`mm`, `cm`, `m` or `in`", hint))
            }
        }
    }

    /// A frame number of 32 bits in two words, the low one first.
    fn actual_field(&self, name: &str) -> Option<u32> {
        let part = |index| self.parameters.number("TRIAL", name, index);
        Some(part(0)? as u32 | (part(1)? as u32) << 16)
    }

    /// The number of frames that the file declares.
    fn frames(&self) -> u64 {
        let (first, last) = (self.header(6), self.header(8));
        if first <= last && last < u16::MAX {
            return u64::from(last - first) + 1;
        }
        let start = self.actual_field("ACTUAL_START_FIELD");
        let end = self.actual_field("ACTUAL_END_FIELD");
        if let (Some(start), Some(end)) = (start, end)
            && start <= end
        {
            return u64::from(end - start) + 1;
        }
        let long = self.parameters.number("POINT", "LONG_FRAMES", 0);
        let frames = long.or_else(|| self.parameters.number("POINT", "FRAMES", 0));
        let header = u64::from(last.saturating_sub(first)) + 1;
        frames.map_or(header, |frames| frames as u64)
    }

    /// The block of the first frame: that of the parameters, unless only that of the header is
    /// behind the parameters, has room for all frames, or ends with the file.
    fn data_block(&self, frames: u64, frame_bytes: usize) -> usize {
        let header = usize::from(self.header(16));
        let stated = self.point_number("DATA_START", || header as f64) as usize;
        let first = usize::from(self.bytes[0]);
        let blocks = self.bytes.get((first - 1) * BLOCK + 2).copied();
        let behind = first + usize::from(blocks.unwrap_or(0));
        let needed = frames.saturating_mul(frame_bytes as u64);
        let fit = |block: usize| {
            let start = block.saturating_sub(1).saturating_mul(BLOCK);
            let left = (self.bytes.len() as u64).saturating_sub(start as u64);
            let has_room = block > first && left >= needed;
            let is_whole = has_room && left < needed.saturating_add(BLOCK as u64);
            (has_room, block == behind, is_whole)
        };
        match fit(header) > fit(stated) {
            true => header,
            false => stated,
        }
    }

    /// All points, `[frames, points]`, NaN where missing.
    fn points(&self, points: usize, scale: f32) -> Result<Vec<[f32; 3]>, Error> {
        let width = if scale < 0.0 { 4 } else { 2 };
        let analog = usize::from(self.header(4));
        let frame_bytes = (POINT * points + analog) * width;
        let frames = self.frames();
        let block = self.data_block(frames, frame_bytes);
        let start = block.saturating_sub(1).saturating_mul(BLOCK);
        let available = self.bytes.len().saturating_sub(start) / frame_bytes;
        if block == 0 || frames == 0 || frames > available as u64 {
            let found = format!("{frames} frames of {frame_bytes} bytes from block {block}");
            let allowed = format!("from 1 to the {available} frames that the file has room for");
            let hint = "the file may be cut off";
            return Err(self.point_error("DATA_START", 16, found, &allowed, hint));
        }
        let data = self.bytes[start..].chunks(frame_bytes);
        let frames = data.take(frames as usize);
        let points = frames.flat_map(|frame| frame[..POINT * points * width].chunks(POINT * width));
        Ok(points.map(|point| self.point(point, scale)).collect())
    }

    /// One point of four floats (in final units) or four words (times the scale).
    fn point(&self, bytes: &[u8], scale: f32) -> [f32; 3] {
        let number = |index: usize| -> f32 {
            let number = if scale < 0.0 {
                self.processor.float(bytes, 4 * index)
            } else {
                let word = self.processor.word(bytes, 2 * index);
                word.map(|word| f32::from(word as i16))
            };
            number.unwrap_or(f32::NAN)
        };
        let factor = if scale < 0.0 { 1.0 } else { scale };
        let place = [0, 1, 2].map(|axis| number(axis) * factor);
        // A negative residual means "not seen", and so does NaN.
        let seen = number(3) >= 0.0 && place.iter().all(|value| value.is_finite());
        if seen { place } else { [f32::NAN; 3] }
    }
}
