use burn::module::{Module, Param};
use burn::tensor::Tensor;

use crate::Initializer;

/// `y = x W^T + b` with torch's layout: weight `[out, in]`, bias `[out]`.
#[derive(Module, Debug)]
pub struct Linear {
    weight: Param<Tensor<2>>,
    bias: Param<Tensor<1>>,
}

impl Linear {
    /// A layer from `inputs` to `outputs` features.
    pub fn new(inputs: usize, outputs: usize, init: &Initializer) -> Self {
        Self {
            weight: init.uniform("weight", [outputs, inputs], inputs),
            bias: init.uniform("bias", [outputs], inputs),
        }
    }

    /// # Shapes
    /// - x: `[batch, in]`
    /// - output: `[batch, out]`
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        x.matmul(self.weight.val().transpose()) + self.bias.val().unsqueeze()
    }

    /// The same map applied to every frame.
    ///
    /// # Shapes
    /// - x: `[batch, in, time]`
    /// - output: `[batch, out, time]`
    pub fn forward_frames(&self, x: Tensor<3>) -> Tensor<3> {
        super::conv1d::convolve(x, self.weight.val().unsqueeze_dim(2), self.bias.val(), 1)
    }
}
