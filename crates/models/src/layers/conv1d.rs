use burn::module::{Module, Param};
use burn::tensor::module::conv1d;
use burn::tensor::ops::ConvOptions;
use burn::tensor::Tensor;

use crate::Initializer;

/// A convolution over time with torch's layout: weight `[out, in, kernel]`, bias `[out]`. Odd
/// kernels are padded by half, so that stride 1 keeps the length.
#[derive(Module, Debug)]
pub struct Conv1d {
    weight: Param<Tensor<3>>,
    bias: Param<Tensor<1>>,
    stride: usize,
    padding: usize,
}

impl Conv1d {
    /// A convolution that keeps the length.
    pub fn new(inputs: usize, outputs: usize, kernel_size: usize, init: &Initializer) -> Self {
        Self::strided(inputs, outputs, kernel_size, 1, init)
    }

    /// A convolution that maps `time` frames to `ceil(time / stride)`.
    pub fn strided(
        inputs: usize,
        outputs: usize,
        kernel_size: usize,
        stride: usize,
        init: &Initializer,
    ) -> Self {
        let fan_in = inputs * kernel_size;
        Self {
            weight: init.uniform("weight", [outputs, inputs, kernel_size], fan_in),
            bias: init.uniform("bias", [outputs], fan_in),
            stride,
            padding: kernel_size / 2,
        }
    }

    /// # Shapes
    /// - x: `[batch, in, time]`
    /// - output: `[batch, out, ceil(time / stride)]`
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let options = ConvOptions::new([self.stride], [self.padding], [1], 1);
        conv1d(x, self.weight.val(), Some(self.bias.val()), options)
    }
}

/// A convolution of kernel 1: a linear map of every frame.
pub(super) fn pointwise(x: Tensor<3>, weight: Tensor<3>, bias: Tensor<1>) -> Tensor<3> {
    conv1d(x, weight, Some(bias), ConvOptions::new([1], [0], [1], 1))
}
