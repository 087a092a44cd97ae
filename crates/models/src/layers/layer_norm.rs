use burn::module::{Module, Param};
use burn::tensor::Tensor;
use kinegrad_kernels::layer_norm;

use crate::Initializer;

/// Added to the variance.
pub const LAYER_NORM_EPS: f64 = 1e-5;

/// Normalizes each row over its features (biased variance), then scales and shifts each feature:
/// weight and bias `[features]`.
#[derive(Module, Debug)]
pub struct LayerNorm {
    weight: Param<Tensor<1>>,
    bias: Param<Tensor<1>>,
}

impl LayerNorm {
    /// A normalization of rows of `features`.
    pub fn new(features: usize, init: &Initializer) -> Self {
        Self {
            weight: init.constant([features], 1.0),
            bias: init.constant([features], 0.0),
        }
    }

    /// # Shapes
    /// - x, output: `[rows, features]`
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        layer_norm(x, self.weight.val(), self.bias.val(), LAYER_NORM_EPS)
    }

    /// Normalizes each token over its channels.
    ///
    /// # Shapes
    /// - x, output: `[batch, features, tokens]`
    pub fn forward_tokens(&self, x: Tensor<3>) -> Tensor<3> {
        let [batch, features, tokens] = x.dims();
        let rows = x.swap_dims(1, 2).reshape([batch * tokens, features]);
        self.forward(rows)
            .reshape([batch, tokens, features])
            .swap_dims(1, 2)
    }
}
