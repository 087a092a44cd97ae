//! What can be wrong with motion data.

use miette::Diagnostic;
use thiserror::Error;

/// An error about motion data or about the settings of its processing.
#[derive(Clone, Debug, Diagnostic, Error, PartialEq)]
pub enum Error {
    /// The number of values does not make whole frames, or makes none.
    #[error("{values} values are not one or more whole frames of {channels} channels")]
    #[diagnostic(help("a phrase is a row-major array [frames, 25]"))]
    NotWholeFrames {
        /// Number of values given.
        values: usize,
        /// Number of channels in a frame.
        channels: usize,
    },

    /// Two arrays that describe the same frames differ in length.
    #[error("`{what}` has {found} entries where {expected} are needed")]
    #[diagnostic(help("give every array one entry for each frame"))]
    LengthMismatch {
        /// The array.
        what: &'static str,
        /// Entries needed.
        expected: usize,
        /// Entries found.
        found: usize,
    },

    /// Statistics of no phrases were asked for.
    #[error("statistics need at least one phrase")]
    #[diagnostic(help(
        "check that the training split is not empty: the validation pattern may match every phrase"
    ))]
    NoPhrases,

    /// A phrase holds NaN or an infinity.
    #[error("phrase {phrase} (counted from 0) is not finite in frame {frame}, channel `{channel}`")]
    #[diagnostic(help("repair or leave out this phrase: one such value spoils every statistic"))]
    NonFinite {
        /// Position of the phrase in the iterator.
        phrase: usize,
        /// First frame that is not finite.
        frame: usize,
        /// First channel of that frame that is not finite.
        channel: String,
    },

    /// The strict profile was asked for without the training phrases' statistics.
    #[error(
        "the profile `strict` compares with the training phrases, whose statistics are missing"
    )]
    #[diagnostic(help(
        "name the run that holds them with `--run`, or the phrases themselves with `--source`, \
         or use `--profile document`"
    ))]
    StatisticsNeeded,

    /// Stored statistics cannot be used.
    #[error("the training statistics are unusable: {reason}")]
    #[diagnostic(help("compute them again from the training phrases"))]
    InvalidStatistics {
        /// What is wrong.
        reason: String,
    },

    /// A profile of that name does not exist.
    #[error("there is no profile `{found}`")]
    #[diagnostic(help("choose `document` or `strict`"))]
    UnknownProfile {
        /// The name given.
        found: String,
    },
}
