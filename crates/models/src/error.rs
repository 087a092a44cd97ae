use miette::Diagnostic;
use thiserror::Error;

/// What can be wrong with weights meant for a network.
#[derive(Debug, Error, Diagnostic)]
pub enum Error {
    /// Weights without a parameter that the model has.
    #[error("the weights have no parameter `{name}` (shape {shape:?})")]
    #[diagnostic(help(
        "the weights belong to another architecture: compare `model.*` of both configs"
    ))]
    MissingParameter {
        /// State-dict name.
        name: String,
        /// The shape that the model expects.
        shape: Vec<usize>,
    },
    /// Weights with a parameter that the model does not have.
    #[error("the weights hold `{name}`, which the model does not have")]
    #[diagnostic(help(
        "the weights belong to another architecture: compare `model.*` of both configs"
    ))]
    UnexpectedParameter {
        /// State-dict name.
        name: String,
    },
    /// A parameter of another shape.
    #[error("parameter `{name}` has shape {found:?} in the weights, the model needs {expected:?}")]
    #[diagnostic(help(
        "the weights belong to another architecture: compare `model.*` of both configs"
    ))]
    Shape {
        /// State-dict name.
        name: String,
        /// Shape in the weights.
        found: Vec<usize>,
        /// Shape in the model.
        expected: Vec<usize>,
    },
}
