//! Self-attention over time and cross-attention to the conditioning.

use burn::module::Module;
use burn::tensor::Tensor;
use kinegrad_kernels::{Lengths, concat_channels, cross_attention, self_attention};
use kinegrad_models::Initializer;
use kinegrad_models::layers::{Conv1d, GROUPS, GroupNorm};
use kinegrad_models::lora::{Adapting, LoraTarget};
use kinegrad_models::rotary::rotate;

/// Self-attention with a residual, then cross-attention to the context with a residual
/// (CC-MotionGen, section 3.1.4; docs/sources.md, section 1.5).
///
/// Attention is over all frames of the context, for any length of the level. The order of frames
/// matters only [`with_positions`](Self::with_positions).
#[derive(Module, Debug)]
pub struct AttentionBlock {
    norm: GroupNorm,
    qkv: Conv1d,
    proj: Conv1d,
    cross_norm: Option<GroupNorm>,
    q_cross: Option<Conv1d>,
    kv_cross: Option<Conv1d>,
    proj_cross: Option<Conv1d>,
    num_heads: usize,
    positions: bool,
}

impl AttentionBlock {
    /// A block of `channels` with `num_heads` heads of `channels / num_heads` channels. Without
    /// `context_dim`, the block has no cross-attention.
    pub fn new(
        channels: usize,
        num_heads: usize,
        context_dim: Option<usize>,
        init: &Initializer,
    ) -> Self {
        let norm = |name| GroupNorm::new(channels, GROUPS, &init.at(name));
        let pointwise =
            |name: &str, inputs, outputs| Conv1d::new(inputs, outputs, 1, &init.at(name));
        Self {
            norm: norm("norm"),
            qkv: pointwise("qkv", channels, 3 * channels),
            proj: pointwise("proj", channels, channels),
            cross_norm: context_dim.map(|_| norm("cross_norm")),
            q_cross: context_dim.map(|_| pointwise("q_cross", channels, channels)),
            kv_cross: context_dim.map(|dim| pointwise("kv_cross", dim, 2 * channels)),
            proj_cross: context_dim.map(|_| pointwise("proj_cross", channels, channels)),
            num_heads,
            positions: false,
        }
    }

    /// Enables or disables [rotary positions](rotate) for queries and keys of the cross-attention.
    /// With positions, the context must have the level's frames, and heads an even number of
    /// channels.
    #[must_use]
    pub fn with_positions(self, positions: bool) -> Self {
        Self { positions, ..self }
    }

    /// # Shapes
    /// - x, output: `[batch, channels, time]`
    /// - context: `[batch, context_dim, context_time]`; `None` skips the cross-attention
    /// - lengths: real frames of each sample, for motion and context; attention ignores padding
    pub fn forward(
        &self,
        x: Tensor<3>,
        context: Option<Tensor<3>>,
        lengths: Option<&Lengths>,
    ) -> Tensor<3> {
        let norm = self.norm.operation().lengths(lengths.cloned());
        let qkv = self
            .qkv
            .operation()
            .norm(norm)
            .recomputed()
            .forward(x.clone());
        let h = self_attention(qkv, self.num_heads, lengths);
        let x = self.proj.operation().residual(x).forward(h);

        let (Some(context), Some(norm), Some(q), Some(kv), Some(proj)) = (
            context,
            &self.cross_norm,
            &self.q_cross,
            &self.kv_cross,
            &self.proj_cross,
        ) else {
            return x;
        };
        let norm = norm.operation().lengths(lengths.cloned());
        let mut q = q.operation().norm(norm).recomputed().forward(x.clone());
        let mut kv = kv.operation().recomputed().forward(context);
        if self.positions {
            let channels = q.dims()[1];
            q = rotate(q, self.num_heads);
            let keys = rotate(kv.clone().narrow(1, 0, channels), self.num_heads);
            kv = concat_channels(keys, kv.narrow(1, channels, channels));
        }
        let h = cross_attention(q, kv, self.num_heads, lengths);
        proj.operation().residual(x).forward(h)
    }

    pub(crate) fn adapting(self, adapting: &Adapting<'_>) -> Self {
        let layer = |name, layer| adapting.layer(LoraTarget::Attention, name, layer);
        let optional = |name, conv: Option<Conv1d>| conv.map(|conv| layer(name, conv));
        Self {
            qkv: layer("qkv", self.qkv),
            proj: layer("proj", self.proj),
            q_cross: optional("q_cross", self.q_cross),
            kv_cross: optional("kv_cross", self.kv_cross),
            proj_cross: optional("proj_cross", self.proj_cross),
            ..self
        }
    }
}
