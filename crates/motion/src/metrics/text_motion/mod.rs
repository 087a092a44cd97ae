//! How well motions match their captions, by the field's published pair of encoders.
//!
//! One encoder maps a clip of HumanML3D features, the other a caption, to embeddings that lie close
//! together where the caption describes the clip. The networks are fixed: their weights, the mean
//! and deviation that they were trained with and the word vectors are files that come with them.
//! All widths are those of the weights. Source: C. Guo et al., "Generating Diverse and Natural 3D
//! Human Motions from Text" (2022), section 5, as its published program computes it.
//!
//! ```text
//! clip     normalised frames without contact flags -> two convolutions (4 wide, 2 apart), linear
//!          -> a vector for every 4 frames -> linear, GRU in both directions -> linear, norm, linear
//! caption  word vector + linear of its part of speech -> linear, GRU, and so on
//! ```
//!
//! [`TextMotionReport`] has the metrics.

mod encoders;
mod error;
mod layers;
mod report;
mod weights;
mod words;

pub use error::TextMotionError;
pub use report::{DIVERSITY_PAIRS, POOL, TextMotionReport, multimodal_distance, r_precision};
pub use weights::{EvaluatorWeights, NamedArrays};
pub use words::{MAX_WORDS, PartOfSpeech, Token, WordVectors};

use encoders::{MovementEncoder, SequenceEncoder, TextEncoder};
use nalgebra::DMatrix;

use crate::Statistics;
use crate::humanml::{FeatureError, FeatureLayout, Features, Root};

/// Frames of a movement: what is left over at a clip's end is no movement of its own.
pub const UNIT_FRAMES: usize = 4;

/// A shorter clip is followed by frames of zeros, after normalisation, up to this many.
pub const PADDED_FRAMES: usize = 196;

/// Clips or captions that are encoded together.
const GROUP: usize = 32;

/// The pair of encoders with the statistics of their clips.
///
/// Everything is computed in single precision on one thread. Embeddings do not depend on what else
/// is embedded, but for rounding, so that parts of a list can be embedded side by side.
#[derive(Clone, Debug)]
pub struct TextMotionEvaluator {
    movement: MovementEncoder,
    motion: SequenceEncoder,
    text: TextEncoder,
    statistics: Statistics,
}

impl TextMotionEvaluator {
    /// Encoders of these weights; `statistics` are the mean and deviation that they were trained
    /// with, for features with relative root.
    ///
    /// # Errors
    /// [`TextMotionError::Weights`] with every array that does not fit, [`TextMotionError::Width`]
    /// where the parts do not fit each other or the statistics, [`TextMotionError::Features`] for
    /// statistics of features with absolute root.
    pub fn new(
        weights: &EvaluatorWeights,
        statistics: Statistics,
    ) -> Result<Self, TextMotionError> {
        let evaluator = Self {
            movement: MovementEncoder::new("movement_encoder", &weights.movement_encoder)?,
            motion: SequenceEncoder::new("motion_encoder", &weights.motion_encoder)?,
            text: TextEncoder::new("text_encoder", &weights.text_encoder)?,
            statistics,
        };
        let (movement, motion) = (&evaluator.movement, &evaluator.motion);
        same_width(
            ("a movement", movement.outputs()),
            ("`motion_encoder`", motion.inputs()),
        )?;
        same_width(
            ("a caption's embedding", evaluator.text.sequence.outputs()),
            ("comparison with a clip's", motion.outputs()),
        )?;
        let layout = FeatureLayout::of_channels(evaluator.statistics.channels())?;
        same_width(
            ("a frame without contact flags", layout.contacts().start),
            ("`movement_encoder`", movement.inputs()),
        )?;
        match evaluator.statistics.root {
            None | Some(Root::Relative) => Ok(evaluator),
            Some(found) => Err(FeatureError::WrongRoot {
                expected: Root::Relative,
                found,
            }
            .into()),
        }
    }

    /// Numbers of an embedding: 512 as published.
    pub fn width(&self) -> usize {
        self.motion.outputs()
    }

    /// The embedding of each clip, `[clips, width]`, with the root in either reading.
    ///
    /// # Errors
    /// [`TextMotionError::TooShort`] for fewer than [`UNIT_FRAMES`] frames;
    /// [`TextMotionError::Features`] for features of another skeleton than the statistics'.
    pub fn motion_embeddings(&self, clips: &[&Features]) -> Result<Vec<Vec<f64>>, TextMotionError> {
        let mut embeddings = Vec::with_capacity(clips.len());
        for (group, clips) in clips.chunks(GROUP).enumerate() {
            let movements = |(index, clip): (usize, &&Features)| {
                let found = clip.frames();
                if found < UNIT_FRAMES {
                    return Err(TextMotionError::TooShort {
                        clip: group * GROUP + index,
                        found,
                        needed: UNIT_FRAMES,
                    });
                }
                Ok(self.movements(clip)?)
            };
            let movements = clips.iter().enumerate().map(movements);
            let movements = movements.collect::<Result<Vec<_>, _>>()?;
            embeddings.extend(self.motion.embeddings(&movements));
        }
        Ok(embeddings)
    }

    /// The embedding of each caption, `[captions, width]`, by its words. Words after the first
    /// [`MAX_WORDS`] are left out.
    ///
    /// # Errors
    /// [`TextMotionError::Width`] if the encoder takes other word vectors.
    pub fn text_embeddings(
        &self,
        captions: &[&[Token]],
        vectors: &WordVectors,
    ) -> Result<Vec<Vec<f64>>, TextMotionError> {
        let encoder = &self.text;
        same_width(
            ("a word vector", vectors.width()),
            ("`text_encoder`", encoder.sequence.inputs()),
        )?;
        let sentence = |tokens: &&[Token]| encoder.words(&vectors.sentence(tokens));
        let groups = captions.chunks(GROUP).flat_map(|captions| {
            let sentences: Vec<_> = captions.iter().map(sentence).collect();
            encoder.sequence.embeddings(&sentences)
        });
        Ok(groups.collect())
    }

    fn movements(&self, clip: &Features) -> Result<DMatrix<f32>, FeatureError> {
        let (expected, found) = (self.statistics.channels(), clip.layout().channels());
        if found != expected {
            return Err(FeatureError::LengthMismatch {
                what: "channels of a frame",
                expected,
                found,
            });
        }
        let normalized = self.statistics.normalize(clip.to_relative().as_slice());
        let frames = clip.frames();
        let seen = &normalized[..self.movement.inputs() * frames];
        let seen = DMatrix::from_row_slice(self.movement.inputs(), frames, seen);
        let padded = frames.max(PADDED_FRAMES);
        Ok(self.movement.movements(&seen, padded, frames / UNIT_FRAMES))
    }
}

/// Refuses what is not as wide as its reader takes.
fn same_width(
    (what, found): (&'static str, usize),
    (reader, expected): (&'static str, usize),
) -> Result<(), TextMotionError> {
    if found == expected {
        return Ok(());
    }
    Err(TextMotionError::Width {
        what,
        reader,
        found,
        expected,
    })
}
