//! Errors about skeletons, features and their statistics.

use kinegrad_settings::{InvalidSetting, counted};
use miette::Diagnostic;
use thiserror::Error;

/// An error about joint positions, features or a skeleton.
#[derive(Clone, Debug, Diagnostic, Error, PartialEq)]
pub enum FeatureError {
    /// The description of a skeleton contradicts itself.
    #[error("`{field}` of the skeleton `{skeleton}` is {found}")]
    #[diagnostic(help("allowed: {allowed}"))]
    InvalidSkeleton {
        /// Name of the skeleton.
        skeleton: String,
        /// The field, with the place in it.
        field: String,
        /// The value found.
        found: String,
        /// The allowed values.
        allowed: &'static str,
    },

    /// The values are not one or more whole frames.
    #[error("{values} values of `{what}` are not one or more whole frames of {width} numbers")]
    #[diagnostic(help("{what} are a row-major array [frames, {width}]"))]
    NotWholeFrames {
        /// Kind of the values.
        what: &'static str,
        /// Number of values.
        values: usize,
        /// Numbers in a frame.
        width: usize,
    },

    /// No skeleton has this number of channels.
    #[error("no skeleton has features of {}", counted(*found, "channel"))]
    #[diagnostic(help(
        "a skeleton of J joints has 12 J - 1 channels: 263 for 22 joints (HumanML3D), 251 for 21 \
         joints (KIT)"
    ))]
    InvalidChannels {
        /// Number of channels.
        found: usize,
    },

    /// Two sizes do not match.
    #[error("`{what}` has {found} entries where {expected} are needed")]
    #[diagnostic(help("features, joints, statistics and skeleton must be of the same kind"))]
    LengthMismatch {
        /// The thing.
        what: &'static str,
        /// Entries needed.
        expected: usize,
        /// Entries found.
        found: usize,
    },

    /// A clip has too few frames.
    #[error("the clip has {} where at least {needed} are needed", counted(*found, "frame"))]
    #[diagnostic(help("every feature row is taken from a frame and the next"))]
    TooFewFrames {
        /// Frames found.
        found: usize,
        /// Frames needed.
        needed: usize,
    },

    /// The legs have no length.
    #[error("the legs have no length in the first frame")]
    #[diagnostic(help(
        "check `leg_joints` of the skeleton, or leave the clip's bones as they are"
    ))]
    NoLegs,

    /// A value is NaN or infinite.
    #[error("`{what}` are not finite in frame {frame} (counted from 0), {entry}")]
    #[diagnostic(help("repair or leave out this clip: one such value spoils all that follows"))]
    NonFinite {
        /// Kind of the values.
        what: &'static str,
        /// First frame that is not finite.
        frame: usize,
        /// The joint or channel of that frame.
        entry: String,
    },

    /// Features have the wrong representation of the root.
    #[error("features with {found} root came where {expected} root is needed")]
    #[diagnostic(help("convert them with `to_absolute` or `to_relative` first"))]
    WrongRoot {
        /// The reading needed.
        expected: super::Root,
        /// The reading found.
        found: super::Root,
    },

    /// A setting is out of range.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Setting(#[from] InvalidSetting),
}

impl FeatureError {
    /// Rejects `what` unless it has the needed number of entries.
    ///
    /// # Errors
    /// [`LengthMismatch`](Self::LengthMismatch).
    pub fn unless_equal(what: &'static str, expected: usize, found: usize) -> Result<(), Self> {
        match expected == found {
            true => Ok(()),
            false => Err(Self::LengthMismatch {
                what,
                expected,
                found,
            }),
        }
    }
}
