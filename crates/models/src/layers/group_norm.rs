use burn::module::{Module, Param};
use burn::tensor::Tensor;

use crate::Initializer;

/// Groups of every normalisation of the UNet (CC-MotionGen documentation, section 3.1.3).
pub const GROUPS: usize = 32;

/// Added to the variance.
pub const GROUP_NORM_EPS: f64 = 1e-5;

/// Normalises each of [`GROUPS`] groups of channels over channels and time (biased variance),
/// then scales and shifts each channel: weight and bias `[channels]`.
#[derive(Module, Debug)]
pub struct GroupNorm {
    weight: Param<Tensor<1>>,
    bias: Param<Tensor<1>>,
}

impl GroupNorm {
    /// A normalisation of `channels`, which must be a multiple of [`GROUPS`].
    pub fn new(channels: usize, init: &Initializer) -> Self {
        Self {
            weight: init.constant([channels], 1.0),
            bias: init.constant([channels], 0.0),
        }
    }

    /// # Shapes
    /// - x, output: `[batch, channels, time]`
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let [batch, channels, time] = x.dims();
        let x = x.reshape([batch, GROUPS, channels / GROUPS * time]);
        let x = x.clone() - x.mean_dim(2);
        let variance = x.clone().square().mean_dim(2);
        let x = x / variance.add_scalar(GROUP_NORM_EPS).sqrt();
        let per_channel = |p: &Param<Tensor<1>>| p.val().reshape([1, channels, 1]);
        x.reshape([batch, channels, time]) * per_channel(&self.weight) + per_channel(&self.bias)
    }
}
