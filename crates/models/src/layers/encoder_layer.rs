use burn::module::{Module, Param};
use burn::tensor::Tensor;
use kinegrad_kernels::{Convolution, gelu, self_attention};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{LayerNorm, Linear};
use crate::Initializer;

/// Where a layer of a transformer normalises.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NormOrder {
    /// Each sum: `norm(x + f(x))` (Vaswani et al. 2017, <https://arxiv.org/abs/1706.03762>).
    #[default]
    Post,
    /// What each part takes: `x + f(norm(x))` (Xiong et al. 2020,
    /// <https://arxiv.org/abs/2002.04745>).
    Pre,
}

/// The sizes of an [`EncoderLayer`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderLayerConfig {
    /// Width of a token.
    pub width: usize,
    /// Attention heads, a divisor of the width.
    pub num_heads: usize,
    /// Width between the two linear maps.
    pub ff_size: usize,
    /// Where it normalises.
    pub norm: NormOrder,
}

impl EncoderLayerConfig {
    /// A layer whose parameters are drawn when they are first used.
    pub fn init(&self, init: &Initializer) -> EncoderLayer {
        let width = self.width;
        let attention = init.at("self_attn");
        EncoderLayer {
            self_attn: SelfAttention {
                // Xavier's bound for a weight of `width` inputs and `3 width` outputs, as
                // `nn.MultiheadAttention` has it; its biases begin at zero.
                in_proj_weight: attention.bounded(
                    "in_proj_weight",
                    [3 * width, width],
                    (6.0 / (4 * width) as f64).sqrt(),
                ),
                in_proj_bias: attention.constant([3 * width], 0.0),
                out_proj: Linear::new(width, width, &attention.at("out_proj")),
                num_heads: self.num_heads,
            },
            linear1: Linear::new(width, self.ff_size, &init.at("linear1")),
            linear2: Linear::new(self.ff_size, width, &init.at("linear2")),
            norm1: LayerNorm::new(width, &init.at("norm1")),
            norm2: LayerNorm::new(width, &init.at("norm2")),
            norm: self.norm,
        }
    }
}

/// Queries, keys and values of `nn.MultiheadAttention` in one weight.
#[derive(Module, Debug)]
struct SelfAttention {
    in_proj_weight: Param<Tensor<2>>,
    in_proj_bias: Param<Tensor<1>>,
    out_proj: Linear,
    num_heads: usize,
}

impl SelfAttention {
    /// # Shapes
    /// - x, output: `[batch, width, tokens]`
    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let projected = Convolution::new(self.in_proj_weight.val().unsqueeze_dim(2), 1)
            .bias(self.in_proj_bias.val())
            .forward(x);
        let attended = self_attention(projected, self.num_heads, None);
        self.out_proj.forward_frames(attended)
    }
}

/// A layer of PyTorch's `nn.TransformerEncoder` with its names: attention, then two linear maps
/// with GELU between them, each added to what goes in. Should be created with
/// [`EncoderLayerConfig::init`].
///
/// ```text
/// post   h = norm1(x + attention(x))    y = norm2(h + linear2(gelu(linear1(h))))
/// pre    h = x + attention(norm1(x))    y = h + linear2(gelu(linear1(norm2(h))))
/// ```
#[derive(Module, Debug)]
pub struct EncoderLayer {
    self_attn: SelfAttention,
    linear1: Linear,
    linear2: Linear,
    norm1: LayerNorm,
    norm2: LayerNorm,
    #[module(skip)]
    norm: NormOrder,
}

impl EncoderLayer {
    /// # Shapes
    /// - x, output: `[batch, width, tokens]`
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        match self.norm {
            NormOrder::Post => {
                let h = self.self_attn.forward(x.clone()) + x;
                let h = self.norm1.forward_tokens(h);
                self.norm2.forward_tokens(self.inner(h.clone()) + h)
            }
            NormOrder::Pre => {
                let h = self.self_attn.forward(self.norm1.forward_tokens(x.clone())) + x;
                self.inner(self.norm2.forward_tokens(h.clone())) + h
            }
        }
    }

    fn inner(&self, x: Tensor<3>) -> Tensor<3> {
        self.linear2
            .forward_frames(gelu(self.linear1.forward_frames(x)))
    }
}
