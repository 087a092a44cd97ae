use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::path::Path;
use std::time::Instant;

use kinegrad_data::file::regular;
use serde_json::{Map, Value};

use super::EventFile;
use super::appended::{Appended, now};
use crate::run::must_be_inside;
use crate::{Error, Preview};

/// Name of the file in a run's folder.
const FILE: &str = "metrics.jsonl";

/// One line of metrics: a step and named scalars, in the order they were added.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Optimizer steps done.
    pub step: u64,
    /// Named scalars.
    pub scalars: Vec<(String, f64)>,
}

impl Record {
    /// A record of `step` without scalars.
    pub fn new(step: u64) -> Self {
        Self {
            step,
            scalars: Vec::new(),
        }
    }

    /// Adds a scalar.
    #[must_use]
    pub fn with(mut self, name: impl Into<String>, value: f64) -> Self {
        self.scalars.push((name.into(), value));
        self
    }

    /// The named scalar.
    pub fn get(&self, name: &str) -> Option<f64> {
        let found = self.scalars.iter().find(|(known, _)| known == name);
        found.map(|(_, value)| *value)
    }
}

/// Writer of `metrics.jsonl` and the event file.
///
/// Only `time` (seconds since 1970), `elapsed_seconds` (of this process) and `steps_per_second` of
/// a line depend on the clock; all other values depend on config, data and build.
#[derive(Debug)]
pub(crate) struct Metrics {
    file: Appended,
    events: EventFile,
    started: Instant,
    first_step: u64,
}

impl Metrics {
    /// Opens the metrics of the run in `folder`, truncated after `step`, because later lines come
    /// from a process that ended before its checkpoint. Earlier damaged lines stay and are reported
    /// to `warn`.
    pub(crate) fn open(
        folder: &Path,
        step: u64,
        warn: &mut dyn FnMut(&str),
    ) -> Result<Self, Error> {
        let path = folder.join(FILE);
        // A run at step 0 measures the initial weights again.
        let length = match step {
            0 => 0,
            _ => {
                let (length, damaged) = valid_bytes(&path, step)?;
                if let Some(damage) = damaged.describe(&path) {
                    warn(&format!("{damage}; what was written after it stays too"));
                }
                length
            }
        };
        let events = EventFile::open(&folder.join("events.out.tfevents.kinegrad"), step, warn)?;
        Ok(Self {
            file: Appended::open(&path)?.truncate(length)?,
            events,
            started: Instant::now(),
            first_step: step,
        })
    }

    /// Appends one line.
    pub(crate) fn write(&mut self, record: &Record) -> Result<(), Error> {
        let time = now();
        let elapsed = self.started.elapsed().as_secs_f64();
        let speed = (record.step - self.first_step) as f64 / elapsed.max(1e-9);
        let clock = [
            ("time", time),
            ("elapsed_seconds", elapsed),
            ("steps_per_second", speed),
        ];
        let mut line = format!("{{\"step\":{}", record.step);
        let scalars = record.scalars.iter();
        let scalars = scalars.map(|(name, value)| (name.as_str(), *value));
        for (name, value) in scalars.chain(clock) {
            line.push_str(&format!(",{}:{}", Value::from(name), Value::from(value)));
        }
        line.push_str("}\n");
        self.file.write(line.as_bytes())?;
        self.events.write(record.step, time, &record.scalars)
    }

    /// Appends pictures of samples to the event file.
    pub(crate) fn write_previews(&mut self, step: u64, previews: &[Preview]) -> Result<(), Error> {
        let time = now();
        let mut each = previews.iter();
        each.try_for_each(|preview| self.events.write_image(step, time, preview))
    }

    /// Flushes to disk.
    pub(crate) fn sync(&mut self) -> Result<(), Error> {
        self.file.sync()?;
        self.events.sync()
    }
}

/// Longest line that is read.
const MAX_LINE: u64 = 1 << 20;

/// Calls `take` with each complete line of the file at `path` and the line number, from 1, until
/// `take` returns false. An incomplete last line comes from a process that was killed or is still
/// writing.
fn each_line(path: &Path, mut take: impl FnMut(&[u8], usize) -> bool) -> io::Result<()> {
    regular(path)?;
    let mut reader = BufReader::new(File::open(path)?);
    let mut line = Vec::new();
    for number in 1.. {
        line.clear();
        let mut limited = reader.by_ref().take(MAX_LINE);
        limited.read_until(b'\n', &mut line)?;
        if line.last() != Some(&b'\n') || !take(&line, number) {
            break;
        }
    }
    Ok(())
}

/// Length of the complete lines up to `step`, and the damaged lines among them.
fn valid_bytes(path: &Path, step: u64) -> Result<(u64, DamagedLines), Error> {
    let (mut length, mut damaged) = (0, DamagedLines::default());
    let take = |bytes: &[u8], number: usize| {
        match parse(bytes) {
            Some(record) if record.step > step => return false,
            Some(_) => {}
            None => damaged.add(number),
        }
        length += bytes.len() as u64;
        true
    };
    match each_line(path, take) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            return Err(Error::io("read", path)(error));
        }
        _ => {}
    }
    Ok((length, damaged))
}

/// Largest number of damaged lines listed in a warning.
const NAMED: usize = 5;

/// The damaged lines of a file.
#[derive(Default)]
struct DamagedLines {
    /// Numbers of the first damaged lines, from 1.
    named: Vec<String>,
    count: usize,
}

impl DamagedLines {
    fn add(&mut self, number: usize) {
        self.count += 1;
        if self.named.len() < NAMED {
            self.named.push(number.to_string());
        }
    }

    /// The warning for the file at `path`; `None` without damaged lines.
    fn describe(&self, path: &Path) -> Option<String> {
        let (path, mut named) = (path.display(), self.named.join(", "));
        if self.count > self.named.len() {
            named += &format!(" and {} more", self.count - self.named.len());
        }
        match self.count {
            0 => None,
            1 => Some(format!(
                "{path}: line {named} is damaged: it stays as it is and is not plotted"
            )),
            _ => Some(format!(
                "{path}: lines {named} are damaged: they stay as they are and are not plotted"
            )),
        }
    }
}

fn parse(line: &[u8]) -> Option<Record> {
    let mut object: Map<String, Value> = serde_json::from_slice(line).ok()?;
    let step = object.remove("step")?.as_u64()?;
    let scalars = object.into_iter();
    let scalars = scalars.filter_map(|(name, value)| Some((name, value.as_f64()?)));
    let scalars = scalars.collect();
    Some(Record { step, scalars })
}

/// Reads the metrics of the run in `folder`; damaged lines are skipped and reported to `warn`.
///
/// # Errors
/// If the file cannot be read.
pub fn read_metrics(folder: &Path, warn: &mut dyn FnMut(&str)) -> Result<Vec<Record>, Error> {
    let path = folder.join(FILE);
    must_be_inside(folder, FILE)?;
    let (mut records, mut damaged) = (Vec::new(), DamagedLines::default());
    let read = each_line(&path, |line, number| {
        match parse(line) {
            Some(record) => records.push(record),
            None => damaged.add(number),
        }
        true
    });
    read.map_err(Error::io("read", &path))?;
    if let Some(damage) = damaged.describe(&path) {
        warn(&damage);
    }
    Ok(records)
}

#[cfg(test)]
mod tests {
    use std::fs::OpenOptions;
    use std::io::Write;

    use super::*;

    #[test]
    fn reopening_cuts_back_lines_beyond_the_step_and_a_torn_one() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut warned = |text: &str| panic!("{text}");
        let mut metrics = Metrics::open(folder.path(), 0, &mut warned).expect("metrics");
        for step in 1..=5 {
            metrics
                .write(&Record::new(step).with("loss", step as f64 / 3.0))
                .expect("a line");
        }
        drop(metrics);
        let path = folder.path().join("metrics.jsonl");
        let mut file = OpenOptions::new().append(true).open(&path).expect("file");
        file.write_all(b"{\"step\":2,\"lo").expect("a torn line");
        drop(file);

        let mut metrics = Metrics::open(folder.path(), 3, &mut warned).expect("metrics");
        metrics
            .write(&Record::new(4).with("loss", 9.0))
            .expect("a line");
        let records = read_metrics(folder.path(), &mut warned).expect("records");
        let steps: Vec<u64> = records.iter().map(|r| r.step).collect();
        assert_eq!(steps, [1, 2, 3, 4]);
        assert_eq!(records[0].get("loss"), Some(1.0 / 3.0));
        assert_eq!(records[3].get("loss"), Some(9.0));
    }

    #[test]
    fn a_damaged_line_stays_is_named_and_takes_none_with_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(FILE);
        let lines = [
            "{\"step\":1}",
            "{\"st",
            "{\"step\":2}",
            "\u{0}",
            "{\"step\":9}",
        ];
        std::fs::write(&path, lines.join("\n") + "\n").expect("written");
        let mut warnings = Vec::new();
        let mut warn = |text: &str| warnings.push(text.to_string());
        Metrics::open(folder.path(), 5, &mut warn).expect("metrics");
        let text = std::fs::read_to_string(&path).expect("text");
        assert_eq!(text, lines[..4].join("\n") + "\n");
        let records = read_metrics(folder.path(), &mut warn).expect("records");
        let steps: Vec<u64> = records.iter().map(|r| r.step).collect();
        assert_eq!(steps, [1, 2]);
        assert_eq!(warnings.len(), 2);
        for warning in warnings {
            assert!(warning.contains("lines 2, 4 are damaged"), "{warning}");
        }
    }
}
