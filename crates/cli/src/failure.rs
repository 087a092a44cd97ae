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

impl From<kinegrad_train::Error> for Failure {
    fn from(error: kinegrad_train::Error) -> Self {
        Self {
            exit_code: error.exit_code(),
            diagnostic: Box::new(error),
        }
    }
}

impl From<kinegrad_data::Error> for Failure {
    fn from(error: kinegrad_data::Error) -> Self {
        kinegrad_train::Error::from(error).into()
    }
}

impl From<kinegrad_capture::Error> for Failure {
    fn from(error: kinegrad_capture::Error) -> Self {
        match error {
            kinegrad_capture::Error::Data(error) => error.into(),
            error => Self {
                exit_code: 2,
                diagnostic: Box::new(error),
            },
        }
    }
}

impl From<kinegrad_data::FileError> for Failure {
    fn from(error: kinegrad_data::FileError) -> Self {
        Self {
            exit_code: 2,
            diagnostic: Box::new(error),
        }
    }
}

impl From<kinegrad_motion::Error> for Failure {
    fn from(error: kinegrad_motion::Error) -> Self {
        kinegrad_train::Error::from(error).into()
    }
}

impl From<kinegrad_motion::humanml::FeatureError> for Failure {
    fn from(error: kinegrad_motion::humanml::FeatureError) -> Self {
        kinegrad_train::Error::from(error).into()
    }
}

impl From<kinegrad_audio::Error> for Failure {
    fn from(error: kinegrad_audio::Error) -> Self {
        Self {
            exit_code: 2,
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
