//! Long calls: away from the interpreter's lock, with progress, ended by Ctrl-C.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use kinegrad_train::Error;
use pyo3::prelude::*;

use crate::errors::exception;
use crate::threads;

/// Runs `work` without the interpreter's lock.
///
/// # Errors
/// The exception of its error.
pub fn call<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<T, Error> + Send,
) -> PyResult<T> {
    py.detach(|| threads::run(work))
        .map_err(|error| exception(py, &error))
}

/// Tells a Python callable `progress(stage, done, total)` how far a computation is, and ends the
/// computation where that raises, or a signal handler does.
pub struct Progress {
    callback: Option<Py<PyAny>>,
    raised: Option<PyErr>,
}

/// What unwinds out of a computation that is to end.
struct Ended;

impl Progress {
    /// Reports to `callback`, if there is one.
    pub fn new(callback: Option<Py<PyAny>>) -> Self {
        Self {
            callback,
            raised: None,
        }
    }

    /// `done` steps of `total` are done, of a stage if there are several.
    ///
    /// # Panics
    /// Unwinds to [`call_with`] where the computation is to end.
    pub fn step(&mut self, stage: &str, done: usize, total: usize) {
        let told = Python::attach(|py| {
            py.check_signals()?;
            if let Some(callback) = &self.callback {
                callback.call1(py, (stage, done, total))?;
            }
            Ok(())
        });
        if let Err(raised) = told {
            self.raised = Some(raised);
            resume_unwind(Box::new(Ended));
        }
    }
}

/// [`call`] of work that reports its progress.
///
/// # Errors
/// The exception of its error, or what ended it: `KeyboardInterrupt`, or what `callback` raised.
pub fn call_with<T: Send>(
    py: Python<'_>,
    callback: Option<Py<PyAny>>,
    work: impl FnOnce(&mut Progress) -> Result<T, Error> + Send,
) -> PyResult<T> {
    let mut progress = Progress::new(callback);
    let done =
        py.detach(|| threads::run(|| catch_unwind(AssertUnwindSafe(|| work(&mut progress)))));
    match (done, progress.raised.take()) {
        (Err(_), Some(raised)) => Err(raised),
        (Err(panic), None) => resume_unwind(panic),
        (Ok(done), _) => done.map_err(|error| exception(py, &error)),
    }
}

/// Plain data as JSON, which the Python side reads.
pub fn json(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).expect("plain data")
}
