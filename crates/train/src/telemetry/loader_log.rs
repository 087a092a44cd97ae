use std::path::Path;
use std::time::Instant;

use kinegrad_data::LoaderReport;
use serde::Serialize;

use super::appended::{Appended, now};
use crate::Error;

/// Writer of `loader.jsonl`. Loading statistics depend on timing and cache contents, so they are
/// not part of the metrics, which a resumed run must reproduce.
#[derive(Debug)]
pub(crate) struct LoaderLog {
    file: Appended,
    last: (Instant, LoaderReport),
}

/// One line. Counts start when the process opens the dataset.
#[derive(Serialize)]
struct Line {
    step: u64,
    time: f64,
    /// Training samples per second since the previous line.
    samples_per_second: f64,
    /// Share of time spent waiting for samples.
    wait_share: f64,
    #[serde(flatten)]
    report: LoaderReport,
}

impl LoaderLog {
    /// Opens the log of the run in `folder`.
    pub(crate) fn open(folder: &Path, report: LoaderReport) -> Result<Self, Error> {
        Ok(Self {
            file: Appended::open(&folder.join("loader.jsonl"))?,
            last: (Instant::now(), report),
        })
    }

    /// Appends a line.
    pub(crate) fn write(&mut self, step: u64, report: LoaderReport) -> Result<(), Error> {
        let (then, before) = self.last;
        let seconds = then.elapsed().as_secs_f64().max(1e-9);
        let line = Line {
            step,
            time: now(),
            samples_per_second: (report.samples - before.samples) as f64 / seconds,
            wait_share: (report.wait_seconds - before.wait_seconds) / seconds,
            report,
        };
        self.file.write_line(&line)?;
        self.last = (Instant::now(), report);
        Ok(())
    }
}
