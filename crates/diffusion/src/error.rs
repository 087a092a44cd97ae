use kinegrad_settings::InvalidSetting;
use miette::Diagnostic;
use thiserror::Error;

/// Errors about a process, a sampler or what they are given.
#[derive(Debug, Error, Diagnostic)]
pub enum Error {
    /// A setting that no process or sampler can work with.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Setting(#[from] InvalidSetting),
    /// A network whose output cannot stand for its input.
    #[error("the network returned {found:?} for a noisy motion of {expected:?}")]
    #[diagnostic(help(
        "a denoiser returns [batch, channels, time] of the same sizes as its input: check the \
         model's channels"
    ))]
    ModelOutput {
        /// Sizes of the network's output.
        found: Vec<usize>,
        /// Sizes of its input.
        expected: Vec<usize>,
    },
    /// A flow that changes too fast to be followed as closely as asked.
    #[error("no step from flow time {at:.6} keeps the error below {tolerance}")]
    #[diagnostic(help(
        "raise `sampling.sampler.tolerance`, or leave it out for `num_inference_steps` equal steps"
    ))]
    FlowTolerance {
        /// The largest error allowed.
        tolerance: f64,
        /// Where the step begins, from 0 to 1.
        at: f64,
    },
    /// The adaptive solver met numbers that are not finite.
    #[error("the velocity of the flow is not finite")]
    #[diagnostic(help("lower the guidance, or check the model's validation loss"))]
    NotFinite,
    /// The callback of the steps asked for an end.
    #[error("sampling was stopped")]
    Stopped,
}
