//! The UNet over time with adaptive group normalisation.

use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::activation::mish;
use kinegrad_kernels::concat_channels;

use super::res_block::{ConvNorm, GROUPS, GmdResBlock};
use crate::layers::{Conv1d, ConvTranspose1d, Linear};
use crate::{Error, Initializer, Stages};

/// Every size of a [`GmdUnet`].
#[derive(Clone, Debug, PartialEq)]
pub struct GmdUnetConfig {
    /// Channels of the motion, in and out.
    pub in_channels: usize,
    /// Width of the vector that the network is told things by.
    pub cond_dim: usize,
    /// Width of the condition inside the network, and what the multipliers are of.
    pub latent_dim: usize,
    /// Channels of each level over `latent_dim`.
    pub dim_mults: Vec<f64>,
    /// The condition scales and shifts (AdaGN) instead of being added.
    pub adagn: bool,
    /// Second convolutions and the last one begin at zero: a fresh network answers 0.
    pub zero_init: bool,
}

impl GmdUnetConfig {
    /// Channels of each level.
    pub fn channels(&self) -> Vec<usize> {
        self.dim_mults
            .iter()
            .map(|mult| (self.latent_dim as f64 * mult).round() as usize)
            .collect()
    }

    /// Lengths must be a multiple of this.
    pub fn length_multiple(&self) -> usize {
        1 << self.dim_mults.len().saturating_sub(1)
    }

    /// # Errors
    /// Names the key that no network can be built from.
    pub fn validate(&self) -> Result<(), Error> {
        let refuse = |key: &str, found: String, allowed: &str, hint: &str| {
            Err(Error::Config {
                key: format!("model.{key}"),
                found,
                allowed: allowed.into(),
                hint: hint.into(),
            })
        };
        if self.dim_mults.is_empty() || self.dim_mults.len() > 16 {
            let found = format!("{:?}", self.dim_mults);
            let hint = "the motion model has [2.0, 2.0, 2.0, 2.0]";
            return refuse("dim_mults", found, "1 to 16 numbers, one a level", hint);
        }
        if self.latent_dim == 0 || !self.latent_dim.is_multiple_of(2) {
            let hint = "the published models have 512";
            return refuse(
                "latent_dim",
                self.latent_dim.to_string(),
                "an even number",
                hint,
            );
        }
        for (channels, mult) in self.channels().into_iter().zip(&self.dim_mults) {
            let exact = (self.latent_dim as f64 * mult - channels as f64).abs() < 1e-6;
            if !exact || channels == 0 || !channels.is_multiple_of(GROUPS) {
                let found = format!("{:?} of {}", self.dim_mults, self.latent_dim);
                let allowed = format!("levels of a multiple of {GROUPS} channels");
                let hint = format!("a level of {channels} does not divide into {GROUPS} groups");
                return refuse("dim_mults", found, &allowed, &hint);
            }
        }
        Ok(())
    }

    /// Builds the network; its parameters are drawn when they are first used.
    ///
    /// # Errors
    /// As [`validate`](Self::validate).
    pub fn init(&self, init: &Initializer) -> Result<GmdUnet, Error> {
        self.validate()?;
        let channels = self.channels();
        let coarsest = channels.len() - 1;
        let width = self.latent_dim;
        let block = |inputs, outputs, init: &Initializer| {
            GmdResBlock::new(inputs, outputs, width, self.adagn, self.zero_init, init)
        };
        let downs = (0..channels.len()).map(|level| {
            let place = init.at("downs").at(&level.to_string());
            let inputs = match level {
                0 => self.in_channels,
                _ => channels[level - 1],
            };
            let outputs = channels[level];
            let halving = |place: &Initializer| Resample {
                conv: Conv1d::strided(outputs, outputs, 3, 2, &place.at("conv")),
            };
            DownLevel {
                at_0: block(inputs, outputs, &place.at("0")),
                at_1: block(outputs, outputs, &place.at("1")),
                at_3: (level < coarsest).then(|| halving(&place.at("3"))),
            }
        });
        let ups = (1..channels.len()).rev().enumerate().map(|(index, level)| {
            let place = init.at("ups").at(&index.to_string());
            let (inputs, outputs) = (2 * channels[level], channels[level - 1]);
            UpLevel {
                at_0: block(inputs, outputs, &place.at("0")),
                at_1: block(outputs, outputs, &place.at("1")),
                at_3: Upsample {
                    conv: ConvTranspose1d::doubling(outputs, &place.at("3").at("conv")),
                },
            }
        });
        let middle = channels[coarsest];
        let (time, last) = (init.at("time_mlp"), init.at("final_conv"));
        let output = Conv1d::new(channels[0], self.in_channels, 1, &last.at("1"));
        Ok(GmdUnet {
            time_mlp: CondMlp {
                at_0: Linear::new(self.cond_dim, 4 * width, &time.at("0")),
                at_2: Linear::new(4 * width, width, &time.at("2")),
            },
            downs: downs.collect(),
            mid_block1: block(middle, middle, &init.at("mid_block1")),
            mid_block2: block(middle, middle, &init.at("mid_block2")),
            ups: ups.collect(),
            final_conv: FinalConv {
                at_0: FinalBlock {
                    block: ConvNorm::new(channels[0], channels[0], &last.at("0").at("block")),
                },
                at_1: match self.zero_init {
                    true => output.zeroed(&last.at("1")),
                    false => output,
                },
            },
        })
    }
}

/// `Linear, Mish, Linear`: the condition that every block receives.
#[derive(Module, Debug)]
struct CondMlp {
    at_0: Linear,
    at_2: Linear,
}

/// Half the length: kernel 3, stride 2, padding 1.
#[derive(Module, Debug)]
struct Resample {
    conv: Conv1d,
}

#[derive(Module, Debug)]
struct Upsample {
    conv: ConvTranspose1d,
}

#[derive(Module, Debug)]
struct DownLevel {
    at_0: GmdResBlock,
    at_1: GmdResBlock,
    at_3: Option<Resample>,
}

#[derive(Module, Debug)]
struct UpLevel {
    at_0: GmdResBlock,
    at_1: GmdResBlock,
    at_3: Upsample,
}

#[derive(Module, Debug)]
struct FinalBlock {
    block: ConvNorm,
}

#[derive(Module, Debug)]
struct FinalConv {
    at_0: FinalBlock,
    at_1: Conv1d,
}

/// The UNet without what tells it timestep and text. Should be created with
/// [`GmdUnetConfig::init`].
///
/// There are as many levels down as multipliers and one less up; the skip of the finest level is
/// not used, as in the published models. Up level `i` of the module tree counts from the coarsest.
#[derive(Module, Debug)]
pub struct GmdUnet {
    time_mlp: CondMlp,
    downs: Vec<DownLevel>,
    mid_block1: GmdResBlock,
    mid_block2: GmdResBlock,
    ups: Vec<UpLevel>,
    final_conv: FinalConv,
}

impl GmdUnet {
    /// # Shapes
    /// - x, output: `[batch, in_channels, time]`, time a multiple of
    ///   [`GmdUnetConfig::length_multiple`]
    /// - cond: `[batch, cond_dim]`
    pub fn forward(&self, x: Tensor<3>, cond: Tensor<2>) -> Tensor<3> {
        self.forward_stages(x, cond, &mut ())
    }

    /// [`forward`](Self::forward), and what each stage gives: `c [batch, latent_dim]`, `downI.res0`,
    /// `downI.res1` (the skip), `downI.down`, `mid1`, `mid2`, `upI.res0`, `upI.res1`, `upI.up`, and
    /// `final0`, the last activation.
    pub fn forward_stages(
        &self,
        x: Tensor<3>,
        cond: Tensor<2>,
        stages: &mut impl Stages,
    ) -> Tensor<3> {
        let c = self.time_mlp.at_0.forward(cond);
        let c = self.time_mlp.at_2.forward(mish(c));
        stages.stage(format_args!("c"), || c.clone());
        let c = mish(c);
        let mut x = x;
        let mut skips = Vec::with_capacity(self.downs.len());
        for (index, level) in self.downs.iter().enumerate() {
            x = level.at_0.forward(x, c.clone());
            stages.stage(format_args!("down{index}.res0"), || x.clone());
            x = level.at_1.forward(x, c.clone());
            stages.stage(format_args!("down{index}.res1"), || x.clone());
            skips.push(x.clone());
            if let Some(halving) = &level.at_3 {
                x = halving.conv.forward(x);
            }
            stages.stage(format_args!("down{index}.down"), || x.clone());
        }
        x = self.mid_block1.forward(x, c.clone());
        stages.stage(format_args!("mid1"), || x.clone());
        x = self.mid_block2.forward(x, c.clone());
        stages.stage(format_args!("mid2"), || x.clone());
        for (index, level) in self.ups.iter().enumerate() {
            let skip = skips.pop().expect("one skip a level up");
            x = level.at_0.forward(concat_channels(x, skip), c.clone());
            stages.stage(format_args!("up{index}.res0"), || x.clone());
            x = level.at_1.forward(x, c.clone());
            stages.stage(format_args!("up{index}.res1"), || x.clone());
            x = level.at_3.conv.forward(x);
            stages.stage(format_args!("up{index}.up"), || x.clone());
        }
        let FinalConv { at_0, at_1 } = &self.final_conv;
        let h = at_0.block.convolution().forward(x);
        // The last convolution normalises its input itself: nothing holds this otherwise.
        stages.stage(format_args!("final0"), || {
            at_0.block.norm().forward(h.clone())
        });
        at_1.operation().norm(at_0.block.norm()).forward(h)
    }
}
