//! Loading statistics for a run's `loader.jsonl`.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use serde::Serialize;

/// Counters shared by a dataset's store, caches and loader.
#[derive(Debug, Default)]
pub struct Counters {
    pub(crate) memory_hits: AtomicU64,
    pub(crate) disk_hits: AtomicU64,
    reads: AtomicU64,
    bytes_read: AtomicU64,
    pub(crate) retries: AtomicU64,
    samples: AtomicU64,
    wait_nanoseconds: AtomicU64,
}

/// Counts since the dataset was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LoaderReport {
    /// Samples that the trainer received.
    pub samples: u64,
    /// Seconds that the trainer waited.
    pub wait_seconds: f64,
    /// Phrases or clips found in memory.
    pub memory_hits: u64,
    /// Files found in the disk cache.
    pub disk_hits: u64,
    /// Files read from the store.
    pub reads: u64,
    /// Their bytes.
    pub bytes_read: u64,
    /// Retried reads.
    pub retries: u64,
}

impl Counters {
    pub(crate) fn increment(counter: &AtomicU64) {
        counter.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn read(&self, bytes: usize) {
        self.reads.fetch_add(1, Ordering::Relaxed);
        self.bytes_read.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    pub(crate) fn batch(&self, samples: usize, waited: Duration) {
        self.samples.fetch_add(samples as u64, Ordering::Relaxed);
        let nanoseconds = u64::try_from(waited.as_nanos()).unwrap_or(u64::MAX);
        self.wait_nanoseconds
            .fetch_add(nanoseconds, Ordering::Relaxed);
    }

    /// The counts so far.
    pub fn report(&self) -> LoaderReport {
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        LoaderReport {
            samples: count(&self.samples),
            wait_seconds: count(&self.wait_nanoseconds) as f64 * 1e-9,
            memory_hits: count(&self.memory_hits),
            disk_hits: count(&self.disk_hits),
            reads: count(&self.reads),
            bytes_read: count(&self.bytes_read),
            retries: count(&self.retries),
        }
    }
}
