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
    /// The callback of the steps asked for an end.
    #[error("sampling was stopped")]
    Stopped,
}
