//! Errors about motion data.

use miette::Diagnostic;
use thiserror::Error;

/// An error about motion data or the settings for processing it.
#[derive(Clone, Debug, Diagnostic, Error, PartialEq)]
pub enum Error {
    /// The values are not one or more whole frames.
    #[error("{values} values are not one or more whole frames of {channels} channels")]
    #[diagnostic(help("a phrase is a row-major array [frames, 25]"))]
    NotWholeFrames {
        /// Number of values.
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

    /// Stored statistics cannot be used.
    #[error("the statistics are unusable: {reason}")]
    #[diagnostic(help("compute them again from the training motion"))]
    InvalidStatistics {
        /// The problem.
        reason: String,
    },
}
