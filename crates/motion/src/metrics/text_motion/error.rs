//! What can be wrong with the evaluator and what it is given.

use miette::Diagnostic;
use thiserror::Error;

use crate::humanml::FeatureError;

/// An error about the text-motion evaluator, its words or the clips that it is to measure.
#[derive(Clone, Debug, Diagnostic, Error, PartialEq)]
pub enum TextMotionError {
    /// The arrays of an encoder are not those of its network.
    #[error("the weights of `{part}` do not fit: {problems}")]
    #[diagnostic(help(
        "the published `finest.tar` of the dataset at hand holds all arrays of `movement_encoder`, \
         `motion_encoder` and `text_encoder`"
    ))]
    Weights {
        /// The encoder.
        part: &'static str,
        /// Every array that is missing, not known or of another shape, and what is expected.
        problems: String,
    },

    /// Two encoders, or an encoder and what it reads, are of different widths.
    #[error("{what} is {found} numbers wide where {reader} takes {expected}")]
    #[diagnostic(help(
        "weights, mean and deviation, and word vectors must be those that were published together, \
         for features of the same kind as the clips"
    ))]
    Width {
        /// What is read.
        what: &'static str,
        /// What reads it.
        reader: &'static str,
        /// Its width.
        found: usize,
        /// The width needed.
        expected: usize,
    },

    /// A clip is too short to be encoded.
    #[error("clip {clip} (counted from 0) has {found} frames, at least {needed} needed")]
    #[diagnostic(help("leave out such clips; the published evaluation uses 40 frames or more"))]
    TooShort {
        /// Position of the clip in the list.
        clip: usize,
        /// Its frames.
        found: usize,
        /// Frames needed.
        needed: usize,
    },

    /// Word vectors cannot be used.
    #[error("the word vectors have {found}, expected {expected}")]
    #[diagnostic(help("docs/dataset.md shows how to make `word_vectors.safetensors`"))]
    Words {
        /// What was found.
        found: String,
        /// What is expected.
        expected: String,
    },

    /// The clips or the statistics are not fit for each other.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Features(#[from] FeatureError),
}
