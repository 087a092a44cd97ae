//! Results that do not depend on the batch size.

use std::cell::Cell;

use crate::mode::scoped;

thread_local! {
    static SAMPLES: Cell<usize> = const { Cell::new(1) };
}

/// Runs `work` on this thread for batches of `samples` samples. Kernels give each sample the same
/// bits as in a batch of one.
///
/// Products of few rows use another algorithm, which rounds differently. Outside this scope the row
/// count of the whole batch selects the algorithm. Operations without a kernel do not change.
///
/// # Panics
/// Panics if `samples` is 0.
pub fn batch_invariant<R>(samples: usize, work: impl FnOnce() -> R) -> R {
    assert!(samples > 0, "a batch has at least one sample");
    scoped(&SAMPLES, samples, work)
}

/// Samples of a batch in the current [`batch_invariant`] scope, otherwise 1.
pub(crate) fn samples() -> usize {
    SAMPLES.get()
}
