use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;

use crate::Error;

/// A file with an append-only writer.
#[derive(Debug)]
pub(super) struct Appended {
    file: File,
    path: PathBuf,
}

impl Appended {
    /// Opens or creates the file at `path`.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let file = kinegrad_output::append(path);
        Ok(Self {
            file: file.map_err(Error::io("open", path))?,
            path: path.to_path_buf(),
        })
    }

    /// Truncates the file to `length` bytes.
    pub fn truncate(self, length: u64) -> Result<Self, Error> {
        let cut = self.file.set_len(length);
        cut.map_err(Error::io("cut back", &self.path))?;
        Ok(self)
    }

    /// Appends a line of JSON.
    pub fn write_line(&mut self, line: &impl Serialize) -> Result<(), Error> {
        let text = serde_json::to_string(line).expect("plain data") + "\n";
        self.write(text.as_bytes())
    }

    /// Appends `bytes`.
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), Error> {
        let written = self.file.write_all(bytes);
        written.map_err(Error::io("write", &self.path))
    }

    /// Flushes to disk.
    pub fn sync(&mut self) -> Result<(), Error> {
        let flushed = self.file.sync_data();
        flushed.map_err(Error::io("flush", &self.path))
    }
}

/// Seconds since 1970.
pub(super) fn now() -> f64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0.0, |time| time.as_secs_f64())
}
