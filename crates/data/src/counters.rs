//! Loading statistics for a run's `loader.jsonl`, which are not part of its metrics.

use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::Serialize;

/// Counts shared by a dataset's store, caches and loader.
#[derive(Debug, Default)]
pub struct Counters(Mutex<LoaderReport>);

/// The counts at one moment, since the dataset was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LoaderReport {
    /// Samples handed to the trainer.
    pub samples: u64,
    /// Seconds that the trainer waited for them.
    pub wait_seconds: f64,
    /// Phrases or clips found in memory.
    pub memory_hits: u64,
    /// Files found in the disk cache.
    pub disk_hits: u64,
    /// Files read from the store itself.
    pub reads: u64,
    /// Their bytes.
    pub bytes_read: u64,
    /// Reads that had to be tried again.
    pub retries: u64,
}

impl Counters {
    /// The counts, to be changed.
    pub(crate) fn lock(&self) -> MutexGuard<'_, LoaderReport> {
        // Nothing that panics runs under the lock.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The counts so far.
    pub fn report(&self) -> LoaderReport {
        *self.lock()
    }
}
