//! Progress of reading a dataset.

use std::ops::ControlFlow;

use crate::Error;

/// Callback with the number of items read and the total, called from several threads. `Break` ends
/// with [`Error::Interrupted`].
pub type OpenProgress<'a> = &'a (dyn Fn(usize, usize) -> ControlFlow<()> + Sync);

/// Ignores progress.
pub fn no_progress(_done: usize, _total: usize) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Reports progress; fails after `Break`.
pub(crate) fn report(progress: OpenProgress, done: usize, total: usize) -> Result<(), Error> {
    match progress(done, total) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Interrupted),
    }
}
