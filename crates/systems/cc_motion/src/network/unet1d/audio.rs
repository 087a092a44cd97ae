//! The audio condition of the UNet.

use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::module::avg_pool1d;
use burn::tensor::ops::AvgPoolOptions;
use kinegrad_kernels::{Activation, Convolution, Lengths};
use kinegrad_models::Initializer;
use kinegrad_models::layers::{Conv1d, GROUPS, GroupNorm};
use kinegrad_models::lora::{Adapting, LoraTarget};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::StyleCondition;
use super::adapters::numbered;
use super::beats::{BEAT_CHANNELS, BeatTracker, TRACKED, beat_labels};
use super::constant_tempo::fit_constant_tempo;

/// Kernel size of the encoder's convolutions, except downsampling convolutions.
const KERNEL: usize = 5;

/// Number of frames for means, about two seconds.
const AROUND: usize = 61;

/// Norm of sine and cosine below which an angle is undefined.
const SMALLEST_NORM: f64 = 1e-3;

/// The input of audio features into the network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AudioConditioning {
    /// CC-MotionGen: a linear layer per frame, and cross-attention without positions to all frames.
    /// Attention is over a set, so the network cannot determine the time of sounds. Padding is
    /// treated as motion.
    #[default]
    Ccmotion,
    /// A temporal convolution encoder whose output joins each level frame by frame, and
    /// cross-attention with rotary positions. Padding is masked.
    Aligned,
}

/// The condition of a batch of motions.
#[derive(Clone, Debug)]
pub struct AudioCondition {
    /// Audio features, `[batch, cond_channels, time]`; zeros are the null condition.
    pub features: Tensor<3>,
    /// Real frames of each sample; all frames if `None`. [`AudioConditioning::Ccmotion`] ignores
    /// the lengths.
    pub lengths: Option<Lengths>,
    /// The style of each sample; the null style if `None`. Networks without style ignore this
    /// field.
    pub style: Option<StyleCondition>,
    /// Replaces tracked beats by existing beat labels. Training sets this flag, because the tracker
    /// is poor at first, and later nearly perfect only on the training songs.
    pub teacher_forcing: bool,
}

impl AudioCondition {
    /// The condition without audio and style: features of zeros. In aligned networks, the encoder's
    /// biases learn the embedding of the null condition.
    #[must_use]
    pub fn null(&self) -> Self {
        Self {
            features: self.features.zeros_like(),
            style: self.style.as_ref().map(StyleCondition::null),
            ..self.clone()
        }
    }

    /// The same audio with the null style; `None` without a style.
    #[must_use]
    pub fn null_style(&self) -> Option<Self> {
        let style = Some(self.style.as_ref()?.null());
        Some(Self {
            style,
            ..self.clone()
        })
    }
}

impl From<Tensor<3>> for AudioCondition {
    /// Features of clips without padding.
    fn from(features: Tensor<3>) -> Self {
        Self {
            features,
            lengths: None,
            style: None,
            teacher_forcing: false,
        }
    }
}

/// The audio features of each level of the UNet, with the lengths of the samples at the level.
pub(super) struct AudioContext(pub Vec<(Tensor<3>, Option<Lengths>)>);

impl AudioContext {
    /// At level `level`: `[batch, width, time of the level]`.
    pub fn context(&self, level: usize) -> Tensor<3> {
        self.0[level].0.clone()
    }

    /// Number of real frames of each sample at a level.
    pub fn lengths(&self, level: usize) -> Option<&Lengths> {
        self.0[level].1.as_ref()
    }

    /// The convolution `conv` with output at `level`, plus the audio context of `level`.
    pub fn join(&self, layer: &Option<Conv1d>, level: usize, conv: Convolution) -> Convolution {
        match layer {
            Some(layer) => conv.residual(layer.forward(self.context(level))),
            None => conv,
        }
    }
}

/// The features without the beat labels.
fn without_labels(features: Tensor<3>) -> Tensor<3> {
    let channels = features.dims()[1];
    features.narrow(1, 0, channels - BEAT_CHANNELS)
}

/// The mean of each feature over the real frames among the [`AROUND`] frames around each frame.
pub(super) fn mean_around(features: Tensor<3>, lengths: Option<&Lengths>) -> Tensor<3> {
    let [batch, _, time] = features.dims();
    let device = features.device();
    let mask = match lengths {
        Some(lengths) => lengths.mask(time, &device),
        None => Tensor::ones([batch, 1, time], &device),
    };
    let around = AvgPoolOptions::new([AROUND])
        .with_stride([1])
        .with_padding([AROUND / 2]);
    let mean = |x| avg_pool1d(x, around.clone());
    let share = mean(mask.clone()).clamp_min(1.0 / AROUND as f64);
    mean(features * mask) / share
}

/// Sine and cosine of the same angle with a norm of one. The tracker's norm is near one on training
/// songs. On other songs, the norm is smaller and outside the training range.
fn direction(beats: Tensor<3>) -> Tensor<3> {
    let norm = (beats.clone().square().sum_dim(1) + SMALLEST_NORM * SMALLEST_NORM).sqrt();
    beats / norm
}

/// The audio encoder: features with the lengths and widths of the UNet's levels; the width is at
/// most `context_dim`.
///
/// ```text
/// a_0 = block(conv5(features))        block(a) = a + conv5(silu(norm(a)))
/// a_i = block(conv3 with stride 2(a_(i-1)))
/// ```
///
/// Lengths are halved as in the UNet: frame `j` of a level is centered on frame `2 j` of the finer
/// level, and `n` frames become `ceil(n / 2)`. Frame `j` of `a_i` and frame `j` of the UNet's level
/// `i` have the same time.
#[derive(Module, Debug)]
pub(super) struct AudioEncoder {
    /// Replaces the beat features.
    beats: Option<BeatTracker>,
    stem: Conv1d,
    levels: Vec<AudioLevel>,
}

/// One level of the encoder.
#[derive(Module, Debug)]
struct AudioLevel {
    down: Option<Conv1d>,
    norm: GroupNorm,
    conv: Conv1d,
}

/// Channels of the encoder's levels for a UNet with these channels.
pub(super) fn widths(channels: &[usize], context_dim: usize) -> Vec<usize> {
    let widths = channels.iter().map(|&width| width.min(context_dim));
    widths.collect()
}

impl AudioEncoder {
    /// An encoder of `inputs` features with levels of these `widths`, multiples of 32. If the
    /// encoder `tracks` beats, the last [`BEAT_CHANNELS`] features are only labels of the tracker.
    pub fn new(inputs: usize, widths: &[usize], tracks: bool, init: &Initializer) -> Self {
        let beats = tracks.then(|| BeatTracker::new(inputs - BEAT_CHANNELS, &init.at("beats")));
        let inputs = if tracks {
            inputs - BEAT_CHANNELS + TRACKED
        } else {
            inputs
        };
        let level = |level: usize| {
            let init = init.at("levels").at(&level.to_string());
            let width = widths[level];
            AudioLevel {
                down: (level > 0)
                    .then(|| Conv1d::strided(widths[level - 1], width, 3, 2, &init.at("down"))),
                norm: GroupNorm::new(width, GROUPS, &init.at("norm")),
                conv: Conv1d::new(width, width, KERNEL, &init.at("conv")),
            }
        };
        Self {
            beats,
            stem: Conv1d::new(inputs, widths[0], KERNEL, &init.at("stem")),
            levels: (0..widths.len()).map(level).collect(),
        }
    }

    /// The features of each level.
    ///
    /// # Shapes
    /// - features: `[batch, inputs, time]`
    pub fn forward(&self, cond: AudioCondition) -> AudioContext {
        let (features, mut lengths) = (cond.features, cond.lengths);
        let stem = self.stem.operation().lengths(lengths.clone());
        let features = match self.find(features.clone(), lengths.as_ref()) {
            Some(mut beats) => {
                if cond.teacher_forcing {
                    let (labels, known) = beat_labels(&features);
                    beats = labels * known.clone() + beats * (known.neg() + 1.0);
                }
                // Unaveraged features contain the onsets; with few songs, a network memorizes the
                // onsets.
                let sounds = mean_around(without_labels(features), lengths.as_ref());
                Tensor::cat(vec![sounds, beats], 1)
            }
            None => features,
        };
        let mut h = stem.forward(features);
        let mut context = Vec::with_capacity(self.levels.len());
        for level in &self.levels {
            if let Some(down) = &level.down {
                h = down.operation().lengths(lengths.clone()).forward(h);
                lengths = lengths.map(|lengths| lengths.halved());
            }
            let norm = level.norm.operation().activation(Activation::Silu);
            let conv = level.conv.operation().norm(norm.lengths(lengths.clone()));
            h = conv.residual(h.clone()).forward(h);
            context.push((h.clone(), lengths.clone()));
        }
        AudioContext(context)
    }

    /// Sine and cosine of each frame's beat phase by the tracker, if any: `[batch, 2, time]`.
    pub fn track(&self, features: Tensor<3>, lengths: Option<&Lengths>) -> Option<Tensor<3>> {
        let beats = self.beats.as_ref()?;
        Some(beats.forward(without_labels(features), lengths))
    }

    /// The constant tempo fitted to the tracked beats, with a norm of one, and zeros in silence.
    /// Gradients do not reach the tracker.
    pub fn find(&self, features: Tensor<3>, lengths: Option<&Lengths>) -> Option<Tensor<3>> {
        let found = self.track(features.clone(), lengths)?.detach();
        let loudest = without_labels(features).detach().abs();
        let sounds = loudest.max_dim(2).max_dim(1).greater_elem(0.0).float();
        Some(direction(fit_constant_tempo(found, lengths)) * sounds)
    }

    pub fn adapting(self, adapting: &Adapting<'_>) -> Self {
        let layer =
            |at: &Adapting<'_>, name: &str, conv| at.layer(LoraTarget::Conditioning, name, conv);
        Self {
            beats: self.beats,
            stem: layer(adapting, "stem", self.stem),
            levels: numbered(self.levels, &adapting.at("levels"), |level, at| {
                AudioLevel {
                    down: level.down.map(|down| layer(at, "down", down)),
                    conv: layer(at, "conv", level.conv),
                    ..level
                }
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use kinegrad_kernels::host_values;

    use super::*;

    /// A feature that is `level` in the first `frames` of 90 frames, plus 1 in frame `at`.
    fn click(at: usize, level: f32, frames: usize, padding: f32) -> Vec<f32> {
        let device = Device::flex();
        let mut row = vec![level; 90];
        row[frames..].fill(padding);
        row[at] += 1.0;
        let row = Tensor::from_data(TensorData::new(row, [1, 1, 90]), &device);
        host_values(mean_around(row, Some(&Lengths::new([frames]))))
    }

    #[test]
    fn means_depend_little_on_the_time_of_an_onset() {
        let (before, after) = (click(40, 0.5, 77, 0.0), click(41, 0.5, 77, 9.0));
        for (t, (a, b)) in before.iter().zip(&after).take(77).enumerate() {
            let frames = (t.min(AROUND / 2) + 1 + (76 - t).min(AROUND / 2)) as f32;
            let in_window = t.abs_diff(40) <= AROUND / 2;
            let expected = 0.5 + if in_window { 1.0 / frames } else { 0.0 };
            assert!((a - expected).abs() < 1e-5, "{t}: {a} {expected}");
            assert!((a - b).abs() < 0.03, "{t}: {a} {b}");
        }
    }

    #[test]
    fn directions_have_a_norm_of_one_and_nothing_has_none() {
        let pairs = [[0.3f32, -2e-2, 0.0], [0.4, 0.0, 0.0]].concat();
        let pairs = Tensor::from_data(TensorData::new(pairs, [1, 2, 3]), &Device::flex());
        let expected = [0.6, -1.0, 0.0, 0.8, 0.0, 0.0];
        for (a, b) in host_values(direction(pairs)).iter().zip(expected) {
            assert!((a - b).abs() < 2e-3, "{a} {b}");
        }
    }
}
