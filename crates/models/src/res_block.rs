//! The residual block, conditioned on the timestep.

use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::activation::silu;
use kinegrad_kernels::{Activation, Lengths};

use crate::layers::{Conv1d, GROUPS, GroupNorm, Linear};
use crate::lora::{Adapting, LoraTarget};
use crate::{Dropout, DropoutKey, Initializer};

/// The settings that all [`ResBlock`]s of one network share.
#[derive(Clone, Debug)]
pub struct ResBlockConfig {
    /// Width of the time embedding.
    pub time_embed_dim: usize,
    /// Apply the time embedding as scale and shift after the second normalization (FiLM) instead of
    /// adding the embedding before.
    pub use_scale_shift_norm: bool,
    /// Dropout before the second convolution.
    pub dropout: f64,
}

/// Two convolutions with a shortcut (CC-MotionGen, section 3.1.3; docs/sources.md, section 1.5):
///
/// ```text
/// h   = conv1(silu(norm1(x)))
/// e   = Linear(silu(time_emb))
/// h   = norm2(h) (1 + scale) + shift    where (scale, shift) = e     (FiLM)
/// h   = norm2(h + e)                                                 (additive)
/// out = conv2(dropout(silu(h))) + skip(x)
/// ```
#[derive(Module, Debug)]
pub struct ResBlock {
    norm1: GroupNorm,
    conv1: Conv1d,
    time_mlp_at_1: Linear,
    norm2: GroupNorm,
    dropout: Dropout,
    conv2: Conv1d,
    skip_conv: Option<Conv1d>,
    use_scale_shift_norm: bool,
}

impl ResBlock {
    /// A block from `inputs` to `outputs` channels; `layer` is the index of the dropout layer.
    pub fn new(
        inputs: usize,
        outputs: usize,
        config: &ResBlockConfig,
        layer: usize,
        init: &Initializer,
    ) -> Self {
        let time_outputs = if config.use_scale_shift_norm {
            2 * outputs
        } else {
            outputs
        };
        let time_init = init.at("time_mlp").at("1");
        Self {
            norm1: GroupNorm::new(inputs, GROUPS, &init.at("norm1")),
            conv1: Conv1d::new(inputs, outputs, 3, &init.at("conv1")),
            time_mlp_at_1: Linear::new(config.time_embed_dim, time_outputs, &time_init),
            norm2: GroupNorm::new(outputs, GROUPS, &init.at("norm2")),
            dropout: Dropout::new(config.dropout, layer),
            conv2: Conv1d::new(outputs, outputs, 3, &init.at("conv2")),
            skip_conv: (inputs != outputs)
                .then(|| Conv1d::new(inputs, outputs, 1, &init.at("skip_conv"))),
            use_scale_shift_norm: config.use_scale_shift_norm,
        }
    }

    /// # Shapes
    /// - x: `[batch, in, time]`
    /// - time_emb: `[batch, time_embed_dim]`
    /// - lengths: valid frames of each sample
    /// - output: `[batch, out, time]`
    pub fn forward(
        &self,
        x: Tensor<3>,
        time_emb: Tensor<2>,
        lengths: Option<&Lengths>,
        dropout: DropoutKey,
    ) -> Tensor<3> {
        let activated = |norm: &GroupNorm| {
            let norm = norm.operation().activation(Activation::Silu);
            norm.lengths(lengths.cloned())
        };
        let norm1 = activated(&self.norm1);
        let h = self
            .conv1
            .operation()
            .norm(norm1)
            .recomputed()
            .forward(x.clone());
        let e = self.time_mlp_at_1.forward(silu(time_emb));
        let norm2 = activated(&self.norm2);
        let (h, norm2) = if self.use_scale_shift_norm {
            (h, norm2.film(e))
        } else {
            (h + e.unsqueeze_dim::<3>(2), norm2)
        };
        let mask = self.dropout.mask(h.dims(), &h.device(), dropout);
        let shortcut = match &self.skip_conv {
            Some(skip) => skip.forward(x),
            None => x,
        };
        self.conv2
            .operation()
            .norm(norm2.mask(mask))
            .residual(shortcut)
            .forward(h)
    }

    /// Applies `adapting` to the layers.
    pub fn adapting(self, adapting: &Adapting<'_>) -> Self {
        let conv = |name, layer| adapting.layer(LoraTarget::Convolution, name, layer);
        let time = adapting.at("time_mlp");
        Self {
            conv1: conv("conv1", self.conv1),
            time_mlp_at_1: time.layer(LoraTarget::Conditioning, "1", self.time_mlp_at_1),
            conv2: conv("conv2", self.conv2),
            skip_conv: self.skip_conv.map(|skip| conv("skip_conv", skip)),
            ..self
        }
    }
}
