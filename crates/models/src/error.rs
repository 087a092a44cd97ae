use miette::Diagnostic;
use thiserror::Error;

/// Errors of loading weights.
#[derive(Debug, Error, Diagnostic)]
pub enum Error {
    /// Weights of another network.
    #[error("the weights do not fit: {}", differences.join("; "))]
    #[diagnostic(help(
        "the weights belong to another architecture: compare `model.*` of both configs"
    ))]
    Weights {
        /// All [`differences`](crate::parameters::differences).
        differences: Vec<String>,
    },
}
