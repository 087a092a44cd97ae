use std::path::PathBuf;

use miette::Diagnostic;
use thiserror::Error;

/// Errors about a config.
#[derive(Debug, Error, Diagnostic)]
pub enum ConfigError {
    /// The file is not there or cannot be read.
    #[error("cannot read the config {}: {source}", path.display())]
    #[diagnostic(help(
        "`kinegrad init` writes a config to start from; `kinegrad init` with option `list` lists those that \
         there are"
    ))]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Text that is not TOML.
    #[error("{place}: {message}")]
    #[diagnostic(help("configs are TOML: tables in [brackets], `key = value` lines"))]
    Syntax {
        /// File and line.
        place: String,
        /// What the parser said.
        message: String,
    },
    /// A key that does not exist.
    #[error("{place}: unknown key `{key}`, allowed: {allowed}")]
    #[diagnostic(help("{hint}"))]
    UnknownKey {
        /// File and line, or the override.
        place: String,
        /// The dotted key.
        key: String,
        /// The keys of that table.
        allowed: String,
        /// The nearest valid key, if one is near.
        hint: String,
    },
    /// A value of the wrong type, or not among those allowed.
    #[error("{place}: `{key}`: {message}")]
    #[diagnostic(help("{hint}"))]
    Value {
        /// File and line, or the override.
        place: String,
        /// The dotted key.
        key: String,
        /// What was found and what was expected.
        message: String,
        /// How to mend it.
        hint: String,
    },
    /// An override of what a trained model has been trained with.
    #[error("option `set {argument}`: the model is trained, only keys of {tables} can be set")]
    #[diagnostic(help("{hint}"))]
    Trained {
        /// The argument found.
        argument: String,
        /// The tables whose keys can be set.
        tables: String,
        /// The key that may have been meant.
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
