//! The errors of the crates as the exceptions of `kinegrad.errors`.

use kinegrad_cli::as_arguments;
use kinegrad_output::message;
use kinegrad_train::Error;
use miette::Diagnostic;
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use serde::de::value::Error as ValueError;
use serde::de::{DeserializeOwned, IntoDeserializer};

/// The exception of `error`, with its hint and the exit code of the command line.
pub fn exception(py: Python<'_>, error: &Error) -> PyErr {
    if matches!(error, Error::Interrupted) {
        return PyKeyboardInterrupt::new_err(());
    }
    let hint = error.help().map(|hint| shown(&hint.to_string()));
    let made = py
        .import("kinegrad.errors")
        .and_then(|errors| errors.getattr(class(error)))
        .and_then(|class| class.call1((shown(&error.to_string()), hint, error.exit_code())));
    match made {
        Ok(exception) => PyErr::from_value(exception),
        Err(failed) => failed,
    }
}

/// A message of the libraries for Python's terminal.
pub fn shown(text: &str) -> String {
    message(&as_arguments(text))
}

/// The name of the error's class in `kinegrad.errors`.
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

/// A value by its name in a config; `what` and `allowed` are texts for the error.
pub fn named<T: DeserializeOwned>(what: &str, name: &str, allowed: &str) -> Result<T, Error> {
    let value = T::deserialize(name.into_deserializer());
    value.map_err(|_: ValueError| {
        let message = format!("{what} is \"{name}\"");
        Error::usage(message, format!("{allowed} are allowed"))
    })
}
