use std::path::PathBuf;

use kinegrad_settings::DocumentError;
use miette::Diagnostic;
use thiserror::Error;

/// Errors about a config.
#[derive(Debug, Error, Diagnostic)]
pub enum ConfigError {
    /// The file is missing or cannot be read.
    #[error("cannot read the config {}: {source}", path.display())]
    #[diagnostic(help(
        "`kinegrad init` writes a config to start from; `kinegrad init` with option `list` lists those that \
         there are"
    ))]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's message.
        source: std::io::Error,
    },
    /// The document or one of its keys is invalid.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Document(#[from] DocumentError),
    /// An override of a training setting, for a trained model.
    #[error("option `set {argument}`: the model is trained, only keys of {tables} can be set")]
    #[diagnostic(help("{hint}"))]
    Trained {
        /// The argument found.
        argument: String,
        /// The tables whose keys can be set.
        tables: String,
        /// The suggested key.
        hint: String,
    },
    /// An override that is not `KEY=VALUE`.
    #[error("option `set {argument}` is not KEY=VALUE")]
    #[diagnostic(help("for example option `set optim.learning_rate=2e-4`"))]
    Override {
        /// The argument found.
        argument: String,
    },
}
