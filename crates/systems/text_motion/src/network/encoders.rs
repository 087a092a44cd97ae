//! Three networks: the first encodes frames as movements, the others encode movements or words as
//! an embedding.

use burn::module::{Module, Param};
use burn::tensor::activation::leaky_relu;
use burn::tensor::{Int, Tensor};
use kinegrad_models::Initializer;
use kinegrad_models::layers::{BiGru, Conv1d, LayerNorm, Linear};
use kinegrad_motion::metrics::text_motion::PartOfSpeech;

use super::TextMotionConfig;

/// The slope of every leaky rectifier for negative numbers.
const SLOPE: f64 = 0.2;

/// Frames to movements, one for every [`UNIT_FRAMES`](super::UNIT_FRAMES) frames.
#[derive(Module, Debug)]
pub(super) struct MovementEncoder {
    main_at_0: Conv1d,
    main_at_3: Conv1d,
    out_net: Linear,
}

impl MovementEncoder {
    pub fn new(config: &TextMotionConfig, init: &Initializer) -> Self {
        let main = init.at("main");
        let (convolution, movement) = (config.sizes.convolution, config.sizes.movement);
        let halving = |inputs, outputs, at| Conv1d::strided(inputs, outputs, 4, 2, &main.at(at));
        Self {
            main_at_0: halving(config.channels, convolution, "0"),
            main_at_3: halving(convolution, movement, "3"),
            out_net: Linear::new(movement, movement, &init.at("out_net")),
        }
    }

    /// `[batch, channels, time]` to `[batch, movement, time / 4]`.
    pub fn forward(&self, frames: Tensor<3>) -> Tensor<3> {
        let x = leaky_relu(self.main_at_0.forward(frames), SLOPE);
        let x = leaky_relu(self.main_at_3.forward(x), SLOPE);
        self.out_net.forward_frames(x)
    }
}

/// Sequences of unequal length to one embedding each.
#[derive(Module, Debug)]
pub(super) struct SequenceEncoder {
    input_emb: Linear,
    gru: BiGru,
    hidden: Param<Tensor<3>>,
    output_net_at_0: Linear,
    output_net_at_1: LayerNorm,
    output_net_at_3: Linear,
}

impl SequenceEncoder {
    pub fn new(inputs: usize, state: usize, embedding: usize, init: &Initializer) -> Self {
        let head = init.at("output_net");
        Self {
            input_emb: Linear::new(inputs, state, &init.at("input_emb")),
            gru: BiGru::new(state, state, &init.at("gru")),
            hidden: init.constant([2, 1, state], 0.0),
            output_net_at_0: Linear::new(2 * state, state, &head.at("0")),
            output_net_at_1: LayerNorm::new(state, &head.at("1")),
            output_net_at_3: Linear::new(state, embedding, &head.at("3")),
        }
    }

    /// Encodes the first `lengths[i]` steps of each sequence in `[batch, in, time]`; output
    /// `[batch, embedding]`.
    pub fn forward(&self, x: Tensor<3>, lengths: &[usize]) -> Tensor<2> {
        let longest = lengths.iter().max().copied().unwrap_or(0);
        let x = self.input_emb.forward_frames(x.narrow(2, 0, longest));
        let x = self.gru.forward(x, lengths, self.hidden.val()).last;
        let x = self.output_net_at_0.forward(x);
        let x = self.output_net_at_1.forward(x);
        self.output_net_at_3.forward(leaky_relu(x, SLOPE))
    }
}

/// Words with their parts of speech to one embedding.
#[derive(Module, Debug)]
pub(super) struct TextEncoder {
    pos_emb: Linear,
    flat_sequence: SequenceEncoder,
}

impl TextEncoder {
    pub fn new(config: &TextMotionConfig, init: &Initializer) -> Self {
        let classes = PartOfSpeech::ALL.len();
        let (vector, sizes) = (config.word_vector, config.sizes);
        Self {
            pos_emb: Linear::new(classes, vector, &init.at("pos_emb")),
            flat_sequence: SequenceEncoder::new(vector, sizes.text_state, sizes.embedding, init),
        }
    }

    /// Encodes captions of `lengths` words from vectors `[batch, words, word_vector]` and classes
    /// `[batch, words]`; output `[batch, embedding]`.
    pub fn forward(
        &self,
        vectors: Tensor<3>,
        classes: Tensor<2, Int>,
        lengths: &[usize],
    ) -> Tensor<2> {
        let classes = classes.one_hot::<3>(PartOfSpeech::ALL.len()).float();
        let classes = self.pos_emb.forward_frames(classes.swap_dims(1, 2));
        let words = vectors.swap_dims(1, 2) + classes;
        self.flat_sequence.forward(words, lengths)
    }
}
