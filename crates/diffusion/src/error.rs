use burn::tensor::Tensor;
use kinegrad_settings::InvalidSetting;
use miette::Diagnostic;
use thiserror::Error;

/// Errors of processes and samplers.
#[derive(Debug, Error, Diagnostic)]
pub enum Error {
    /// An invalid setting.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Setting(#[from] InvalidSetting),
    /// The sizes of a network's output and input differ.
    #[error("the network returned {found:?} for a noisy motion of {expected:?}")]
    #[diagnostic(help(
        "a denoiser returns [batch, channels, time] of the same sizes as its input: check the \
         model's channels"
    ))]
    ModelOutput {
        /// Sizes of the network's output.
        found: Vec<usize>,
        /// Sizes of the network's input.
        expected: Vec<usize>,
    },
    /// The adaptive solver cannot meet its tolerance.
    #[error("no step from flow time {at:.6} keeps the error below {tolerance}")]
    #[diagnostic(help(
        "raise `sampling.sampler.tolerance`, or leave it out for `num_inference_steps` equal steps"
    ))]
    FlowTolerance {
        /// The largest error allowed.
        tolerance: f64,
        /// Start of the step, from 0 to 1.
        at: f64,
    },
    /// The adaptive solver computed values that are not finite.
    #[error("the velocity of the flow is not finite")]
    #[diagnostic(help("lower the guidance, or check the model's validation loss"))]
    NotFinite,
    /// The callback returned `Break`.
    #[error("sampling was stopped")]
    Stopped,
}

/// Checks that a network's output has the sizes of its input.
pub(crate) fn check_output(output: &Tensor<3>, input: &Tensor<3>) -> Result<(), Error> {
    let (found, expected) = (output.dims(), input.dims());
    match found == expected {
        true => Ok(()),
        false => Err(Error::ModelOutput {
            found: found.into(),
            expected: expected.into(),
        }),
    }
}
