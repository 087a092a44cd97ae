//! The sub-layers of the transformer: pose-centric attention and feed-forward.
use burn::module::Module;
use burn::tensor::{Int, Tensor};
use kinegrad_kernels::{KeyRanges, concat_channels, gelu, ranged_attention};
use kinegrad_models::Initializer;
use kinegrad_models::layers::{LayerNorm, Linear, Unbiased};
use kinegrad_models::rotary::Rotation;

use super::config::{BlendedConfig, HEAD_CHANNELS, ROTATED_CHANNELS};
use super::path_rows::PathRows;

/// The inputs that all sub-layers of a forward pass share.
#[derive(Clone, Debug)]
pub struct Shared {
    cond: Tensor<2>,
    rows: Tensor<1, Int>,
    ranges: KeyRanges,
    /// Rotation of queries and keys; `None` if no motion is in relative mode.
    rotation: Option<Rotation>,
    path: SharedPath,
}

/// The path of a forward pass.
#[derive(Clone, Debug, Default)]
pub(super) enum SharedPath {
    /// None, or in the frames' tokens.
    #[default]
    None,
    /// The channels that are concatenated to the conditions, `[batch, width, time]`.
    Concatenated(Tensor<3>),
    /// Rows behind the frames.
    Rows(PathRows),
}

impl Shared {
    /// `ranges` are the frames that each frame attends to; `is_relative` is true for motions in
    /// relative mode.
    ///
    /// # Shapes
    /// - cond: `[conditions, width]`
    /// - rows: `[batch * time]`, the row of `cond` of each frame
    pub fn new(
        cond: Tensor<2>,
        rows: Tensor<1, Int>,
        ranges: KeyRanges,
        is_relative: &[bool],
    ) -> Self {
        let (time, device) = (rows.dims()[0] / is_relative.len(), cond.device());
        let turns = is_relative.contains(&true);
        let rotation = turns.then(|| Rotation::new(ROTATED_CHANNELS, time, is_relative, &device));
        Self {
            cond,
            rows,
            ranges,
            rotation,
            path: SharedPath::None,
        }
    }

    /// The inputs with the channels of a path beside the conditions.
    pub(super) fn with_concatenated(self, path: Tensor<3>) -> Self {
        Self {
            path: SharedPath::Concatenated(path),
            ..self
        }
    }

    /// The inputs for tokens with path rows behind the frames; `has_path` is true for motions with
    /// a path.
    pub(super) fn with_rows(self, has_path: &[bool], is_relative: &[bool]) -> Self {
        let (batch, device) = (has_path.len(), self.cond.device());
        let time = self.rows.dims()[0] / batch;
        let rows = self.rows.clone().reshape([batch, time]);
        let positions: Vec<usize> = (0..time).chain(0..time).collect();
        let rotation = |_| Rotation::at(ROTATED_CHANNELS, &positions, is_relative, &device);
        let path = PathRows::new(&self.ranges, has_path, time, &device);
        Self {
            rows: Tensor::cat(vec![rows.clone(), rows], 1).reshape([2 * batch * time]),
            rotation: self.rotation.as_ref().map(rotation),
            path: SharedPath::Rows(path),
            ..self
        }
    }

    /// The condition of each frame, `[batch, width, time]`.
    pub(super) fn cond(&self, batch: usize) -> Tensor<3> {
        let (time, [_, width]) = (self.rows.dims()[0] / batch, self.cond.dims());
        let cond = self.cond.clone().select(0, self.rows.clone());
        cond.reshape([batch, time, width]).swap_dims(1, 2)
    }
}

/// Attention in which only queries depend on text and time (docs/sources.md, section 6.4):
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
    /// The columns of `custom_query_fn` for a path that is concatenated to the condition.
    path_query: Option<Unbiased>,
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
            path_query: config.concatenates_path().then(|| {
                let init = init.at("path_query");
                Unbiased::new(width, width, &init).zeroed(&init)
            }),
            heads: config.num_heads,
        }
    }

    /// # Shapes
    /// - u, output: `[batch, width, time]`
    pub fn forward(&self, u: Tensor<3>, shared: &Shared) -> Tensor<3> {
        self.to_out.forward_frames(self.attended(u, shared))
    }

    /// All heads: `[batch, heads * HEAD_CHANNELS, time]`.
    fn attended(&self, u: Tensor<3>, shared: &Shared) -> Tensor<3> {
        let (cond, rows) = (shared.cond.clone(), shared.rows.clone());
        let merge = &self.custom_query_fn;
        let merged = merge.forward_frames_cond(u.clone(), cond, rows);
        let merged = match (&shared.path, &self.path_query) {
            (SharedPath::Concatenated(path), Some(query)) => {
                merged + query.forward_frames(path.clone())
            }
            _ => merged,
        };
        let recomputed = |map: &Unbiased, x| map.operation().recomputed().forward(x);
        let mut queries = recomputed(&self.to_q, merged);
        let mut keys = recomputed(&self.to_k, u.clone());
        if let Some(rotation) = &shared.rotation {
            queries = rotation.turn(queries, self.heads);
            keys = rotation.turn(keys, self.heads);
        }
        let keys_values = concat_channels(keys, recomputed(&self.to_v, u));
        match &shared.path {
            SharedPath::Rows(rows) => {
                let keys_values = rows.ordered(keys_values);
                ranged_attention(queries, keys_values, self.heads, &rows.ranges)
            }
            _ => ranged_attention(queries, keys_values, self.heads, &shared.ranges),
        }
    }
}

#[derive(Module, Debug)]
pub(super) struct FeedForward {
    ff_at_0_at_0: Linear,
    ff_at_3: Linear,
}

/// Attention or feed-forward, after a normalization.
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
    /// Sub-layer `index`; even sub-layers are attention.
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

    /// This sub-layer with the map of a concatenated path of `other`.
    pub fn with_path_query_of(self, other: &Self) -> Self {
        match (self, other) {
            (Self::Attention(mut layer), Self::Attention(other)) => {
                layer.at_1.path_query = other.at_1.path_query.clone();
                Self::Attention(layer)
            }
            (layer, _) => layer,
        }
    }

    /// The sum of `x` and its [`branch`](Self::branch).
    ///
    /// # Shapes
    /// - x, output: `[batch, width, time]`
    pub fn forward(&self, x: Tensor<3>, shared: &Shared) -> Tensor<3> {
        let inner = self.inner(x.clone(), shared);
        match self {
            Self::Attention(layer) => layer.at_1.to_out.forward_frames_onto(x, inner),
            Self::FeedForward(layer) => layer.at_1.ff_at_3.forward_frames_onto(x, inner),
        }
    }

    /// The residual that is added to `x`.
    pub fn branch(&self, x: Tensor<3>, shared: &Shared) -> Tensor<3> {
        let inner = self.inner(x, shared);
        match self {
            Self::Attention(layer) => layer.at_1.to_out.forward_frames(inner),
            Self::FeedForward(layer) => layer.at_1.ff_at_3.forward_frames(inner),
        }
    }

    /// All but the last map of the branch.
    fn inner(&self, x: Tensor<3>, shared: &Shared) -> Tensor<3> {
        match self {
            Self::Attention(layer) => {
                let u = layer.at_0_at_0.forward_tokens(x);
                layer.at_1.attended(u, shared)
            }
            Self::FeedForward(layer) => {
                let u = layer.at_0_at_0.forward_tokens(x);
                gelu(layer.at_1.ff_at_0_at_0.operation().recomputed().forward(u))
            }
        }
    }
}
