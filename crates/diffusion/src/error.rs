use miette::Diagnostic;
use thiserror::Error;

/// What can be wrong with a process, a sampler or what they are given.
#[derive(Debug, Error, Diagnostic)]
pub enum Error {
    /// A setting that no process or sampler can work with.
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
    /// Bounds that do not fit the channels they are meant for.
    #[error("clipping bounds for {min} and {max} channels, but the motion has {channels}")]
    #[diagnostic(help("give one minimum and one maximum for each channel"))]
    ClipChannels {
        /// Number of minima.
        min: usize,
        /// Number of maxima.
        max: usize,
        /// Channels of the motion.
        channels: usize,
    },
    /// Bounds that hold no value.
    #[error("the clipping bounds of channel {channel} are [{min}, {max}]")]
    #[diagnostic(help(
        "a minimum must not exceed its maximum, and neither may be NaN; bounds taken from data \
         that holds NaN look like this"
    ))]
    ClipBounds {
        /// The channel.
        channel: usize,
        /// Its minimum.
        min: f32,
        /// Its maximum.
        max: f32,
    },
    /// A network whose output cannot stand for its input.
    #[error("the network made {found:?} of a noisy motion of {expected:?}")]
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
}
