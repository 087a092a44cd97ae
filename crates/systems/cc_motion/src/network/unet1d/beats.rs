//! A beat tracker inside the audio encoder, trained on songs with known beats.

use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::activation::relu;
use kinegrad_kernels::{Activation, Lengths};
use kinegrad_models::Initializer;
use kinegrad_models::layers::{Conv1d, GroupNorm};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The source of the beats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Beats {
    /// The beat features, if `data.audio_features` lists them.
    #[default]
    Given,
    /// Tracked in the other features by a small network in the audio encoder. This tracker is
    /// trained on the beat features, which `data.audio_features` must list. The rest of the network
    /// is trained with the beat features and sampled with the tracked beats.
    Tracked,
}

impl Beats {
    pub(super) fn are_given(&self) -> bool {
        *self == Self::Given
    }
}

/// Number of beat and bar features, the last features of a frame; the first two are sine and cosine
/// of the beat.
pub const BEAT_CHANNELS: usize = 7;

/// Channels of a frame's beat phase: sine and cosine.
pub(super) const TRACKED: usize = 2;

/// Number of adjacent features that are averaged before differentiation.
const BAND: usize = 4;

/// Scale that brings differences of band features, with values from 0 to 1, near 1.
const NOVELTY_SCALE: f64 = 4.0;

const WIDTH: usize = 64;
const GROUPS: usize = 8;
const KERNEL: usize = 5;

/// Blocks of convolutions; the receptive field is 64 frames, about two seconds, on either side.
const BLOCKS: usize = 5;

/// Predicts each frame's beat phase from features of the music.
///
/// Onsets mark beats, while the levels of the features identify the song, which does not
/// generalize. The inputs are the frame-to-frame increases of means of four adjacent features. The
/// remaining features (loudness, brightness and onset strength) are unchanged.
///
/// ```text
/// h_0 = conv5(features)     h_(i+1) = h_i + conv5 of dilation 2^i (silu(norm(h_i)))
/// (sin, cos) = conv1(h_5)
/// ```
#[derive(Module, Debug)]
pub(super) struct BeatTracker {
    stem: Conv1d,
    blocks: Vec<Block>,
    head: Conv1d,
}

#[derive(Module, Debug)]
struct Block {
    norm: GroupNorm,
    conv: Conv1d,
}

impl BeatTracker {
    /// A tracker for music with `features` features.
    pub fn new(features: usize, init: &Initializer) -> Self {
        let block = |index: usize| {
            let init = init.at("blocks").at(&index.to_string());
            Block {
                norm: GroupNorm::new(WIDTH, GROUPS, &init.at("norm")),
                conv: Conv1d::new(WIDTH, WIDTH, KERNEL, &init.at("conv")),
            }
        };
        let inputs = features / BAND + features % BAND;
        Self {
            stem: Conv1d::new(inputs, WIDTH, KERNEL, &init.at("stem")),
            blocks: (0..BLOCKS).map(block).collect(),
            head: Conv1d::new(WIDTH, TRACKED, 1, &init.at("head")),
        }
    }

    /// Approximate number of values kept for the backward pass, per frame.
    pub const ACTIVATIONS: u64 = ((3 * BLOCKS + 2) * WIDTH) as u64;

    /// # Shapes
    /// - features: `[batch, features, time]`
    /// - output: sine and cosine, `[batch, 2, time]`
    pub fn forward(&self, features: Tensor<3>, lengths: Option<&Lengths>) -> Tensor<3> {
        let time = features.dims()[2];
        let mask = lengths.map(|lengths| lengths.mask(time, &features.device()));
        let masked = |x: Tensor<3>| match &mask {
            Some(mask) => x * mask.clone(),
            None => x,
        };
        let mut h = self.stem.forward(masked(novelty(features)));
        for (index, block) in self.blocks.iter().enumerate() {
            let norm = block.norm.operation().activation(Activation::Silu);
            let inner = masked(norm.lengths(lengths.cloned()).forward(h.clone()));
            h = h + dilated(&block.conv, inner, 1 << index);
        }
        self.head.forward(h)
    }
}

/// The beat labels in features `[batch, channels, time]`: sine and cosine, `[batch, 2, time]`, and
/// a mask, `[batch, 1, time]`. The mask is 1 where the labels form an angle; elsewhere the labels
/// are noise or absent.
pub fn beat_labels(features: &Tensor<3>) -> (Tensor<3>, Tensor<3>) {
    let first = features.dims()[1] - BEAT_CHANNELS;
    let labels = features.clone().narrow(1, first, TRACKED);
    let norm = labels.clone().square().sum_dim(1);
    let both = labels.clone().prod_dim(1).not_equal_elem(0.0).float();
    let known = (norm - 1.0).abs().lower_elem(1e-3).float() * both;
    (labels, known)
}

/// The frame-to-frame increases of means of four adjacent features, then the remaining features.
fn novelty(features: Tensor<3>) -> Tensor<3> {
    let [batch, channels, time] = features.dims();
    let bands = channels / BAND;
    let levels = features
        .clone()
        .narrow(1, 0, bands * BAND)
        .reshape([batch, bands, BAND, time])
        .mean_dim(2)
        .reshape([batch, bands, time]);
    let first = levels.clone().narrow(2, 0, 1).zeros_like();
    let increase = match time {
        1 => first,
        _ => {
            let [now, next] = [0, 1].map(|from| levels.clone().narrow(2, from, time - 1));
            Tensor::cat(vec![first, relu(next - now) * NOVELTY_SCALE], 2)
        }
    };
    match channels % BAND {
        0 => increase,
        rest => Tensor::cat(vec![increase, features.narrow(1, bands * BAND, rest)], 1),
    }
}

/// `conv` with taps `dilation` frames apart: every `dilation`-th frame forms one sequence.
fn dilated(conv: &Conv1d, x: Tensor<3>, dilation: usize) -> Tensor<3> {
    let [batch, channels, time] = x.dims();
    if dilation == 1 {
        return conv.forward(x);
    }
    let each = time.div_ceil(dilation);
    let x = match each * dilation - time {
        0 => x,
        missing => {
            let zeros = Tensor::zeros([batch, channels, missing], &x.device());
            Tensor::cat(vec![x, zeros], 2)
        }
    };
    let folded = x
        .reshape([batch, channels, each, dilation])
        .permute([0, 3, 1, 2])
        .reshape([batch * dilation, channels, each]);
    let y = conv.forward(folded);
    let outputs = y.dims()[1];
    y.reshape([batch, dilation, outputs, each])
        .permute([0, 2, 3, 1])
        .reshape([batch, outputs, each * dilation])
        .narrow(2, 0, time)
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use kinegrad_kernels::host_values;
    use kinegrad_random::{Key, Purpose};

    use super::*;

    fn normal(seed: u64, shape: [usize; 3], device: &Device) -> Tensor<3> {
        let values = Key::new(seed, Purpose::Noise).normals(shape.iter().product());
        Tensor::from_data(TensorData::new(values, shape), device)
    }

    #[test]
    fn taps_lie_a_dilation_apart() {
        let device = Device::flex();
        let conv = Conv1d::new(3, 2, KERNEL, &Initializer::new(1, &device));
        for (dilation, time) in [(1, 9), (2, 9), (4, 9), (4, 3), (8, 21)] {
            let x = normal(2, [2, 3, time], &device);
            let found = host_values(dilated(&conv, x.clone(), dilation));
            // Each tap separately, from the response to single frames.
            let bias = host_values(conv.forward(Tensor::zeros([1, 3, 1], &device)));
            let mut expected: Vec<f32> = (0..2 * 2 * time).map(|i| bias[i / time % 2]).collect();
            for from in 0..time {
                let frame = x.clone().narrow(2, from, 1);
                let around = Tensor::zeros([2, 3, 4], &device);
                let response = Tensor::cat(vec![around.clone(), frame, around], 2);
                let response = host_values(conv.forward(response));
                for tap in 0..KERNEL {
                    let to = from as isize + (tap as isize - 2) * dilation as isize;
                    if !(0..time as isize).contains(&to) {
                        continue;
                    }
                    for row in 0..4 {
                        let said = response[row * 9 + 2 + tap] - bias[row % 2];
                        expected[row * time + to as usize] += said;
                    }
                }
            }
            for (a, b) in found.iter().zip(&expected) {
                assert!((a - b).abs() < 1e-5, "{dilation} {time}: {a} {b}");
            }
        }
    }

    #[test]
    fn novelty_is_what_begins_and_what_is_left_over() {
        let device = Device::flex();
        let rows = [
            [0.0, 0.4, 0.4, 0.0],
            [0.0, 0.4, 0.4, 0.0],
            [0.0, 0.0, 0.4, 0.0],
            [0.0, 0.0, 0.0, 0.0],
            [0.5, 0.25, 0.5, 0.25],
        ];
        let x = TensorData::new(rows.concat(), [1, 5, 4]);
        let found = novelty(Tensor::from_data(x, &device));
        assert_eq!(found.dims(), [1, 2, 4]);
        let expected = [0.0, 0.8, 0.4, 0.0, 0.5, 0.25, 0.5, 0.25];
        for (a, b) in host_values(found).iter().zip(expected) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
        assert_eq!(novelty(normal(1, [2, 8, 1], &device)).dims(), [2, 2, 1]);
    }

    #[test]
    fn padding_has_no_effect() {
        let device = Device::flex();
        let tracker = BeatTracker::new(11, &Initializer::new(1, &device));
        let head = normal(3, [2, 11, 31], &device);
        let lengths = Lengths::new([31, 31]);
        let tracked = |padding: u64| {
            let padding = normal(padding, [2, 11, 9], &device);
            let x = Tensor::cat(vec![head.clone(), padding], 2);
            host_values(tracker.forward(x, Some(&lengths)).narrow(2, 0, 31))
        };
        assert_eq!(tracked(4), tracked(5));
        for (a, b) in tracked(4)
            .iter()
            .zip(host_values(tracker.forward(head.clone(), None)))
        {
            assert!((a - b).abs() < 1e-5, "{a} {b}");
        }
    }
}
