//! Text-motion evaluators: encoders that measure the match of motions and captions.
//!
//! One encoder embeds clips of HumanML3D features, the other embeds captions. The embeddings are
//! close if the caption describes the clip. Source: C. Guo et al., "Generating Diverse and Natural
//! 3D Human Motions from Text" (2022), section 5, and its published program.
//!
//! ```text
//! clip     normalised frames without contact flags -> two convolutions (4 wide, 2 apart), linear
//!          -> a vector for every 4 frames -> linear, GRU in both directions -> linear, norm, linear
//! caption  word vector + linear of its part of speech -> linear, GRU, and so on
//! ```

mod encoders;
mod sizes;

use burn::module::Module;
use burn::tensor::{Int, Tensor};

pub use sizes::TextMotionSizes;

use encoders::{MovementEncoder, SequenceEncoder, TextEncoder};
use kinegrad_models::Initializer;

/// Frames of a movement; remaining frames at a clip's end are ignored.
pub const UNIT_FRAMES: usize = 4;

/// The parts of the published file that contain weights.
pub const PARTS: [&str; 3] = ["movement_encoder", "motion_encoder", "text_encoder"];

/// Widths of the networks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TextMotionConfig {
    /// Channels of a frame, without contact flags.
    pub channels: usize,
    /// Width of a word vector.
    pub word_vector: usize,
    /// The widths that a config chooses.
    pub sizes: TextMotionSizes,
}

impl TextMotionConfig {
    /// The widths of weights with the named shapes `shape`. Widths without a weight are the
    /// published networks' widths for HumanML3D.
    pub fn of_weights<'a>(shape: impl Fn(&str) -> Option<&'a [usize]>) -> Self {
        let width = |name: &str, axis: usize, published: usize| {
            let found = shape(name).and_then(|shape| shape.get(axis)).copied();
            found.filter(|&found| found > 0).unwrap_or(published)
        };
        Self {
            channels: width("movement_encoder.main.0.weight", 1, 259),
            word_vector: width("text_encoder.pos_emb.weight", 0, 300),
            sizes: TextMotionSizes {
                convolution: width("movement_encoder.main.0.weight", 0, 512),
                movement: width("movement_encoder.main.3.weight", 0, 512),
                motion_state: width("motion_encoder.hidden", 2, 1024),
                text_state: width("text_encoder.hidden", 2, 512),
                embedding: width("motion_encoder.output_net.3.weight", 0, 512),
            },
        }
    }

    /// Encoders with initial weights.
    pub fn init(&self, init: &Initializer) -> TextMotionEncoders {
        let [movement, motion, text] = PARTS.map(|part| init.at(part));
        let TextMotionSizes {
            movement: inputs,
            motion_state,
            embedding,
            ..
        } = self.sizes;
        TextMotionEncoders {
            movement_encoder: MovementEncoder::new(self, &movement),
            motion_encoder: SequenceEncoder::new(inputs, motion_state, embedding, &motion),
            text_encoder: TextEncoder::new(self, &text),
            config: *self,
        }
    }
}

/// The pair of encoders, with the parameters of the published file's [`PARTS`].
///
/// Except for rounding, an embedding does not depend on the other items of its batch.
#[derive(Module, Debug)]
pub struct TextMotionEncoders {
    movement_encoder: MovementEncoder,
    motion_encoder: SequenceEncoder,
    text_encoder: TextEncoder,
    #[module(skip)]
    config: TextMotionConfig,
}

impl TextMotionEncoders {
    /// Widths of the encoders.
    pub fn config(&self) -> &TextMotionConfig {
        &self.config
    }

    /// The embeddings of clips of `lengths` frames, each at least [`UNIT_FRAMES`].
    ///
    /// # Shapes
    /// - frames: normalized, zeros behind each clip, `[batch, channels, time]`; the last movement
    ///   of a clip depends on the frames behind the clip
    /// - output: `[batch, embedding]`
    pub fn motions(&self, frames: Tensor<3>, lengths: &[usize]) -> Tensor<2> {
        let movements = self.movement_encoder.forward(frames);
        let lengths: Vec<usize> = lengths.iter().map(|length| length / UNIT_FRAMES).collect();
        self.motion_encoder.forward(movements, &lengths)
    }

    /// The embeddings of captions of `lengths` words, each at least one.
    ///
    /// # Shapes
    /// - vectors: of the words, `[batch, words, word_vector]`
    /// - classes: of the words, `[batch, words]`
    /// - output: `[batch, embedding]`
    pub fn texts(
        &self,
        vectors: Tensor<3>,
        classes: Tensor<2, Int>,
        lengths: &[usize],
    ) -> Tensor<2> {
        self.text_encoder.forward(vectors, classes, lengths)
    }
}
