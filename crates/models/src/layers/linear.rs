use std::ops::Range;

use burn::module::{Module, Param};
use burn::tensor::{Int, Tensor};
use kinegrad_kernels::{Convolution, linear};

use crate::lora::Adaptable;
use crate::{Initializer, LoraConfig, LowRank};

/// `y = x W^T + b` with torch's layout: weight `[out, in]`, bias `[out]`. An optional adapter
/// changes the weight.
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

    /// The layer with zeros as initial weight and bias.
    #[must_use]
    pub fn zeroed(self, init: &Initializer) -> Self {
        let [outputs, inputs] = self.weight.lazy_shape().dims();
        Self {
            weight: init.constant([outputs, inputs], 0.0),
            bias: init.constant([outputs], 0.0),
            ..self
        }
    }

    /// Input features.
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

    /// The map of every frame.
    ///
    /// # Shapes
    /// - x: `[batch, in, time]`
    /// - output: `[batch, out, time]`
    pub fn forward_frames(&self, x: Tensor<3>) -> Tensor<3> {
        self.operation().forward(x)
    }

    /// `residual`, `[batch, out, time]`, plus [`forward_frames`](Self::forward_frames).
    pub fn forward_frames_onto(&self, residual: Tensor<3>, x: Tensor<3>) -> Tensor<3> {
        self.operation().residual(residual).forward(x)
    }

    /// The map of every frame as an operation that can be fused with others.
    pub fn operation(&self) -> Convolution {
        let weight = self.effective_weight().unsqueeze_dim(2);
        Convolution::new(weight, 1).bias(self.bias.val())
    }

    /// [`forward_frames`](Self::forward_frames) of the concatenated inputs `own` and `shared`. All
    /// frames of a sample have the same `shared`, which is multiplied once.
    ///
    /// # Shapes
    /// - own: `[batch, some, time]`
    /// - shared: `[batch, in - some]`
    /// - output: `[batch, out, time]`
    pub fn forward_frames_sharing(&self, own: Tensor<3>, shared: Tensor<2>) -> Tensor<3> {
        let [batch, some, time] = own.dims();
        let shared = linear(shared, self.columns(some..self.inputs()), self.bias.val());
        let [_, outputs] = shared.dims();
        // The gradient of this layout (frames, then channels) is summed faster.
        let shared = shared.unsqueeze_dim::<3>(1).expand([batch, time, outputs]);
        self.forward_own(own, shared)
    }

    /// [`forward_frames_sharing`](Self::forward_frames_sharing) with one row of `cond` per frame;
    /// `rows` are the indices.
    ///
    /// # Shapes
    /// - own: `[batch, some, time]`
    /// - cond: `[conditions, in - some]`, rows: `[batch * time]`
    /// - output: `[batch, out, time]`
    pub fn forward_frames_cond(
        &self,
        own: Tensor<3>,
        cond: Tensor<2>,
        rows: Tensor<1, Int>,
    ) -> Tensor<3> {
        let [batch, some, time] = own.dims();
        let cond = linear(cond, self.columns(some..self.inputs()), self.bias.val());
        let [_, outputs] = cond.dims();
        let cond = cond.select(0, rows).reshape([batch, time, outputs]);
        self.forward_own(own, cond)
    }

    /// `others`, `[batch, time, out]`, plus the output of the first inputs, `own`.
    fn forward_own(&self, own: Tensor<3>, others: Tensor<3>) -> Tensor<3> {
        let [_, some, _] = own.dims();
        Convolution::new(self.columns(0..some).unsqueeze_dim(2), 1)
            .residual(others.swap_dims(1, 2))
            .forward(own)
    }

    /// The columns of the weight for `inputs`: `[out, inputs]`.
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

    /// The map with zeros as initial weight.
    #[must_use]
    pub fn zeroed(self, init: &Initializer) -> Self {
        Self {
            weight: init.constant(self.weight.lazy_shape().dims::<2>(), 0.0),
        }
    }

    /// The map of every frame as an operation that can be fused with others.
    pub fn operation(&self) -> Convolution {
        Convolution::new(self.weight.val().unsqueeze_dim(2), 1)
    }

    /// The map of every frame.
    ///
    /// # Shapes
    /// - x: `[batch, in, time]`
    /// - output: `[batch, out, time]`
    pub fn forward_frames(&self, x: Tensor<3>) -> Tensor<3> {
        self.operation().forward(x)
    }

    /// [`forward_frames`](Self::forward_frames), added to `residual`, `[batch, out, time]`.
    pub fn forward_frames_onto(&self, residual: Tensor<3>, x: Tensor<3>) -> Tensor<3> {
        self.operation().residual(residual).forward(x)
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

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;

    #[test]
    fn shared_inputs_give_the_same_result() {
        let device = Device::flex().autodiff();
        let values = |shape: &[usize]| {
            let count: usize = shape.iter().product();
            let values = (0..count).map(|i| (i as f32 * 0.7).sin()).collect();
            TensorData::new(values, shape.to_vec())
        };
        let layer = Linear::new(3 + 5, 4, &Initializer::new(1, &device));
        let shared = Tensor::<2>::from_data(values(&[2, 5]), &device).require_grad();
        let own = Tensor::<3>::from_data(values(&[2, 3, 7]), &device);
        let factors = Tensor::<3>::from_data(values(&[2, 4, 7]), &device);
        let of = |y: Tensor<3>| {
            let gradients = (y.clone() * factors.clone()).sum().backward();
            let of_layer = layer.weight.val().grad(&gradients).expect("weight");
            let of_shared = shared.grad(&gradients).expect("shared");
            let of_bias = layer.bias.val().grad(&gradients).expect("bias");
            let found = [
                y.inner().reshape([-1]),
                of_layer.reshape([-1]),
                of_shared.reshape([-1]),
                of_bias,
            ];
            Tensor::<1>::cat(found.to_vec(), 0)
        };
        let everywhere = shared.clone().unsqueeze_dim::<3>(2).expand([2, 5, 7]);
        let plain = of(layer.forward_frames(Tensor::cat(vec![own.clone(), everywhere], 1)));
        let sharing = of(layer.forward_frames_sharing(own, shared.clone()));
        assert_eq!(plain.dims(), [2 * 4 * 7 + 4 * 8 + 2 * 5 + 4]);
        let apart = (plain - sharing).abs().max().into_scalar::<f32>();
        assert!(apart < 1e-5, "{apart}");
    }
}
