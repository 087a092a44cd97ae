//! Long calls: away from the interpreter's lock, with progress, ended by Ctrl-C.

use std::ops::ControlFlow;
use std::thread;

use kinegrad_cli::as_arguments;
use kinegrad_train::{Error, Reading};
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

/// Progress of reading a dataset that nobody is told of; Ctrl-C ends it, as far as it is called on
/// the thread that this is made on: Python handles signals on its main thread alone.
pub fn until_interrupted() -> Box<Reading> {
    let here = thread::current().id();
    Box::new(move |_, _| {
        let is_asked = thread::current().id() == here;
        match is_asked && Python::attach(|py| py.check_signals()).is_err() {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    })
}

/// Tells a Python callable `progress(stage, done, total)` how far a computation is, and ends the
/// computation where that raises, or a signal handler does.
pub struct Progress {
    callback: Option<Py<PyAny>>,
    raised: Option<PyErr>,
}

impl Progress {
    /// `done` steps of `total` are done, of a stage if there are several; whether to go on.
    pub fn step(&mut self, stage: &str, done: usize, total: usize) -> ControlFlow<()> {
        self.tell(|py, callback| {
            if let Some(callback) = callback {
                callback.call1(py, (stage, done, total))?;
            }
            Ok(())
        })
    }

    /// Warns of something doubtful; whether to go on.
    pub fn warn(&mut self, text: &str) -> ControlFlow<()> {
        self.tell(|py, _| {
            py.import("warnings")?
                .call_method1("warn", (as_arguments(text),))?;
            Ok(())
        })
    }

    fn tell(
        &mut self,
        tell: impl FnOnce(Python<'_>, Option<&Py<PyAny>>) -> PyResult<()>,
    ) -> ControlFlow<()> {
        let told = Python::attach(|py| {
            py.check_signals()?;
            tell(py, self.callback.as_ref())
        });
        match told {
            Ok(()) => ControlFlow::Continue(()),
            Err(raised) => {
                self.raised = Some(raised);
                ControlFlow::Break(())
            }
        }
    }
}

/// [`call`] of work that reports its progress to `callback`, if there is one.
///
/// # Errors
/// The exception of its error, or what ended it: `KeyboardInterrupt`, or what `callback` raised.
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

/// Plain data as JSON, which the Python side reads.
pub fn json(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).expect("plain data")
}
