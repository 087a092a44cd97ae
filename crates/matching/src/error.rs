//! Errors of matching.

use kinegrad_settings::InvalidSetting;
use miette::Diagnostic;
use thiserror::Error;

/// Errors of matching.
#[derive(Debug, Diagnostic, Error)]
pub enum Error {
    /// A setting is out of range.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Setting(#[from] InvalidSetting),

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
        /// The problem: the value found and the values allowed.
        problem: String,
        /// The remedy.
        hint: String,
    },
}

impl Error {
    /// An [`Error::File`] of a TOML file, with the line.
    pub(crate) fn toml(
        file: &str,
        text: &str,
        error: &toml::de::Error,
        hint: impl Into<String>,
    ) -> Self {
        let before = error.span().and_then(|span| text.get(..span.start));
        let problem = match before {
            Some(before) => {
                let line = before.matches('\n').count() + 1;
                format!("line {line}: {}", error.message())
            }
            None => error.message().to_string(),
        };
        Self::file(file, problem, hint)
    }

    /// An [`Error::File`].
    pub(crate) fn file(file: &str, problem: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::File {
            file: file.to_string(),
            problem: problem.into(),
            hint: hint.into(),
        }
    }
}
