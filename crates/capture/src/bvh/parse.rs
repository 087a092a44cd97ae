//! Reading BVH text.

use std::borrow::Cow;

use kinegrad_data::file::utf_16;
use kinegrad_settings::counted;

use super::{Bvh, CHANNELS, Channel, Joint};
use crate::Error;
use crate::error::quote;

/// Frame times that are milliseconds: no motion has four seconds or more from frame to frame.
const MILLISECONDS: std::ops::RangeInclusive<f64> = 4.0..=1000.0;

/// Channels that one joint can have: three coordinates and three turns.
const MOST_CHANNELS: usize = 6;

impl Bvh {
    /// Reads a BVH file of one figure from its bytes; `file` is its name for messages.
    ///
    /// Within the hierarchy any whitespace separates words; each frame is one line, and one frame more
    /// than declared is read too. Lines end in line feeds, carriage returns or both. Text is UTF-8, or
    /// UTF-16; other bytes become replacement characters, and those that end
    /// texts of old programs (0x1A, 0) are dropped at the end. Frame times of 4 to 1000 are
    /// milliseconds.
    ///
    /// # Errors
    /// [`Error::Format`].
    pub fn parse(bytes: &[u8], file: &str) -> Result<Self, Error> {
        let mut figures = read(bytes, file, false)?;
        Ok(figures.remove(0))
    }

    /// The figures of a BVH file, one for each ROOT, read as by [`parse`](Self::parse).
    ///
    /// # Errors
    /// [`Error::Format`].
    pub fn parse_figures(bytes: &[u8], file: &str) -> Result<Vec<Self>, Error> {
        read(bytes, file, true)
    }
}

/// The figures of a file; several only if `may_be_several`.
fn read(bytes: &[u8], file: &str, may_be_several: bool) -> Result<Vec<Bvh>, Error> {
    let text = decoded(bytes);
    let ends = |c: char| c.is_whitespace() || matches!(c, '\0' | '\u{1a}');
    let text = text.trim_start_matches('\u{feff}').trim_end_matches(ends);
    let mut reader = Reader {
        file,
        lines: text.lines().enumerate(),
        rest: "",
        line: 1,
    };
    let figures = reader.figures(may_be_several)?;
    let channels = |joints: &Vec<Joint>| -> usize {
        let channels = joints.iter().map(|joint| joint.channels.len());
        channels.sum()
    };
    let counts: Vec<usize> = figures.iter().map(channels).collect();
    if counts.contains(&0) {
        let hint = "a motion needs numbers that change: export the joints with their channels";
        let found = "a hierarchy without channels";
        return Err(reader.error(found, "at least one channel", hint));
    }
    let all: usize = counts.iter().sum();
    let motion = reader.motion(&figures, all)?;
    let milliseconds = Some(motion.frame_time).filter(|time| MILLISECONDS.contains(time));
    let mut rows = motion.values;
    let frames = rows.len() / all;
    let mut first = 0;
    let figures = figures
        .into_iter()
        .zip(counts)
        .map(|(mut joints, channels)| {
            for joint in &mut joints {
                joint.first_channel = joint.first_channel.saturating_sub(first);
            }
            let own = first..first + channels;
            let values = match channels == all {
                true => std::mem::take(&mut rows),
                false => {
                    let rows = rows.chunks_exact(all);
                    rows.flat_map(|row| &row[own.clone()]).copied().collect()
                }
            };
            first += channels;
            Bvh {
                joints,
                frame_time: milliseconds.map_or(motion.frame_time, |found| found / 1000.0),
                channels,
                values,
                frames_beyond: frames - motion.declared,
                milliseconds,
            }
        });
    Ok(figures.collect())
}

/// The text of a file, with line feeds at the ends of lines.
fn decoded(bytes: &[u8]) -> Cow<'_, str> {
    let text = utf_16(bytes).map_or_else(|| String::from_utf8_lossy(bytes), Cow::Owned);
    let is_alone = |at: usize| text.as_bytes().get(at + 1) != Some(&b'\n');
    match text.match_indices('\r').any(|(at, _)| is_alone(at)) {
        true => Cow::Owned(text.replace("\r\n", "\n").replace('\r', "\n")),
        false => text,
    }
}

/// The frames of a file.
struct Motion {
    /// Number of frames that the file declares; there may be one more.
    declared: usize,
    /// Seconds between frames, or milliseconds.
    frame_time: f64,
    /// `[frames, channels]`.
    values: Vec<f64>,
}

/// The hint about a last line that is not whole.
const CUT_OFF: &str = "the file ends here, before its last frame is whole: copy or export it again, or \
     delete its last line and correct the number after `Frames:`";

/// A place in the text.
struct Reader<'a> {
    file: &'a str,
    lines: std::iter::Enumerate<std::str::Lines<'a>>,
    rest: &'a str,
    /// Counted from 1.
    line: usize,
}

impl<'a> Reader<'a> {
    fn error(&self, found: impl Into<String>, allowed: &str, hint: &'static str) -> Error {
        let place = format!("line {}", self.line);
        Error::format(self.file, place, found, allowed, hint)
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

    /// The rest of the line up to a brace: names may contain spaces and colons.
    fn name(&mut self) -> String {
        let end = self.rest.find(['{', '}']).unwrap_or(self.rest.len());
        let (name, rest) = self.rest.split_at(end);
        self.rest = rest;
        name.trim().to_string()
    }

    fn expect(&mut self, keyword: &str) -> Result<(), Error> {
        let word = self.word();
        if word.eq_ignore_ascii_case(keyword) {
            return Ok(());
        }
        let allowed = format!("`{keyword}`");
        Err(self.error(shown(word), &allowed, "the file may be cut off or no BVH"))
    }

    /// True in the last line of the file.
    fn is_at_end(&self) -> bool {
        self.lines.clone().next().is_none()
    }

    fn finite(&self, word: &str) -> Result<f64, Error> {
        self.number(word, String::new)
    }

    /// The number `word`; `owner` is the frame and joint for messages.
    fn number(&self, word: &str, owner: impl Fn() -> String) -> Result<f64, Error> {
        let value = word.parse::<f64>().ok().filter(|value| value.is_finite());
        value.ok_or_else(|| {
            let lower = word.to_ascii_lowercase();
            // `1.#J` is a rounded `1.#INF`.
            let is_undefined = ["nan", "inf", "#"].iter().any(|name| lower.contains(name));
            let hint = match is_undefined {
                true => {
                    "the exporter wrote an undefined number: export the motion again, or replace the \
                     number by that of the frame before"
                }
                false if word.contains(',') => "decimals take a point, as in 1.5",
                false if self.is_at_end() => CUT_OFF,
                false => "numbers are separated by spaces, as in `1.5 -20 3e-2`",
            };
            self.error(shown(word) + &owner(), "a finite number", hint)
        })
    }

    fn vector(&mut self) -> Result<[f64; 3], Error> {
        let mut vector = [0.0; 3];
        for value in &mut vector {
            let word = self.word();
            *value = self.finite(word)?;
        }
        Ok(vector)
    }

    /// The joints of each figure, up to the word MOTION.
    fn figures(&mut self, may_be_several: bool) -> Result<Vec<Vec<Joint>>, Error> {
        self.expect("HIERARCHY")?;
        self.expect("ROOT")?;
        let mut first_channel = 0;
        let mut figures = vec![self.hierarchy(&mut first_channel)?];
        loop {
            let word = self.word();
            match word.to_ascii_uppercase().as_str() {
                "MOTION" => return Ok(figures),
                "ROOT" if may_be_several => figures.push(self.hierarchy(&mut first_channel)?),
                "ROOT" => {
                    let hint = "`kinegrad match` and `kinegrad view` read files of several figures; \
                                otherwise export one figure a file";
                    return Err(self.error("a second ROOT", "`MOTION`", hint));
                }
                _ => return Err(self.error(shown(word), "`MOTION`", "the file may be cut off")),
            }
        }
    }

    /// The tree below a ROOT, without recursion: its depth is bounded by the text alone. Advances
    /// the place `first_channel` of the next channel within a frame.
    fn hierarchy(&mut self, first_channel: &mut usize) -> Result<Vec<Joint>, Error> {
        let mut joints = Vec::new();
        // The joints with open braces, each with true where OFFSET and CHANNELS were seen.
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
                    joints[*current].first_channel = *first_channel;
                    *first_channel += joints[*current].channels.len();
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
    fn open(&mut self, joints: &mut Vec<Joint>, parent: Option<usize>) -> Result<usize, Error> {
        let name = self.name();
        self.expect("{")?;
        joints.push(Joint::new(name, parent, [0.0; 3], None));
        Ok(joints.len() - 1)
    }

    fn channels(&mut self) -> Result<Vec<Channel>, Error> {
        let word = self.word();
        let count = word.parse().ok().filter(|count| *count <= MOST_CHANNELS);
        let (allowed, hint) = (
            "a number of channels from 0 to 6",
            "a joint has at most three coordinates and three turns",
        );
        let count: usize = count.ok_or_else(|| self.error(shown(word), allowed, hint))?;
        let (allowed, hint) = (
            "a channel that the joint does not have yet, as `Xposition` or `Zrotation`",
            "the number after CHANNELS is that of the names behind it",
        );
        let mut channels = Vec::new();
        for _ in 0..count {
            let word = self.word();
            let mut known = CHANNELS.iter();
            let known = known.find(|(name, _)| name.eq_ignore_ascii_case(word));
            match known.filter(|(_, channel)| !channels.contains(channel)) {
                Some((_, channel)) => channels.push(*channel),
                None => return Err(self.error(shown(word), allowed, hint)),
            }
        }
        Ok(channels)
    }

    /// The frames of figures with so many channels.
    fn motion(&mut self, figures: &[Vec<Joint>], channels: usize) -> Result<Motion, Error> {
        let declared = self.setting("Frames")?;
        let frames: usize = declared.parse().ok().filter(|n| *n > 0).ok_or_else(|| {
            let allowed = "a number of frames, at least 1";
            self.error(shown(declared), allowed, "count the lines below")
        })?;
        let text = self.setting("Frame Time")?;
        let frame_time = self.finite(text)?;
        if frame_time <= 0.0 || frame_time > *MILLISECONDS.end() {
            let hint = "30 frames per second are a frame time of 0.033333 s";
            let allowed = "a positive number of seconds, or at most 1000 milliseconds";
            return Err(self.error(shown(text), allowed, hint));
        }
        let mut values = Vec::new();
        let mut found = 0;
        while self.advance() {
            found += 1;
            let before = values.len();
            for word in std::mem::take(&mut self.rest).split_whitespace() {
                let channel = values.len() - before;
                let owner = || {
                    let mut owners = figures.iter().flatten().rev();
                    let owner = owners.find(|joint| joint.first_channel <= channel);
                    let name = owner.map_or("", |joint| &joint.name);
                    format!(" in frame {found}, joint `{name}`")
                };
                values.push(self.number(word, owner)?);
            }
            if found > frames.saturating_add(1) {
                let found = format!("frame {found}");
                let allowed = format!("the {frames} frames that `Frames:` declares, or one more");
                let hint = "correct the number after `Frames:`";
                return Err(self.error(found, &allowed, hint));
            }
            if values.len() - before != channels {
                let numbers = counted(values.len() - before, "number");
                let found = format!("frame {found} with {numbers}");
                let allowed = format!("a frame with {}", counted(channels, "number"));
                let hint = match self.is_at_end() && values.len() - before < channels {
                    true => CUT_OFF,
                    false => {
                        "each frame is one line with one number for each channel of the hierarchy"
                    }
                };
                return Err(self.error(found, &allowed, hint));
            }
        }
        if found < frames {
            let found = format!("the end of the file after {}", counted(found, "frame"));
            let allowed = format!("the {} that `Frames:` declares", counted(frames, "frame"));
            let hint = "the file may be cut off; otherwise correct the number";
            return Err(self.error(found, &allowed, hint));
        }
        Ok(Motion {
            declared: frames,
            frame_time,
            values,
        })
    }

    /// The value of a line `key: value`.
    fn setting(&mut self, key: &str) -> Result<&'a str, Error> {
        self.advance();
        let line = std::mem::take(&mut self.rest);
        if let Some((name, value)) = line.split_once(':') {
            let name: Vec<&str> = name.split_whitespace().collect();
            if name.join(" ").eq_ignore_ascii_case(key) {
                return Ok(value.trim());
            }
        }
        let allowed = format!("`{key}:` and a number");
        Err(self.error(shown(line), &allowed, "see the lines after MOTION"))
    }
}

fn shown(word: &str) -> String {
    match word {
        "" => "the end of the line or file".to_string(),
        word => quote(word),
    }
}
