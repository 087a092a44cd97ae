//! A small C3D writer for the tests.

use crate::c3d::Processor;

/// The contents of a test file.
#[derive(Clone, Debug)]
pub struct Example {
    pub processor: Processor,
    /// Positive: integers times this. Negative: floats.
    pub scale: f32,
    pub rate: f32,
    pub units: Option<&'static str>,
    /// Labels, written as LABELS, LABELS2, ... of `labels_per_parameter` each.
    pub labels: Vec<String>,
    pub labels_per_parameter: usize,
    /// Analog samples in a frame, all channels together.
    pub analog: usize,
    pub first_frame: u32,
    /// `[frames][points]`; none for a point that was not seen.
    pub frames: Vec<Vec<Option<[f32; 3]>>>,
}

impl Example {
    /// Floats of an Intel file at 80 per second in millimetres.
    pub fn new(labels: &[&str], frames: Vec<Vec<Option<[f32; 3]>>>) -> Self {
        Self {
            processor: Processor::Intel,
            scale: -0.1,
            rate: 80.0,
            units: Some("mm"),
            labels: labels.iter().map(|label| label.to_string()).collect(),
            labels_per_parameter: 255,
            analog: 0,
            first_frame: 1,
            frames,
        }
    }

    fn word(&self, word: u16) -> [u8; 2] {
        match self.processor {
            Processor::Mips => word.to_be_bytes(),
            Processor::Intel | Processor::Dec => word.to_le_bytes(),
        }
    }

    fn float(&self, value: f32) -> [u8; 4] {
        match self.processor {
            Processor::Mips => value.to_be_bytes(),
            Processor::Intel => value.to_le_bytes(),
            Processor::Dec => {
                let [a, b, c, d] = (4.0 * value).to_le_bytes();
                [c, d, a, b]
            }
        }
    }

    fn parameter(
        &self,
        into: &mut Vec<u8>,
        group: u8,
        name: &str,
        kind: i8,
        dims: &[u8],
        data: &[u8],
    ) {
        into.extend([name.len() as u8, group]);
        into.extend(name.bytes());
        into.extend(self.word((4 + dims.len() + data.len() + 1) as u16));
        into.extend([kind as u8, dims.len() as u8]);
        into.extend(dims);
        into.extend(data);
        into.push(0); // an empty description
    }

    fn parameters(&self, data_start: u16) -> Vec<u8> {
        let points = self.frames[0].len() as u16;
        let mut section = vec![1, 0x50, 0, type_byte(self.processor)];
        for (id, name) in [(1u8, "TRIAL"), (2, "POINT")] {
            section.extend([name.len() as u8, id.wrapping_neg()]);
            section.extend(name.bytes());
            section.extend(self.word(3));
            section.push(0);
        }
        let last = self.first_frame + self.frames.len() as u32 - 1;
        for (name, frame) in [
            ("ACTUAL_START_FIELD", self.first_frame),
            ("ACTUAL_END_FIELD", last),
        ] {
            let words = [self.word(frame as u16), self.word((frame >> 16) as u16)].concat();
            self.parameter(&mut section, 1, name, 2, &[2], &words);
        }
        for (name, value) in [("USED", points), ("DATA_START", data_start)] {
            self.parameter(&mut section, 2, name, 2, &[], &self.word(value));
        }
        for (name, value) in [("SCALE", self.scale), ("RATE", self.rate)] {
            self.parameter(&mut section, 2, name, 4, &[], &self.float(value));
        }
        if let Some(units) = self.units {
            self.parameter(
                &mut section,
                2,
                "UNITS",
                -1,
                &[units.len() as u8],
                units.as_bytes(),
            );
        }
        let width = self.labels.iter().map(String::len).max().unwrap_or(0) + 2;
        for (part, labels) in self.labels.chunks(self.labels_per_parameter).enumerate() {
            let name = if part == 0 {
                "LABELS".to_string()
            } else {
                format!("LABELS{}", part + 1)
            };
            let text: String = labels
                .iter()
                .map(|label| format!("{label:width$}"))
                .collect();
            let dims = [width as u8, labels.len() as u8];
            self.parameter(&mut section, 2, &name, -1, &dims, text.as_bytes());
        }
        section.push(0);
        section.resize(section.len().next_multiple_of(512), 0);
        section[2] = (section.len() / 512) as u8;
        section
    }

    /// The file.
    pub fn bytes(&self) -> Vec<u8> {
        let blocks = self.parameters(0).len() / 512;
        let data_start = (2 + blocks) as u16;
        let last = self.first_frame + self.frames.len() as u32 - 1;
        let mut file = vec![2, 0x50];
        let short = |frame: u32| self.word(frame.min(u32::from(u16::MAX)) as u16);
        file.extend(self.word(self.frames[0].len() as u16));
        file.extend(self.word(self.analog as u16));
        file.extend(short(self.first_frame));
        file.extend(short(last));
        file.extend(self.word(10));
        file.extend(self.float(self.scale));
        file.extend(self.word(data_start));
        file.extend(self.word(1));
        file.extend(self.float(self.rate));
        file.resize(512, 0);
        file.extend(self.parameters(data_start));
        for frame in &self.frames {
            for point in frame {
                let [x, y, z] = point.unwrap_or_default();
                let residual = if point.is_some() { 0.0 } else { -1.0 };
                for value in [x, y, z] {
                    self.number(&mut file, value, self.scale);
                }
                self.number(&mut file, residual, 1.0);
            }
            for sample in 0..self.analog {
                self.number(&mut file, sample as f32, 1.0);
            }
        }
        file
    }

    fn number(&self, file: &mut Vec<u8>, value: f32, unit: f32) {
        if self.scale < 0.0 {
            file.extend(self.float(value));
        } else {
            file.extend(self.word((value / unit).round() as i16 as u16));
        }
    }
}

/// The byte of the parameter section that stands for a processor.
fn type_byte(processor: Processor) -> u8 {
    (84..=86)
        .find(|byte| Processor::from_type(*byte) == Some(processor))
        .unwrap()
}
