use burn::module::{Module, Param};
use burn::tensor::Tensor;
use kinegrad_kernels::Convolution;

use crate::Initializer;

/// A transposed convolution over time with torch's layout: weight `[in, out, kernel]`, bias
/// `[out]`.
#[derive(Module, Debug)]
pub struct ConvTranspose1d {
    weight: Param<Tensor<3>>,
    bias: Param<Tensor<1>>,
    stride: usize,
    padding: usize,
}

impl ConvTranspose1d {
    /// A convolution that maps `time` frames to `2 time`: kernel 4, stride 2, padding 1.
    pub fn doubling(channels: usize, init: &Initializer) -> Self {
        const KERNEL: usize = 4;
        // PyTorch computes the fan-in from the second axis, here the outputs.
        let fan_in = channels * KERNEL;
        Self {
            weight: init.uniform("weight", [channels, channels, KERNEL], fan_in),
            bias: init.uniform("bias", [channels], fan_in),
            stride: 2,
            padding: 1,
        }
    }

    /// # Shapes
    /// - x: `[batch, in, time]`
    /// - output: `[batch, out, 2 time]`
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        Convolution::transposed(self.weight.val(), self.stride, self.padding)
            .bias(self.bias.val())
            .forward(x)
    }
}
