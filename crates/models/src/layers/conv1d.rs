use burn::module::{Module, Param};
use burn::tensor::Tensor;
use kinegrad_kernels::Convolution;

use crate::lora::Adaptable;
use crate::{Initializer, LoraConfig, LowRank};

/// A convolution over time with torch's layout: weight `[out, in, kernel]`, bias `[out]`. Kernels
/// are padded by `(kernel - 1) / 2`. An optional adapter changes the weight.
#[derive(Module, Debug)]
pub struct Conv1d {
    weight: Param<Tensor<3>>,
    bias: Param<Tensor<1>>,
    lora: Option<LowRank>,
    stride: usize,
}

impl Conv1d {
    /// A convolution that keeps the length; `kernel_size` is odd.
    pub fn new(inputs: usize, outputs: usize, kernel_size: usize, init: &Initializer) -> Self {
        Self::strided(inputs, outputs, kernel_size, 1, init)
    }

    /// A convolution that maps `time` frames to `ceil(time / stride)` with an odd kernel, and to
    /// `floor(time / 2)` with a kernel of 4 and stride 2.
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
            lora: None,
            stride,
        }
    }

    /// The layer with zeros as initial weight and bias.
    #[must_use]
    pub fn zeroed(self, init: &Initializer) -> Self {
        let [outputs, inputs, kernel_size] = self.weight.lazy_shape().dims();
        Self {
            weight: init.constant([outputs, inputs, kernel_size], 0.0),
            bias: init.constant([outputs], 0.0),
            ..self
        }
    }

    /// # Shapes
    /// - x: `[batch, in, time]`
    /// - output: `[batch, out, frames]`
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        self.operation().forward(x)
    }

    /// The convolution as an operation that can be fused with others.
    pub fn operation(&self) -> Convolution {
        let weight = match &self.lora {
            Some(lora) => lora.apply(self.weight.val()),
            None => self.weight.val(),
        };
        Convolution::new(weight, self.stride).bias(self.bias.val())
    }
}

impl Adaptable for Conv1d {
    fn with_adapter(mut self, config: &LoraConfig, init: &Initializer) -> Self {
        let [outputs, inputs, kernel] = self.weight.lazy_shape().dims();
        self.lora = Some(LowRank::new(inputs * kernel, outputs, config, init));
        self
    }

    fn merge_adapter(mut self) -> Self {
        if let Some(lora) = self.lora.take() {
            self.weight = lora.merge(self.weight);
        }
        self
    }
}
