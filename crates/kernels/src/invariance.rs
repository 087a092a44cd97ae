//! Results that do not depend on how many samples a batch holds.

use std::cell::Cell;

use crate::mode::scoped;

thread_local! {
    static SAMPLES: Cell<usize> = const { Cell::new(1) };
}

/// Runs `work` on this thread, in which every batch stands for `samples` samples: the kernels then
/// give each sample the very bits that it gets in a batch of its own.
///
/// Few rows are multiplied in another way than many, and their sums round otherwise; outside of
/// this scope the rows of the whole batch decide. Operations without a kernel round as they do.
///
/// # Panics
/// Panics if there are no samples.
pub fn batch_invariant<R>(samples: usize, work: impl FnOnce() -> R) -> R {
    assert!(samples > 0, "a batch holds at least one sample");
    scoped(&SAMPLES, samples, work)
}

/// Samples that a batch on this thread stands for.
pub(crate) fn samples() -> usize {
    SAMPLES.get()
}
