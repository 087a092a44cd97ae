//! What keeps a motion from being made.

use kinegrad_settings::{DocumentError, InvalidSetting};
use miette::Diagnostic;
use thiserror::Error;

/// What keeps a motion from being made.
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
        /// What is wrong with it: what was found, and what is allowed.
        problem: String,
        /// What to do.
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
