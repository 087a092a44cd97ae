//! How an error reaches the user.

use std::fmt;

use miette::Diagnostic;

/// An error on its way out, with the exit code it means.
#[derive(Debug)]
pub struct Failure {
    diagnostic: Box<dyn Diagnostic + Send + Sync>,
    /// 1 when a check or the run failed, 2 when what was given is wrong.
    pub exit_code: u8,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "error: {}", self.diagnostic)?;
        match self.diagnostic.help() {
            Some(help) => write!(f, "\n\nhint: {help}"),
            None => Ok(()),
        }
    }
}

/// Of every error that can stop a run.
impl<E: Into<kinegrad_train::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        let error = error.into();
        Self {
            exit_code: error.exit_code(),
            diagnostic: Box::new(error),
        }
    }
}

impl From<UsageError> for Failure {
    fn from(error: UsageError) -> Self {
        Self {
            exit_code: 2,
            diagnostic: Box::new(error),
        }
    }
}

/// Arguments that do not make sense together.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[error("{message}")]
#[diagnostic(help("{hint}"))]
pub struct UsageError {
    /// What is wrong.
    pub message: String,
    /// What to do instead.
    pub hint: String,
}

impl UsageError {
    /// An error with its hint.
    pub fn new(message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self {
            message: message.into(),
            hint: hint.into(),
        }
    }
}
