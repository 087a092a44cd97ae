use burn::module::{Module, Param};
use burn::tensor::Tensor;
use burn::tensor::activation::softmax;
use kinegrad_kernels::{Convolution, Lengths, gelu, product, self_attention, stored};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{LayerNorm, Linear};
use crate::{Dropout, DropoutKey, Initializer};

/// Place of the normalizations in a transformer layer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NormOrder {
    /// Normalizes each residual sum: `norm(x + f(x))` (Vaswani et al. 2017,
    /// <https://arxiv.org/abs/1706.03762>).
    #[default]
    Post,
    /// Normalizes each sublayer's input: `x + f(norm(x))` (Xiong et al. 2020,
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
    /// Place of the normalizations.
    pub norm: NormOrder,
    /// Dropout in training, as in PyTorch. It acts on the attention weights, on the outputs of
    /// attention and linear maps, and between the linear maps.
    pub dropout: f64,
}

/// Amount by which the score of an unseen token is lower; its weight is 0 in single precision.
const UNSEEN: f64 = 1e9;

/// Number of dropouts in a layer.
const DROPOUTS: usize = 4;

impl EncoderLayerConfig {
    /// Builds layer `index` of a network; parameters are initialized at first use.
    pub fn init(&self, index: usize, init: &Initializer) -> EncoderLayer {
        let width = self.width;
        let dropout = |number| Dropout::new(self.dropout, index * DROPOUTS + number);
        let attention = init.at("self_attn");
        EncoderLayer {
            self_attn: SelfAttention {
                // As in `nn.MultiheadAttention`: Xavier's bound for `width` inputs and `3 width`
                // outputs, and zero biases.
                in_proj_weight: attention.bounded(
                    "in_proj_weight",
                    [3 * width, width],
                    (6.0 / (4 * width) as f64).sqrt(),
                ),
                in_proj_bias: attention.constant([3 * width], 0.0),
                out_proj: Linear::new(width, width, &attention.at("out_proj")),
                num_heads: self.num_heads,
                dropout: dropout(0),
            },
            linear1: Linear::new(width, self.ff_size, &init.at("linear1")),
            linear2: Linear::new(self.ff_size, width, &init.at("linear2")),
            norm1: LayerNorm::new(width, &init.at("norm1")),
            norm2: LayerNorm::new(width, &init.at("norm2")),
            norm: self.norm,
            attended: dropout(1),
            between: dropout(2),
            mapped: dropout(3),
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
    dropout: Dropout,
}

impl SelfAttention {
    /// The input of `out_proj`.
    ///
    /// # Shapes
    /// - x, output: `[batch, width, tokens]`
    fn heads(&self, x: Tensor<3>, seen: Option<&Lengths>, dropout: DropoutKey) -> Tensor<3> {
        let projected = Convolution::new(self.in_proj_weight.val().unsqueeze_dim(2), 1)
            .bias(self.in_proj_bias.val())
            .recomputed()
            .forward(x);
        let [batch, _, tokens] = projected.dims();
        let shape = [batch, self.num_heads, tokens, tokens];
        let mask = self.dropout.mask(shape, &projected.device(), dropout);
        match mask {
            Some(mask) => masked_attention(projected, self.num_heads, seen, mask),
            None => self_attention(projected, self.num_heads, seen),
        }
    }
}

/// [`self_attention`] to the tokens that are `seen`, with attention weights multiplied by a mask.
///
/// # Shapes
/// - queries_keys_values: `[batch, 3 width, tokens]`
/// - mask: `[batch, heads, tokens, tokens]`, queries by keys
/// - output: `[batch, width, tokens]`
fn masked_attention(
    queries_keys_values: Tensor<3>,
    num_heads: usize,
    seen: Option<&Lengths>,
    mask: Tensor<4>,
) -> Tensor<3> {
    let [batch, all, tokens] = queries_keys_values.dims();
    let head = all / 3 / num_heads;
    let heads = queries_keys_values.reshape([batch, 3 * num_heads, head, tokens]);
    let [queries, keys, values] =
        [0, 1, 2].map(|part| heads.clone().narrow(1, part * num_heads, num_heads));
    let scores = product(queries.swap_dims(2, 3), keys) / (head as f64).sqrt();
    let scores = match seen {
        Some(seen) => {
            let seen = seen.mask(tokens, &scores.device()).unsqueeze_dim::<4>(1);
            scores + (seen - 1.0) * UNSEEN
        }
        None => scores,
    };
    let weights = softmax(scores, 3) * mask;
    product(values, weights.swap_dims(2, 3)).reshape([batch, all / 3, tokens])
}

/// A layer of PyTorch's `nn.TransformerEncoder`, with its names: attention, then two linear maps
/// with a GELU, each with a residual connection.
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
    attended: Dropout,
    between: Dropout,
    mapped: Dropout,
}

impl EncoderLayer {
    /// # Shapes
    /// - x, output: `[batch, width, tokens]`
    pub fn forward(&self, x: Tensor<3>, dropout: DropoutKey) -> Tensor<3> {
        self.forward_seeing(x, None, dropout)
    }

    /// [`forward`](Self::forward) in which the tokens of each sample attend to its first tokens
    /// alone, as many as are `seen`.
    ///
    /// # Shapes
    /// As [`forward`](Self::forward).
    pub fn forward_seeing(
        &self,
        x: Tensor<3>,
        seen: Option<&Lengths>,
        dropout: DropoutKey,
    ) -> Tensor<3> {
        match self.norm {
            NormOrder::Post => {
                let h = self
                    .norm1
                    .forward_tokens(self.attended(x.clone(), x, seen, dropout));
                self.norm2
                    .forward_tokens(self.mapped(h.clone(), h, dropout))
            }
            NormOrder::Pre => {
                let h = self.attended(x.clone(), self.norm1.forward_tokens(x), seen, dropout);
                self.mapped(h.clone(), self.norm2.forward_tokens(h), dropout)
            }
        }
    }

    /// `residual + attention(x)`.
    fn attended(
        &self,
        residual: Tensor<3>,
        x: Tensor<3>,
        seen: Option<&Lengths>,
        dropout: DropoutKey,
    ) -> Tensor<3> {
        let heads = self.self_attn.heads(x, seen, dropout);
        let map = &self.self_attn.out_proj;
        added(residual, map, heads, &self.attended, dropout)
    }

    /// `residual + linear2(gelu(linear1(x)))`.
    fn mapped(&self, residual: Tensor<3>, x: Tensor<3>, dropout: DropoutKey) -> Tensor<3> {
        let h = gelu(self.linear1.operation().recomputed().forward(x));
        let h = self.between.forward(h, dropout);
        added(residual, &self.linear2, h, &self.mapped, dropout)
    }
}

/// `residual + dropout(map(x))`.
fn added(
    residual: Tensor<3>,
    map: &Linear,
    x: Tensor<3>,
    dropout: &Dropout,
    key: DropoutKey,
) -> Tensor<3> {
    match dropout.drops(key) {
        true => stored(dropout.forward(map.forward_frames(x), key) + residual),
        false => map.forward_frames_onto(residual, x),
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use kinegrad_random::{Key, Purpose};

    use super::*;

    fn answer(norm: NormOrder, dropout: f64, key: DropoutKey) -> Vec<f32> {
        let init = Initializer::new(5, &Device::flex());
        let sizes = EncoderLayerConfig {
            width: 12,
            num_heads: 3,
            ff_size: 20,
            norm,
            dropout,
        };
        let values: Vec<f32> = (0..2 * 12 * 5).map(|i| (i as f32 * 0.7).sin()).collect();
        let x = Tensor::from_data(TensorData::new(values, [2, 12, 5]), &Device::flex());
        let y = sizes.init(1, &init).forward(x, key);
        y.try_into_vec_as::<f32>().expect("float32")
    }

    #[test]
    fn tokens_attend_to_the_seen_ones_alone() {
        let init = Initializer::new(5, &Device::flex());
        let sizes = |dropout| EncoderLayerConfig {
            width: 12,
            num_heads: 3,
            ff_size: 20,
            norm: NormOrder::Post,
            dropout,
        };
        let values: Vec<f32> = (0..2 * 12 * 5).map(|i| (i as f32 * 0.7).sin()).collect();
        let x = Tensor::<3>::from_data(TensorData::new(values, [2, 12, 5]), &Device::flex());
        let other = x.clone().narrow(2, 0, 4);
        let other = Tensor::cat(vec![other, x.clone().narrow(2, 4, 1) + 1.0], 2);
        // The second path computes the attention with a mask of dropout, which drops nothing.
        for (dropout, key) in [(0.0, None), (1e-12, Some(Key::new(1, Purpose::Dropout)))] {
            let layer = sizes(dropout).init(1, &init);
            let seen = Lengths::new([5, 4]);
            let run = |x: Tensor<3>| layer.forward_seeing(x, Some(&seen), key);
            let change = (run(x.clone()) - run(other.clone())).abs().max_dim(1);
            let change = change.try_into_vec_as::<f32>().expect("float32");
            assert!(
                change[..5].iter().all(|change| *change > 1e-6),
                "{change:?}"
            );
            assert!(
                change[5..9].iter().all(|change| *change == 0.0),
                "{change:?}"
            );
            let all = Lengths::new([5, 5]);
            let whole = layer.forward_seeing(x.clone(), Some(&all), key);
            let apart = (whole - layer.forward(x.clone(), key)).abs().max();
            assert!(apart.into_scalar::<f32>() < 1e-5);
        }
    }

    #[test]
    fn dropout_depends_on_the_key_alone() {
        let key = |seed| Some(Key::new(seed, Purpose::Dropout));
        for norm in [NormOrder::Post, NormOrder::Pre] {
            let whole = answer(norm, 0.3, None);
            assert_eq!(answer(norm, 0.0, key(1)), whole);
            // At this probability no element is dropped: masked attention gives the same result.
            let rare = answer(norm, 1e-12, key(1));
            let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
            assert!(near(&rare, &whole));
            let dropped = answer(norm, 0.3, key(1));
            assert!(!near(&dropped, &whole));
            assert_eq!(answer(norm, 0.3, key(1)), dropped);
            assert!(!near(&answer(norm, 0.3, key(2)), &dropped));
        }
    }
}
