//! Long calls that release the interpreter's lock, report progress, and end on Ctrl-C.

use std::ops::ControlFlow;
use std::thread;

use kinegrad_train::{Error, Reading};
use pyo3::prelude::*;

use crate::errors::{exception, shown};
use crate::threads;

/// Runs `work` without the interpreter's lock.
///
/// # Errors
/// The exception for the error of `work`.
pub fn call<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<T, Error> + Send,
) -> PyResult<T> {
    py.detach(|| threads::run(work))
        .map_err(|error| exception(py, &error))
}

/// Ends the reading of a dataset on Ctrl-C, without showing progress. Only the creating thread
/// checks for Ctrl-C, because Python handles signals on its main thread.
pub fn until_interrupted() -> Box<Reading> {
    let here = thread::current().id();
    Box::new(move |_, _| {
        let checks = thread::current().id() == here;
        match checks && Python::attach(|py| py.check_signals()).is_err() {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    })
}

/// Reports to a Python callable `progress(stage, done, total)`, and ends the computation if the
/// callable or a signal handler raises.
pub struct Progress {
    callback: Option<Py<PyAny>>,
    raised: Option<PyErr>,
}

impl Progress {
    /// Reports that `done` of `total` steps of a stage are done; `Break` ends the computation.
    pub fn step(&mut self, stage: &str, done: usize, total: usize) -> ControlFlow<()> {
        self.notify(|py, callback| {
            if let Some(callback) = callback {
                callback.call1(py, (stage, done, total))?;
            }
            Ok(())
        })
    }

    /// Issues a Python warning; `Break` ends the computation.
    pub fn warn(&mut self, text: &str) -> ControlFlow<()> {
        self.notify(|py, _| {
            py.import("warnings")?
                .call_method1("warn", (shown(text),))?;
            Ok(())
        })
    }

    fn notify(
        &mut self,
        call: impl FnOnce(Python<'_>, Option<&Py<PyAny>>) -> PyResult<()>,
    ) -> ControlFlow<()> {
        let called = Python::attach(|py| {
            py.check_signals()?;
            call(py, self.callback.as_ref())
        });
        match called {
            Ok(()) => ControlFlow::Continue(()),
            Err(raised) => {
                self.raised = Some(raised);
                ControlFlow::Break(())
            }
        }
    }
}

/// [`call`] of work that reports its progress to an optional `callback`.
///
/// # Errors
/// The exception for the error of the work, `KeyboardInterrupt`, or the exception that `callback`
/// raised.
pub fn call_with<T: Send>(
    py: Python<'_>,
    callback: Option<Py<PyAny>>,
    work: impl FnOnce(&mut Progress) -> Result<T, Error> + Send,
) -> PyResult<T> {
    let mut progress = Progress {
        callback,
        raised: None,
    };
    let done = py.detach(|| threads::run(|| work(&mut progress)));
    match progress.raised {
        Some(raised) => Err(raised),
        None => done.map_err(|error| exception(py, &error)),
    }
}

/// Plain data as JSON for the Python side.
pub fn json(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).expect("plain data")
}
