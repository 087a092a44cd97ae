//! What a transformer with blended positions is made of: pose-centric attention and feed-forward.
use burn::module::Module;
use burn::tensor::Tensor;
use kinegrad_kernels::{KeyRanges, concat_channels, gelu, ranged_attention};

use super::{BlendedConfig, HEAD_CHANNELS, ROTATED_CHANNELS};
use crate::Initializer;
use crate::layers::{LayerNorm, Linear, Unbiased};
use crate::rotary::Rotation;

/// What all sub-layers of a forward pass share.
#[derive(Clone, Debug)]
pub struct Shared {
    /// What each frame is told, `[batch, width, time]`.
    pub cond: Tensor<3>,
    /// Frames that each attends to.
    pub ranges: KeyRanges,
    /// How queries and keys turn; none where no motion is in relative mode.
    pub rotation: Option<Rotation>,
}

impl Shared {
    /// Of motions that are told `cond`, attend by `ranges` and are in relative mode or not.
    pub fn new(cond: Tensor<3>, ranges: KeyRanges, is_relative: &[bool]) -> Self {
        let ([_, _, time], device) = (cond.dims(), cond.device());
        let turns = is_relative.contains(&true);
        let rotation = turns.then(|| Rotation::new(ROTATED_CHANNELS, time, is_relative, &device));
        Self {
            cond,
            ranges,
            rotation,
        }
    }
}

/// Attention whose queries alone know text and time (docs/sources.md, section 6.4):
///
/// ```text
/// a = merge([u, c])    q = W_q a    k = W_k u    v = W_v u
/// ```
#[derive(Module, Debug)]
pub struct PoseCentricAttention {
    custom_query_fn: Linear,
    to_q: Unbiased,
    to_k: Unbiased,
    to_v: Unbiased,
    to_out: Unbiased,
    heads: usize,
}

impl PoseCentricAttention {
    /// An attention of a network's sizes.
    pub fn new(config: &BlendedConfig, init: &Initializer) -> Self {
        let (width, inner) = (config.latent_dim, config.num_heads * HEAD_CHANNELS);
        let into_heads = |name| Unbiased::new(width, inner, &init.at(name));
        Self {
            custom_query_fn: Linear::new(2 * width, width, &init.at("custom_query_fn")),
            to_q: into_heads("to_q"),
            to_k: into_heads("to_k"),
            to_v: into_heads("to_v"),
            to_out: Unbiased::new(inner, width, &init.at("to_out")),
            heads: config.num_heads,
        }
    }

    /// # Shapes
    /// - u, output: `[batch, width, time]`
    pub fn forward(&self, u: Tensor<3>, shared: &Shared) -> Tensor<3> {
        let merged = concat_channels(u.clone(), shared.cond.clone());
        let merged = self.custom_query_fn.forward_frames(merged);
        let mut queries = self.to_q.forward_frames(merged);
        let mut keys = self.to_k.forward_frames(u.clone());
        if let Some(rotation) = &shared.rotation {
            queries = rotation.turn(queries, self.heads);
            keys = rotation.turn(keys, self.heads);
        }
        let keys_values = concat_channels(keys, self.to_v.forward_frames(u));
        let attended = ranged_attention(queries, keys_values, self.heads, &shared.ranges);
        self.to_out.forward_frames(attended)
    }
}

/// Linear, GELU, linear.
#[derive(Module, Debug)]
pub(super) struct FeedForward {
    ff_at_0_at_0: Linear,
    ff_at_3: Linear,
}

/// Attention or feed-forward, with the normalisation before it.
#[derive(Module, Debug)]
pub(super) enum SubLayer {
    Attention(AttentionLayer),
    FeedForward(FeedForwardLayer),
}

#[derive(Module, Debug)]
pub(super) struct AttentionLayer {
    at_0_at_0: LayerNorm,
    at_1: PoseCentricAttention,
}

#[derive(Module, Debug)]
pub(super) struct FeedForwardLayer {
    at_0_at_0: LayerNorm,
    at_1: FeedForward,
}

impl SubLayer {
    /// Sub-layer `index`: attention if it is even.
    pub fn new(index: usize, config: &BlendedConfig, init: &Initializer) -> Self {
        let norm = LayerNorm::new(config.latent_dim, &init.at("0").at("0"));
        let init = init.at("1");
        match index % 2 {
            0 => Self::Attention(AttentionLayer {
                at_0_at_0: norm,
                at_1: PoseCentricAttention::new(config, &init),
            }),
            _ => {
                let (width, inner) = (config.latent_dim, config.inner_width());
                let (first, last) = (init.at("ff").at("0").at("0"), init.at("ff").at("3"));
                Self::FeedForward(FeedForwardLayer {
                    at_0_at_0: norm,
                    at_1: FeedForward {
                        ff_at_0_at_0: Linear::new(width, inner, &first),
                        ff_at_3: Linear::new(inner, width, &last),
                    },
                })
            }
        }
    }

    /// What is added to `x`.
    ///
    /// # Shapes
    /// - x, output: `[batch, width, time]`
    pub fn forward(&self, x: Tensor<3>, shared: &Shared) -> Tensor<3> {
        match self {
            Self::Attention(layer) => {
                let u = layer.at_0_at_0.forward_tokens(x);
                layer.at_1.forward(u, shared)
            }
            Self::FeedForward(layer) => {
                let u = layer.at_0_at_0.forward_tokens(x);
                let inner = gelu(layer.at_1.ff_at_0_at_0.forward_frames(u));
                layer.at_1.ff_at_3.forward_frames(inner)
            }
        }
    }
}
