//! The errors of the crates as the exceptions of `kinegrad.errors`.

use kinegrad_cli::as_arguments;
use kinegrad_train::Error;
use miette::Diagnostic;
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;

/// The exception of `error`, with its hint and the exit code of the command line.
pub fn exception(py: Python<'_>, error: &Error) -> PyErr {
    if matches!(error, Error::Interrupted) {
        return PyKeyboardInterrupt::new_err(());
    }
    let hint = error.help().map(|hint| as_arguments(&hint.to_string()));
    let made = py
        .import("kinegrad.errors")
        .and_then(|errors| errors.getattr(class(error)))
        .and_then(|class| class.call1((as_arguments(&error.to_string()), hint, error.exit_code())));
    match made {
        Ok(exception) => PyErr::from_value(exception),
        Err(failed) => failed,
    }
}

/// The name of its class in `kinegrad.errors`.
fn class(error: &Error) -> &'static str {
    match error {
        Error::Usage { .. } | Error::OtherRepresentation { .. } | Error::NoAdapters { .. } => {
            "UsageError"
        }
        Error::Config(_) | Error::Setting(_) | Error::Diffusion(_) | Error::Emphasis(_) => {
            "ConfigError"
        }
        Error::Data(_)
        | Error::File(_)
        | Error::Motion(_)
        | Error::Features(_)
        | Error::Array { .. }
        | Error::Audio(_) => "DataError",
        Error::RunMissing { .. }
        | Error::CheckpointDamaged { .. }
        | Error::NoGoodCheckpoint { .. }
        | Error::Foreign { .. }
        | Error::ForeignWeights { .. }
        | Error::Model(_) => "CheckpointError",
        Error::NotFinite { .. } | Error::SampleNotFinite { .. } => "NotFiniteError",
        Error::Io { .. } => "StorageError",
        _ => "Error",
    }
}

/// An error of the user's input.
pub fn unusable(error: impl Diagnostic) -> Error {
    let hint = error.help().map(|hint| hint.to_string());
    Error::usage(error.to_string(), hint.unwrap_or_default())
}
