//! The decoder from a sampler's latent to motion in physical units (CC-MotionGen, section 3.3;
//! docs/sources.md, section 1.6).

mod coherent;
mod config;
mod heading;
mod identity;
mod orientation;

use std::sync::Arc;

use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::activation::{relu, sigmoid, silu};
use kinegrad_kernels::{gelu, linear_map};
use kinegrad_models::layers::{BatchNorm, LayerNorm, Linear};
use kinegrad_models::{Dropout, DropoutKey, Initializer};
use kinegrad_motion::ChannelEncoding;
use kinegrad_motion::phrase::{ANGULAR_VELOCITY, CHANNELS, FPS, QUATERNION};
use kinegrad_settings::{InvalidSetting, Refused, in_range};

use crate::network::channel_encoding::{decode, sign_continuous};
use crate::network::rotation::angular_velocity;
use coherent::{ESTIMATES, Fits};

pub use config::{
    Coherence, DecoderActivation, DecoderConfig, DecoderInit, OutputActivation, OutputActivations,
    OutputRanges,
};

/// A quaternion with a smaller norm is not normalized.
const LEAST_NORM: f64 = 1e-12;

/// Mean and standard deviation of each latent channel, in the denoiser's [`ChannelEncoding`].
#[derive(Clone, Debug, PartialEq)]
pub struct Normalization {
    /// Subtracted mean.
    pub mean: Vec<f64>,
    /// Standard deviation divided by.
    pub std: Vec<f64>,
}

/// The normalization at the start of a block.
#[derive(Module, Debug)]
enum BlockNorm {
    Layer(LayerNorm),
    Batch(BatchNorm),
}

/// `h + Linear(act(Linear(norm(h))))`, four times as wide inside: a torch `Sequential` of LayerNorm
/// or BatchNorm, Linear, activation, Dropout, Linear, Dropout.
#[derive(Module, Debug)]
struct DecoderBlock {
    layers_at_0: BlockNorm,
    layers_at_1: Linear,
    layers_at_4: Linear,
    dropout: Dropout,
    dropout_out: Dropout,
    #[module(skip)]
    activation: DecoderActivation,
}

impl DecoderBlock {
    fn forward(&self, h: Tensor<2>, dropout: DropoutKey) -> Tensor<2> {
        let normalized = match &self.layers_at_0 {
            BlockNorm::Layer(norm) => norm.forward(h.clone()),
            // Only training passes have a key.
            BlockNorm::Batch(norm) => norm.forward(h.clone(), dropout.is_some()),
        };
        let inner = self.layers_at_1.forward(normalized);
        let inner = match self.activation {
            DecoderActivation::Gelu => gelu(inner),
            DecoderActivation::Relu => relu(inner),
            DecoderActivation::Silu => silu(inner),
        };
        let inner = self.dropout.forward(inner, dropout);
        let inner = self.layers_at_4.forward(inner);
        h + self.dropout_out.forward(inner, dropout)
    }
}

/// Decodes each frame separately: an input projection, residual blocks, a linear head and an
/// activation for each component. The optional projection onto coherent motion couples the frames.
/// Should be created with [`DecoderConfig::init`].
///
/// The latent is the normalized motion that a sampler generates. The output is in meters, seconds
/// and radians. The heads predict the denoiser's [`ChannelEncoding`]; phase and orientation are
/// converted at the end.
#[derive(Module, Debug)]
pub struct MotionDecoder {
    input_proj: Linear,
    blocks: Vec<DecoderBlock>,
    position_head: Linear,
    velocity_head: Linear,
    acceleration_head: Linear,
    quaternion_head: Linear,
    angular_velocity_head: Linear,
    phase_head: Linear,
    style_head: Linear,
    #[module(skip)]
    activations: OutputActivations,
    #[module(skip)]
    ranges: OutputRanges,
    #[module(skip)]
    coherence: Coherence,
    #[module(skip)]
    normalization: Normalization,
    #[module(skip)]
    targets: ChannelEncoding,
}

impl DecoderConfig {
    /// Builds the decoder for latents of the 25 channels, normalized by `normalization`.
    ///
    /// # Errors
    /// As [`validate`](Self::validate).
    ///
    /// # Panics
    /// Panics if the normalization does not have 25 channels.
    pub fn init(
        &self,
        normalization: Normalization,
        init: &Initializer,
    ) -> Result<MotionDecoder, InvalidSetting> {
        self.init_for(ChannelEncoding::default(), normalization, init)
    }

    /// [`init`](Self::init) for latents of these `targets`. The activations of phase and quaternion
    /// apply only to the stored encodings, because the conversion bounds both.
    ///
    /// # Errors
    /// As [`validate`](Self::validate); also if the identity does not fit into `hidden_dim`.
    ///
    /// # Panics
    /// Panics if the normalization has other channels.
    pub fn init_for(
        &self,
        targets: ChannelEncoding,
        normalization: Normalization,
        init: &Initializer,
    ) -> Result<MotionDecoder, InvalidSetting> {
        self.validate()?;
        let channels = targets.channels();
        assert_eq!(normalization.mean.len(), channels, "means");
        assert_eq!(normalization.std.len(), channels, "deviations");
        let hidden = self.hidden_dim;
        if self.init == DecoderInit::Identity {
            in_range("decoder.hidden_dim", hidden, channels..)
                .hint("the identity needs one for each channel of the latent")?;
        }
        let activations = self.output_activations.of(targets);
        let head =
            |name: &str, outputs| Linear::new(hidden, outputs, &init.at(&format!("{name}_head")));
        let decoder = MotionDecoder {
            input_proj: Linear::new(channels, hidden, &init.at("input_proj")),
            blocks: (0..self.num_layers)
                .map(|i| {
                    let init = init.at("blocks").at(&i.to_string()).at("layers");
                    DecoderBlock {
                        layers_at_0: match self.use_layer_norm {
                            true => BlockNorm::Layer(LayerNorm::new(hidden, &init.at("0"))),
                            false => BlockNorm::Batch(BatchNorm::new(hidden, &init.at("0"))),
                        },
                        layers_at_1: Linear::new(hidden, 4 * hidden, &init.at("1")),
                        layers_at_4: Linear::new(4 * hidden, hidden, &init.at("4")),
                        dropout: Dropout::new(self.dropout, 2 * i),
                        dropout_out: Dropout::new(self.dropout, 2 * i + 1),
                        activation: self.activation,
                    }
                })
                .collect(),
            position_head: head("position", 3),
            velocity_head: head("velocity", 3),
            acceleration_head: head("acceleration", 3),
            quaternion_head: head("quaternion", targets.orientation_channels().len()),
            angular_velocity_head: head("angular_velocity", 3),
            phase_head: head("phase", targets.phase_channels().len()),
            style_head: head("style", 8),
            activations,
            ranges: self.output_ranges,
            coherence: self.coherence,
            normalization,
            targets,
        };
        Ok(match self.init {
            DecoderInit::Random => decoder,
            DecoderInit::Identity => identity::identity(decoder),
        })
    }
}

impl MotionDecoder {
    /// # Shapes
    /// - latent: `[batch, channels, time]`, normalized; 25 channels, or the channels of the targets
    /// - output: `[batch, 25, time]`, physical units
    pub fn forward(&self, latent: Tensor<3>, dropout: DropoutKey) -> Tensor<3> {
        let motion = self.frames(latent, dropout);
        match self.coherence {
            Coherence::None => motion,
            Coherence::Projection | Coherence::Full => self.project(motion),
        }
    }

    /// Consistency of position, velocity and acceleration.
    pub fn coherence(&self) -> Coherence {
        self.coherence
    }

    /// [`forward`](Self::forward) without coherence: each frame separately.
    pub fn frames(&self, latent: Tensor<3>, dropout: DropoutKey) -> Tensor<3> {
        let [batch, channels, time] = latent.dims();
        let rows = latent.swap_dims(1, 2).reshape([batch * time, channels]);
        let mut h = self.input_proj.forward(rows);
        for block in &self.blocks {
            h = block.forward(h, dropout);
        }
        let heads = [
            &self.position_head,
            &self.velocity_head,
            &self.acceleration_head,
            &self.quaternion_head,
            &self.angular_velocity_head,
            &self.phase_head,
            &self.style_head,
        ];
        let bounds = self.bounds().into_iter();
        let components = heads
            .into_iter()
            .zip(bounds)
            .map(|(head, (activation, range))| bounded(head.forward(h.clone()), activation, range))
            .collect();
        let motion = Tensor::cat(components, 1)
            .reshape([batch, time, channels])
            .swap_dims(1, 2);
        decode(self.targets, motion)
    }

    /// Activation and range of each component, in the order of the channels.
    fn bounds(&self) -> [(OutputActivation, f64); 7] {
        let (bounds, ranges) = (&self.activations, &self.ranges);
        [
            (bounds.position, ranges.position),
            (bounds.velocity, ranges.velocity),
            (bounds.acceleration, ranges.acceleration),
            (bounds.quaternion, 1.0),
            (bounds.angular_velocity, ranges.angular_velocity),
            (bounds.phase, 1.0),
            (bounds.style, ranges.style),
        ]
    }

    /// Replaces position, velocity and acceleration by the nearest coherent trajectory. Under
    /// [`Coherence::Full`], fits headings and quaternions to themselves and to the angular
    /// velocities. Signs become continuous; angular velocities become the derivatives of the
    /// quaternions.
    fn project(&self, motion: Tensor<3>) -> Tensor<3> {
        let [batch, _, time] = motion.dims();
        let fits = Fits::new(time, &self.normalization.std);
        let estimates = motion.clone().slice([0..batch, ESTIMATES]);
        let position = linear_map(estimates, Arc::new(fits));
        let velocity = differences(position.clone());
        let acceleration = differences(velocity.clone());
        let part = |channels| motion.clone().slice([0..batch, channels]);
        let quaternion = match self.coherence {
            Coherence::Full => {
                let rates = &self.normalization.std[self.targets.angular_velocity_channels()];
                let (quaternion, turning) =
                    heading::fitted(part(QUATERNION), part(ANGULAR_VELOCITY), rates);
                orientation::fitted(quaternion, turning, rates)
            }
            Coherence::Projection | Coherence::None => sign_continuous(part(QUATERNION)),
        };
        let turning = match time {
            1 => part(ANGULAR_VELOCITY),
            _ => {
                let turning = angular_velocity(quaternion.clone());
                let last = turning.clone().narrow(2, time - 2, 1);
                Tensor::cat(vec![turning, last], 2)
            }
        };
        Tensor::cat(
            vec![
                position.narrow(2, 0, time),
                velocity.narrow(2, 0, time),
                acceleration,
                quaternion,
                turning,
                motion.slice([0..batch, ANGULAR_VELOCITY.end..CHANNELS]),
            ],
            1,
        )
    }
}

fn bounded(y: Tensor<2>, activation: OutputActivation, range: f64) -> Tensor<2> {
    match activation {
        OutputActivation::None => y,
        OutputActivation::TanhScaled => y.tanh() * range,
        OutputActivation::Sigmoid => sigmoid(y),
        OutputActivation::Normalize => {
            // The square root's gradient at zero is infinite, so the square has a lower bound.
            let square = y.clone().square().sum_dim(1);
            y / square.clamp_min(LEAST_NORM * LEAST_NORM).sqrt()
        }
    }
}

/// Forward differences over time, per second: `[batch, channels, time - 1]`.
fn differences(x: Tensor<3>) -> Tensor<3> {
    let time = x.dims()[2];
    (x.clone().narrow(2, 1, time - 1) - x.narrow(2, 0, time - 1)) * FPS
}

#[cfg(test)]
mod tests;
