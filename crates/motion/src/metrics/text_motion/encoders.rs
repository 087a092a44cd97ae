//! The three networks: frames to movements, and movements or words to an embedding.

use nalgebra::DMatrix;

use super::TextMotionError;
use super::layers::{Convolution, LayerNorm, Linear, Recurrence, leaky_relu};
use super::weights::{
    Axis::{Exactly, Size, Times},
    Expected, NamedArrays, check,
};
use super::words::PartOfSpeech;

const MOVEMENT: &[Expected] = &[
    (
        "main.0.weight",
        &[Size("hidden"), Size("channels"), Exactly(4)],
    ),
    ("main.0.bias", &[Size("hidden")]),
    ("main.3.weight", &[Size("wide"), Size("hidden"), Exactly(4)]),
    ("main.3.bias", &[Size("wide")]),
    ("out_net.weight", &[Size("out"), Size("wide")]),
    ("out_net.bias", &[Size("out")]),
];

const SEQUENCE: &[Expected] = &[
    ("input_emb.weight", &[Size("embedded"), Size("in")]),
    ("input_emb.bias", &[Size("embedded")]),
    ("gru.weight_ih_l0", &[Times(3, "state"), Size("embedded")]),
    ("gru.weight_hh_l0", &[Times(3, "state"), Size("state")]),
    ("gru.bias_ih_l0", &[Times(3, "state")]),
    ("gru.bias_hh_l0", &[Times(3, "state")]),
    (
        "gru.weight_ih_l0_reverse",
        &[Times(3, "state"), Size("embedded")],
    ),
    (
        "gru.weight_hh_l0_reverse",
        &[Times(3, "state"), Size("state")],
    ),
    ("gru.bias_ih_l0_reverse", &[Times(3, "state")]),
    ("gru.bias_hh_l0_reverse", &[Times(3, "state")]),
    ("hidden", &[Exactly(2), Exactly(1), Size("state")]),
    ("output_net.0.weight", &[Size("head"), Times(2, "state")]),
    ("output_net.0.bias", &[Size("head")]),
    ("output_net.1.weight", &[Size("head")]),
    ("output_net.1.bias", &[Size("head")]),
    ("output_net.3.weight", &[Size("out"), Size("head")]),
    ("output_net.3.bias", &[Size("out")]),
];

const WORDS: &[Expected] = &[
    (
        "pos_emb.weight",
        &[Size("in"), Exactly(PartOfSpeech::ALL.len())],
    ),
    ("pos_emb.bias", &[Size("in")]),
];

/// Frames to movements, one for every [`UNIT_FRAMES`](super::UNIT_FRAMES) frames.
#[derive(Clone, Debug)]
pub(super) struct MovementEncoder {
    first: Convolution,
    second: Convolution,
    output: Linear,
}

impl MovementEncoder {
    pub fn new(part: &'static str, arrays: &NamedArrays) -> Result<Self, TextMotionError> {
        check(part, arrays, &[MOVEMENT])?;
        Ok(Self {
            first: Convolution::read(arrays, "main.0"),
            second: Convolution::read(arrays, "main.3"),
            output: Linear::read(arrays, "out_net"),
        })
    }

    /// Channels of a frame.
    pub fn inputs(&self) -> usize {
        self.first.inputs()
    }

    /// Numbers of a movement.
    pub fn outputs(&self) -> usize {
        self.output.outputs()
    }

    /// The first `steps` movements of normalised frames `[channels, n]` that zeros follow, up to
    /// `padded` frames: `[out, steps]`.
    pub fn movements(&self, frames: &DMatrix<f32>, padded: usize, steps: usize) -> DMatrix<f32> {
        // What follows the clip counts: the last movement sees a step of the first layer that has
        // no frame of the clip in its middle.
        let seen = Convolution::steps(padded).min(2 * steps + 1);
        let mut values = self.first.apply(frames, seen);
        leaky_relu(&mut values);
        let mut values = self.second.apply(&values, steps);
        leaky_relu(&mut values);
        self.output.apply(&values)
    }
}

/// Sequences of vectors to one embedding each.
#[derive(Clone, Debug)]
pub(super) struct SequenceEncoder {
    input: Linear,
    forward: Recurrence,
    backward: Recurrence,
    joined: Linear,
    norm: LayerNorm,
    output: Linear,
}

impl SequenceEncoder {
    pub fn new(part: &'static str, arrays: &NamedArrays) -> Result<Self, TextMotionError> {
        check(part, arrays, &[SEQUENCE])?;
        Ok(Self::read(arrays))
    }

    fn read(arrays: &NamedArrays) -> Self {
        Self {
            input: Linear::read(arrays, "input_emb"),
            forward: Recurrence::read(arrays, false),
            backward: Recurrence::read(arrays, true),
            joined: Linear::read(arrays, "output_net.0"),
            norm: LayerNorm::read(arrays, "output_net.1"),
            output: Linear::read(arrays, "output_net.3"),
        }
    }

    /// Numbers of a step.
    pub fn inputs(&self) -> usize {
        self.input.inputs()
    }

    /// Numbers of an embedding.
    pub fn outputs(&self) -> usize {
        self.output.outputs()
    }

    /// The embedding of each sequence `[in, steps]` of one step or more.
    pub fn embeddings(&self, sequences: &[DMatrix<f32>]) -> Vec<Vec<f64>> {
        let mut order: Vec<usize> = (0..sequences.len()).collect();
        order.sort_by_key(|&index| std::cmp::Reverse(sequences[index].ncols()));
        let sorted = order
            .iter()
            .map(|&index| self.input.apply(&sequences[index]));
        let sorted: Vec<_> = sorted.collect();
        let (first, last) = (
            self.forward.last_states(&sorted),
            self.backward.last_states(&sorted),
        );
        let width = first.nrows();
        let both = DMatrix::from_fn(2 * width, sorted.len(), |row, column| match row < width {
            true => first[(row, column)],
            false => last[(row - width, column)],
        });
        let mut values = self.joined.apply(&both);
        self.norm.apply(&mut values);
        leaky_relu(&mut values);
        let values = self.output.apply(&values);
        let mut embeddings = vec![Vec::new(); order.len()];
        for (column, index) in values.column_iter().zip(order) {
            embeddings[index] = column.iter().map(|&value| f64::from(value)).collect();
        }
        embeddings
    }
}

/// Words with their parts of speech to one embedding.
#[derive(Clone, Debug)]
pub(super) struct TextEncoder {
    parts_of_speech: Linear,
    pub sequence: SequenceEncoder,
}

impl TextEncoder {
    pub fn new(part: &'static str, arrays: &NamedArrays) -> Result<Self, TextMotionError> {
        check(part, arrays, &[WORDS, SEQUENCE])?;
        Ok(Self {
            parts_of_speech: Linear::read(arrays, "pos_emb"),
            sequence: SequenceEncoder::read(arrays),
        })
    }

    /// What the sequence encoder sees of words: vector and part of speech, `[in, words]`.
    pub fn words(&self, words: &[(&[f32], PartOfSpeech)]) -> DMatrix<f32> {
        let classes = PartOfSpeech::ALL.len();
        let one_hot = DMatrix::from_fn(classes, words.len(), |class, word| {
            f32::from(u8::from(words[word].1 as usize == class))
        });
        let mut seen = self.parts_of_speech.apply(&one_hot);
        for (mut column, (vector, _)) in seen.column_iter_mut().zip(words) {
            for (value, component) in column.iter_mut().zip(*vector) {
                *value += component;
            }
        }
        seen
    }
}
