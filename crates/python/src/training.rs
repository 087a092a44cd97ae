//! Training.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use kinegrad_systems::BUILT_IN;
use kinegrad_train::config::EnvironmentSetting;
use kinegrad_train::config::environment::runs_dir as runs_dir_of_environment;
use kinegrad_train::run::{self, Target, TrainRequest};
use kinegrad_train::{Ending, Observer, Reading, RunSummary, StepReport};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::calls::{call, until_interrupted};
use crate::errors::shown;

/// Passes events to a Python callable `event(kind, fields)`, and stops the training if the callable
/// or a signal handler raises.
struct Events {
    event: Py<PyAny>,
    raised: Option<PyErr>,
    stop: AtomicBool,
}

impl Events {
    fn notify(&mut self, kind: &str, fill: impl Fn(&Bound<'_, PyDict>) -> PyResult<()>) {
        if self.raised.is_some() {
            return;
        }
        let called = Python::attach(|py| {
            py.check_signals()?;
            let fields = PyDict::new(py);
            fill(&fields)?;
            self.event.call1(py, (kind, fields))?;
            Ok(())
        });
        if let Err(raised) = called {
            self.raised = Some(raised);
            self.stop.store(true, Ordering::SeqCst);
        }
    }
}

impl Observer for Events {
    fn started(&mut self, summary: &RunSummary) {
        self.notify("started", |fields| {
            fields.set_item("name", &summary.name)?;
            fields.set_item("folder", &summary.folder)?;
            fields.set_item("device", &summary.device)?;
            fields.set_item("parameters", summary.parameters.all)?;
            fields.set_item("train", summary.train_phrases)?;
            fields.set_item("held_out", summary.validation_phrases)?;
            fields.set_item("step", summary.step)?;
            fields.set_item("max_steps", summary.max_steps)
        });
    }

    fn stepped(&mut self, report: &StepReport) {
        self.notify("step", |fields| {
            fields.set_item("step", report.step)?;
            fields.set_item("max_steps", report.max_steps)?;
            fields.set_item("loss", report.loss)?;
            fields.set_item("learning_rate", report.learning_rate)?;
            fields.set_item("grad_norm", report.grad_norm)
        });
    }

    fn validated(&mut self, step: u64, val_loss: f64, best: bool) {
        self.notify("validated", |fields| {
            fields.set_item("step", step)?;
            fields.set_item("val_loss", val_loss)?;
            fields.set_item("best", best)
        });
    }

    fn saved(&mut self, path: &Path) {
        self.notify("saved", |fields| fields.set_item("path", path));
    }

    fn note(&mut self, text: &str) {
        self.notify("note", |fields| fields.set_item("text", shown(text)));
    }

    fn warning(&mut self, text: &str) {
        let text = shown(text);
        self.notify("warning", |fields| fields.set_item("text", &text));
    }

    fn reading(&self) -> Box<Reading> {
        until_interrupted()
    }

    fn stop_requested(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }
}

/// Trains a run to its end, generates the samples of `sampling.count_at_end`, and returns the run's
/// folder. Exceptions of callbacks and of Ctrl-C are raised after a checkpoint has been written.
#[pyfunction]
pub fn train(
    py: Python<'_>,
    config: PathBuf,
    overrides: Vec<String>,
    runs_dir: Option<PathBuf>,
    resume: bool,
    event: Py<PyAny>,
) -> PyResult<PathBuf> {
    kinegrad_kernels::memory::keep_freed();
    let environment = call(py, EnvironmentSetting::all)?;
    let request = TrainRequest {
        target: match resume {
            true => Target::Resumed(config),
            false => Target::New(config),
        },
        overrides,
        environment,
        runs_dir: match runs_dir {
            Some(folder) => folder,
            None => call(py, runs_dir_of_environment)?.0,
        },
        dry_run: false,
    };
    let mut events = Events {
        event,
        raised: None,
        stop: AtomicBool::new(false),
    };
    let outcome = call(py, || run::train(BUILT_IN, &request, &mut events));
    if let Some(raised) = events.raised.take() {
        return Err(raised);
    }
    let outcome = outcome?;
    if outcome.ending == Some(Ending::Interrupted) {
        return Err(PyKeyboardInterrupt::new_err(()));
    }
    call(py, || kinegrad_cli::sample_at_end(BUILT_IN, &outcome))?;
    Ok(outcome.folder)
}
