use miette::Diagnostic;
use thiserror::Error;

/// What can be wrong with a model's configuration or with weights meant for it.
#[derive(Debug, Error, Diagnostic)]
pub enum Error {
    /// A setting that no network can be built from.
    #[error("`{key}` is {found}, allowed: {allowed}")]
    #[diagnostic(help("{hint}"))]
    Config {
        /// The key, with the table it stands in.
        key: String,
        /// The value found.
        found: String,
        /// What is allowed.
        allowed: String,
        /// How to mend it.
        hint: String,
    },
    /// Weights of another network.
    #[error("the weights do not fit:\n  {}", differences.join("\n  "))]
    #[diagnostic(help(
        "the weights belong to another architecture: compare `model.*` of both configs"
    ))]
    Weights {
        /// All of [`differences`](crate::parameters::differences).
        differences: Vec<String>,
    },
}
