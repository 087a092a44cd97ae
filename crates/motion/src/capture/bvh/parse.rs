//! Reading BVH text.

use super::{Axis, Bvh, Channel, Joint};
use crate::capture::CaptureError;
use crate::capture::error::quote;

/// Channels that one joint can have: three coordinates and three turns.
const MOST_CHANNELS: usize = 6;

impl Bvh {
    /// Reads a BVH file from its bytes; `file` is its name for messages.
    ///
    /// Line ends and indentation do not matter within the hierarchy; each frame is one line.
    /// Bytes that are not UTF-8 (in names) become replacement characters.
    ///
    /// # Errors
    /// [`CaptureError::Bvh`] with the line, what was found and what is allowed there.
    pub fn parse(bytes: &[u8], file: &str) -> Result<Self, CaptureError> {
        let text = String::from_utf8_lossy(bytes);
        let mut reader = Reader::new(text.trim_start_matches('\u{feff}'), file);
        let joints = reader.hierarchy()?;
        let channels: usize = joints.iter().map(|joint| joint.channels.len()).sum();
        if channels == 0 {
            return Err(reader.error(
                "a hierarchy without channels".to_string(),
                "at least one channel",
                "a motion needs numbers that change: export the joints with their channels",
            ));
        }
        let (frame_time, values) = reader.motion(channels)?;
        Ok(Self {
            joints,
            frame_time,
            channels,
            values,
        })
    }
}

/// A place in the text.
struct Reader<'a> {
    file: &'a str,
    lines: std::iter::Enumerate<std::str::Lines<'a>>,
    /// What is left of the current line.
    rest: &'a str,
    /// The current line, counted from 1.
    line: usize,
}

impl<'a> Reader<'a> {
    fn new(text: &'a str, file: &'a str) -> Self {
        Self {
            file,
            lines: text.lines().enumerate(),
            rest: "",
            line: 1,
        }
    }

    fn error(&self, found: String, allowed: &str, hint: &'static str) -> CaptureError {
        CaptureError::Bvh {
            file: self.file.to_string(),
            line: self.line,
            found,
            allowed: allowed.to_string(),
            hint,
        }
    }

    /// Moves to the next text that is not blank; false at the end of the file.
    fn advance(&mut self) -> bool {
        loop {
            self.rest = self.rest.trim_start();
            if !self.rest.is_empty() {
                return true;
            }
            let Some((index, line)) = self.lines.next() else {
                return false;
            };
            (self.line, self.rest) = (index + 1, line);
        }
    }

    /// The next word or brace; empty at the end of the file.
    fn word(&mut self) -> &'a str {
        if !self.advance() {
            return "";
        }
        let end = if self.rest.starts_with(['{', '}']) {
            1
        } else {
            let stops = |c: char| c.is_whitespace() || c == '{' || c == '}';
            self.rest.find(stops).unwrap_or(self.rest.len())
        };
        let (word, rest) = self.rest.split_at(end);
        self.rest = rest;
        word
    }

    /// The rest of the line up to a brace: names may hold spaces and colons.
    fn name(&mut self) -> String {
        let end = self.rest.find(['{', '}']).unwrap_or(self.rest.len());
        let (name, rest) = self.rest.split_at(end);
        self.rest = rest;
        name.trim().to_string()
    }

    fn expect(&mut self, keyword: &str) -> Result<(), CaptureError> {
        let word = self.word();
        if word.eq_ignore_ascii_case(keyword) {
            return Ok(());
        }
        let allowed = format!("`{keyword}`");
        Err(self.error(shown(word), &allowed, "the file may be cut off or no BVH"))
    }

    fn number(&mut self) -> Result<f64, CaptureError> {
        let word = self.word();
        self.finite(word)
    }

    fn finite(&self, word: &str) -> Result<f64, CaptureError> {
        let value = word.parse::<f64>().ok().filter(|value| value.is_finite());
        value.ok_or_else(|| {
            self.error(
                shown(word),
                "a finite number",
                "decimals take a point, as in 1.5",
            )
        })
    }

    fn vector(&mut self) -> Result<[f64; 3], CaptureError> {
        Ok([self.number()?, self.number()?, self.number()?])
    }

    /// The tree, without recursion: its depth is bounded by the text alone.
    fn hierarchy(&mut self) -> Result<Vec<Joint>, CaptureError> {
        self.expect("HIERARCHY")?;
        self.expect("ROOT")?;
        let mut joints = Vec::new();
        let mut first_channel = 0;
        // The joints whose braces are open, with whether their OFFSET and CHANNELS were seen.
        let mut open: Vec<(usize, bool, bool)> =
            vec![(self.open(&mut joints, None)?, false, false)];
        while let Some((current, offset_seen, channels_seen)) = open.last_mut() {
            let word = self.word();
            match word.to_ascii_uppercase().as_str() {
                "OFFSET" if !*offset_seen => {
                    *offset_seen = true;
                    joints[*current].offset = self.vector()?;
                }
                "CHANNELS" if !*channels_seen => {
                    *channels_seen = true;
                    joints[*current].channels = self.channels()?;
                    joints[*current].first_channel = first_channel;
                    first_channel += joints[*current].channels.len();
                }
                "JOINT" => {
                    let parent = *current;
                    let joint = self.open(&mut joints, Some(parent))?;
                    open.push((joint, false, false));
                }
                "END" => {
                    self.name();
                    self.expect("{")?;
                    self.expect("OFFSET")?;
                    joints[*current].end_sites.push(self.vector()?);
                    self.expect("}")?;
                }
                "}" if *offset_seen => {
                    open.pop();
                }
                _ => {
                    let allowed =
                        "one OFFSET, one CHANNELS, then JOINT, End Site or the closing `}`";
                    return Err(self.error(shown(word), allowed, "check the braces of this joint"));
                }
            }
        }
        Ok(joints)
    }

    /// The head of a joint after its keyword: name and brace.
    fn open(
        &mut self,
        joints: &mut Vec<Joint>,
        parent: Option<usize>,
    ) -> Result<usize, CaptureError> {
        let name = self.name();
        self.expect("{")?;
        joints.push(Joint {
            name,
            parent,
            offset: [0.0; 3],
            channels: Vec::new(),
            end_sites: Vec::new(),
            first_channel: 0,
        });
        Ok(joints.len() - 1)
    }

    fn channels(&mut self) -> Result<Vec<Channel>, CaptureError> {
        let word = self.word();
        let count = word.parse().ok().filter(|count| *count <= MOST_CHANNELS);
        let count: usize = count.ok_or_else(|| {
            self.error(
                shown(word),
                "a number of channels from 0 to 6",
                "a joint has at most three coordinates and three turns",
            )
        })?;
        let mut channels = Vec::new();
        for _ in 0..count {
            let word = self.word();
            let channel = channel(word).filter(|channel| !channels.contains(channel));
            channels.push(channel.ok_or_else(|| {
                self.error(
                    shown(word),
                    "a channel that the joint does not have yet, as `Xposition` or `Zrotation`",
                    "the number after CHANNELS is that of the names behind it",
                )
            })?);
        }
        Ok(channels)
    }

    /// The frames: seconds between two of them and all numbers, `[frames, channels]`.
    fn motion(&mut self, channels: usize) -> Result<(f64, Vec<f64>), CaptureError> {
        let word = self.word();
        if word.eq_ignore_ascii_case("ROOT") {
            return Err(self.error(
                "a second ROOT".to_string(),
                "`MOTION`",
                "files with several roots are not supported: export one figure a file",
            ));
        }
        if !word.eq_ignore_ascii_case("MOTION") {
            return Err(self.error(shown(word), "`MOTION`", "the file may be cut off"));
        }
        let declared = self.setting("Frames")?;
        let frames: usize = declared.parse().ok().filter(|n| *n > 0).ok_or_else(|| {
            self.error(
                shown(declared),
                "a number of frames, at least 1",
                "count the lines below",
            )
        })?;
        let text = self.setting("Frame Time")?;
        let frame_time = self.finite(text)?;
        if frame_time <= 0.0 {
            return Err(self.error(
                shown(text),
                "a positive number of seconds",
                "30 frames per second are a frame time of 0.033333",
            ));
        }
        let mut values = Vec::new();
        let mut found = 0;
        while self.advance() {
            found += 1;
            let before = values.len();
            for word in std::mem::take(&mut self.rest).split_whitespace() {
                values.push(self.finite(word)?);
            }
            if found > frames || values.len() - before != channels {
                return Err(self.error(
                    format!("frame {found} with {} numbers", values.len() - before),
                    &format!("one of {frames} frames with {channels} numbers"),
                    "each frame is one line with one number for each channel of the hierarchy",
                ));
            }
        }
        if found < frames {
            return Err(self.error(
                format!("the end of the file after {found} frames"),
                &format!("the {frames} frames that `Frames:` declares"),
                "the file may be cut off; otherwise correct the number",
            ));
        }
        Ok((frame_time, values))
    }

    /// The value of a line `key: value`.
    fn setting(&mut self, key: &str) -> Result<&'a str, CaptureError> {
        self.advance();
        let line = std::mem::take(&mut self.rest);
        if let Some((name, value)) = line.split_once(':') {
            let name: Vec<&str> = name.split_whitespace().collect();
            if name.join(" ").eq_ignore_ascii_case(key) {
                return Ok(value.trim());
            }
        }
        Err(self.error(
            shown(line),
            &format!("`{key}:` and a number"),
            "see the lines after MOTION",
        ))
    }
}

fn shown(word: &str) -> String {
    if word.is_empty() {
        "the end of the line or file".to_string()
    } else {
        quote(word)
    }
}

fn channel(name: &str) -> Option<Channel> {
    let name = name.to_ascii_lowercase();
    let axis = match name.as_bytes().first()? {
        b'x' => Axis::X,
        b'y' => Axis::Y,
        b'z' => Axis::Z,
        _ => return None,
    };
    match &name[1..] {
        "position" => Some(Channel::Position(axis)),
        "rotation" => Some(Channel::Rotation(axis)),
        _ => None,
    }
}
