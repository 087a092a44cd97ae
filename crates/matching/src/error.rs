//! Errors of motion matching.

use kinegrad_settings::{DocumentError, InvalidSetting};
use miette::Diagnostic;
use thiserror::Error;

/// An error of motion matching.
#[derive(Debug, Diagnostic, Error)]
pub enum Error {
    /// A setting is out of range.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Setting(#[from] InvalidSetting),

    /// A TOML file is refused.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Document(#[from] DocumentError),

    /// A capture file cannot be read or written.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Capture(#[from] kinegrad_capture::Error),

    /// A file cannot be used.
    #[error("{file}: {problem}")]
    #[diagnostic(help("{hint}"))]
    File {
        /// The file.
        file: String,
        /// The problem, with the value found and the values allowed.
        problem: String,
        /// The remedy.
        hint: String,
    },
}

impl Error {
    /// An [`Error::File`].
    pub(crate) fn file(file: &str, problem: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::File {
            file: file.to_string(),
            problem: problem.into(),
            hint: hint.into(),
        }
    }
}
