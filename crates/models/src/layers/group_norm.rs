use burn::module::{Module, Param};
use burn::tensor::Tensor;
use kinegrad_kernels as kernels;

use crate::Initializer;

/// Number of groups of all normalizations of the audio-conditioned UNet (CC-MotionGen, section
/// 3.1.3; docs/sources.md, section 1.5).
pub const GROUPS: usize = 32;

/// Added to the variance.
pub const GROUP_NORM_EPS: f64 = 1e-5;

/// Normalizes each group of channels over channels and time (biased variance), then scales and
/// shifts each channel: weight and bias `[channels]`.
#[derive(Module, Debug)]
pub struct GroupNorm {
    weight: Param<Tensor<1>>,
    bias: Param<Tensor<1>>,
    groups: usize,
}

impl GroupNorm {
    /// A normalization of `channels` channels, a multiple of `groups`.
    pub fn new(channels: usize, groups: usize, init: &Initializer) -> Self {
        Self {
            weight: init.constant([channels], 1.0),
            bias: init.constant([channels], 0.0),
            groups,
        }
    }

    /// The normalization as an operation that can be fused with others.
    pub fn operation(&self) -> kernels::GroupNorm {
        kernels::GroupNorm::new(
            self.weight.val(),
            self.bias.val(),
            self.groups,
            GROUP_NORM_EPS,
        )
    }
}
