use std::ops::Range;

use burn::module::{Module, Param};
use burn::tensor::Tensor;
use kinegrad_kernels::{Convolution, linear};

use crate::lora::Adaptable;
use crate::{Initializer, LoraConfig, LowRank};

/// `y = x W^T + b` with torch's layout: weight `[out, in]`, bias `[out]`. An adapter, if
/// there is one, changes the weight.
#[derive(Module, Debug)]
pub struct Linear {
    weight: Param<Tensor<2>>,
    bias: Param<Tensor<1>>,
    lora: Option<LowRank>,
}

impl Linear {
    /// A layer from `inputs` to `outputs` features.
    pub fn new(inputs: usize, outputs: usize, init: &Initializer) -> Self {
        Self {
            weight: init.uniform("weight", [outputs, inputs], inputs),
            bias: init.uniform("bias", [outputs], inputs),
            lora: None,
        }
    }

    /// The same with weight and bias zero at first.
    #[must_use]
    pub fn zeroed(self, init: &Initializer) -> Self {
        let [outputs, inputs] = self.weight.lazy_shape().dims();
        Self {
            weight: init.constant([outputs, inputs], 0.0),
            bias: init.constant([outputs], 0.0),
            ..self
        }
    }

    /// Features that it takes.
    pub fn inputs(&self) -> usize {
        let [_, inputs] = self.weight.lazy_shape().dims();
        inputs
    }

    /// # Shapes
    /// - x: `[rows, in]`
    /// - output: `[rows, out]`
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        linear(x, self.effective_weight(), self.bias.val())
    }

    /// The same map applied to every frame.
    ///
    /// # Shapes
    /// - x: `[batch, in, time]`
    /// - output: `[batch, out, time]`
    pub fn forward_frames(&self, x: Tensor<3>) -> Tensor<3> {
        Convolution::new(self.effective_weight().unsqueeze_dim(2), 1)
            .bias(self.bias.val())
            .forward(x)
    }

    /// [`forward_frames`](Self::forward_frames), added to `residual`, `[batch, out, time]`.
    pub fn forward_frames_onto(&self, residual: Tensor<3>, x: Tensor<3>) -> Tensor<3> {
        Convolution::new(self.effective_weight().unsqueeze_dim(2), 1)
            .bias(self.bias.val())
            .residual(residual)
            .forward(x)
    }

    /// The weight of some inputs: `[out, inputs]`.
    pub fn columns(&self, inputs: Range<usize>) -> Tensor<2> {
        let count = inputs.len();
        self.effective_weight().narrow(1, inputs.start, count)
    }

    fn effective_weight(&self) -> Tensor<2> {
        match &self.lora {
            Some(lora) => lora.apply(self.weight.val()),
            None => self.weight.val(),
        }
    }
}

/// `y = x W^T`: a linear map without a bias, weight `[out, in]`.
#[derive(Module, Debug)]
pub struct Unbiased {
    weight: Param<Tensor<2>>,
}

impl Unbiased {
    /// A map from `inputs` to `outputs` features.
    pub fn new(inputs: usize, outputs: usize, init: &Initializer) -> Self {
        Self {
            weight: init.uniform("weight", [outputs, inputs], inputs),
        }
    }

    /// The map of every frame.
    ///
    /// # Shapes
    /// - x: `[batch, in, time]`
    /// - output: `[batch, out, time]`
    pub fn forward_frames(&self, x: Tensor<3>) -> Tensor<3> {
        Convolution::new(self.weight.val().unsqueeze_dim(2), 1).forward(x)
    }
}

impl Adaptable for Linear {
    fn with_adapter(mut self, config: &LoraConfig, init: &Initializer) -> Self {
        let [outputs, inputs] = self.weight.lazy_shape().dims();
        self.lora = Some(LowRank::new(inputs, outputs, config, init));
        self
    }

    fn merge_adapter(mut self) -> Self {
        if let Some(lora) = self.lora.take() {
            self.weight = lora.merge(self.weight);
        }
        self
    }
}
