//! The residual block with adaptive group normalization.

use burn::module::Module;
use burn::tensor::Tensor;
use kinegrad_kernels::{Activation, Convolution, GroupNorm as NormOperation, stored};
use kinegrad_models::Initializer;
use kinegrad_models::layers::{Conv1d, GroupNorm, Linear};

pub(super) const GROUPS: usize = 8;

/// Kernel size of convolutions that keep the length, except shortcuts.
const KERNEL: usize = 5;

/// A convolution (child 0) and its normalization (child 2).
#[derive(Module, Debug)]
pub(super) struct ConvNorm {
    at_0: Conv1d,
    at_2: GroupNorm,
}

impl ConvNorm {
    pub fn new(inputs: usize, outputs: usize, init: &Initializer) -> Self {
        Self {
            at_0: Conv1d::new(inputs, outputs, KERNEL, &init.at("0")),
            at_2: GroupNorm::new(outputs, GROUPS, &init.at("2")),
        }
    }

    fn zeroed(self, init: &Initializer) -> Self {
        Self {
            at_0: self.at_0.zeroed(&init.at("0")),
            ..self
        }
    }

    pub fn convolution(&self) -> Convolution {
        self.at_0.operation()
    }

    /// Normalization and Mish.
    pub fn norm(&self) -> NormOperation {
        self.at_2.operation().activation(Activation::Mish)
    }
}

/// Two convolutions of kernel size 5 with a shortcut (Guided Motion Diffusion, figure D.2):
///
/// ```text
/// (s, b) = Linear(mish(c))
/// h   = mish(norm(conv(x)) (1 + s) + b)          with AdaGN
/// h   = mish(norm(conv(x))) + Linear(mish(c))    without
/// out = mish(norm(conv(h))) + shortcut(x)
/// ```
///
/// AdaGN initializes the linear layer to zero; `zero_init` initializes the second convolution to
/// zero. The published models name the first half `block1` with AdaGN and `block` without.
#[derive(Module, Debug)]
pub(super) struct GmdResBlock {
    blocks_at_0_at_block1: Option<ConvNorm>,
    blocks_at_0_at_block: Option<ConvNorm>,
    blocks_at_1_at_block: ConvNorm,
    time_mlp_at_1: Linear,
    residual_conv: Option<Conv1d>,
}

impl GmdResBlock {
    /// A block from `inputs` to `outputs` channels (a multiple of [`GROUPS`]) with a condition of
    /// `width` numbers.
    pub fn new(
        inputs: usize,
        outputs: usize,
        width: usize,
        adagn: bool,
        zero_init: bool,
        init: &Initializer,
    ) -> Self {
        let blocks = init.at("blocks");
        let first = |name: &str| ConvNorm::new(inputs, outputs, &blocks.at("0").at(name));
        let place = blocks.at("1").at("block");
        let second = ConvNorm::new(outputs, outputs, &place);
        let time = init.at("time_mlp").at("1");
        let shortcut = || Conv1d::new(inputs, outputs, 1, &init.at("residual_conv"));
        Self {
            blocks_at_0_at_block1: adagn.then(|| first("block1")),
            blocks_at_0_at_block: (!adagn).then(|| first("block")),
            blocks_at_1_at_block: match zero_init {
                true => second.zeroed(&place),
                false => second,
            },
            time_mlp_at_1: match adagn {
                true => Linear::new(width, 2 * outputs, &time).zeroed(&time),
                false => Linear::new(width, outputs, &time),
            },
            residual_conv: (inputs != outputs).then(shortcut),
        }
    }

    /// # Shapes
    /// - x: `[batch, in, time]`
    /// - activated: `mish(c)`, `[batch, width]`
    /// - output: `[batch, out, time]`
    pub fn forward(&self, x: Tensor<3>, activated: Tensor<2>) -> Tensor<3> {
        let e = self.time_mlp_at_1.forward(activated);
        let second = self.blocks_at_1_at_block.convolution();
        let h = match (&self.blocks_at_0_at_block1, &self.blocks_at_0_at_block) {
            (Some(first), _) => {
                let h = first.convolution().recomputed().forward(x.clone());
                second.norm(first.norm().film(e)).recomputed().forward(h)
            }
            (None, Some(first)) => {
                let h = first.convolution().recomputed().forward(x.clone());
                let h = first.norm().forward(h) + e.unsqueeze_dim::<3>(2);
                second.recomputed().forward(h)
            }
            (None, None) => unreachable!("a block has a first half"),
        };
        let h = self.blocks_at_1_at_block.norm().forward(h);
        match &self.residual_conv {
            Some(shortcut) => shortcut.operation().residual(h).forward(x),
            None => stored(h + x),
        }
    }
}
