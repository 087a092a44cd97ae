//! The UNet over time with adaptive group normalization.

use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::activation::mish;
use kinegrad_kernels::concat_channels;
use kinegrad_models::config::{MAX_WIDTH, must_be_even};
use kinegrad_models::layers::{Conv1d, ConvTranspose1d, Linear};
use kinegrad_models::{Initializer, NamedSizes, NetworkConfig, Stages};
use kinegrad_settings::{InvalidSetting, Refused, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::res_block::{ConvNorm, GROUPS, GmdResBlock};

const MAX_PADDED_FRAMES: usize = 1 << 20;

/// The sizes of a [`GmdUnet`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GmdUnetConfig {
    /// Width of the condition inside the network, and base width of the multipliers.
    pub latent_dim: usize,
    /// Channels of each level divided by `latent_dim`.
    pub dim_mults: Vec<f64>,
    /// The condition scales and shifts (AdaGN) instead of being added.
    pub adagn: bool,
    /// The last convolution and each block's second convolution are initialized to zero, so that a
    /// new network outputs 0.
    pub zero_init: bool,
    /// The input, mixed between channels, is added to the output with a timestep-dependent gain per
    /// channel. Without this skip, small networks lose detail of the input. Not in the published
    /// models.
    pub input_skip: bool,
    /// Number of frames to which every clip is padded.
    pub padded_frames: usize,
}

impl Default for GmdUnetConfig {
    fn default() -> Self {
        Self::motion()
    }
}

impl NetworkConfig for GmdUnetConfig {
    const KIND: &'static str = "gmd_unet";

    const SIZES: NamedSizes<Self> = &[
        ("gmd_motion", Self::motion),
        ("gmd_trajectory", Self::trajectory),
        ("gmd_motion_tiny", Self::motion_tiny),
        ("gmd_trajectory_tiny", Self::trajectory_tiny),
    ];
}

/// Named sizes (Guided Motion Diffusion, table D.1), with parameter counts of the published models
/// for 263 and 4 channels.
impl GmdUnetConfig {
    /// 233,507,079 parameters.
    pub fn motion() -> Self {
        Self {
            latent_dim: 512,
            dim_mults: vec![2.0; 4],
            adagn: true,
            zero_init: true,
            input_skip: false,
            padded_frames: 224,
        }
    }

    /// 8,549,316 parameters.
    pub fn trajectory() -> Self {
        Self {
            dim_mults: vec![0.125, 0.25, 0.5],
            ..Self::motion()
        }
    }

    /// For tests and first steps.
    pub fn motion_tiny() -> Self {
        Self {
            latent_dim: 40,
            dim_mults: vec![1.0; 3],
            ..Self::motion()
        }
    }

    /// For tests and first steps.
    pub fn trajectory_tiny() -> Self {
        Self {
            latent_dim: 64,
            dim_mults: vec![0.25, 0.5, 1.0],
            ..Self::motion()
        }
    }

    /// Channels of each level.
    pub fn channels(&self) -> Vec<usize> {
        let channels = |mult: &f64| (self.latent_dim as f64 * mult).round() as usize;
        self.dim_mults.iter().map(channels).collect()
    }

    /// # Errors
    /// Names the invalid key.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        let (width, mults) = (self.latent_dim, &self.dim_mults);
        let (key, count) = ("model.dim_mults", mults.len());
        let allowed = "1 to 16 numbers, one a level";
        require(
            (1..=16).contains(&count),
            key,
            format!("{mults:?}"),
            allowed,
        )
        .hint("the motion model has [2.0, 2.0, 2.0, 2.0]")?;
        must_be_even(width, "the published models have 512")?;
        for (channels, mult) in self.channels().into_iter().zip(mults) {
            let exact = (width as f64 * mult - channels as f64).abs() < 1e-6;
            let fits = (1..=MAX_WIDTH).contains(&channels) && channels.is_multiple_of(GROUPS);
            let allowed = format!("levels of a multiple of {GROUPS} channels, at most {MAX_WIDTH}");
            require(exact && fits, key, format!("{mults:?} of {width}"), allowed)
                .hint(format!("a level has {channels}"))?;
        }
        let multiple = 1 << mults.len().saturating_sub(1);
        let (key, frames) = ("model.padded_frames", self.padded_frames);
        let fits = (1..=MAX_PADDED_FRAMES).contains(&frames) && frames.is_multiple_of(multiple);
        let allowed = format!("a multiple of {multiple}, at most {MAX_PADDED_FRAMES}");
        require(fits, key, frames, allowed)
            .hint("every level but the last halves the length; the published models have 224")
    }

    /// Approximate number of values kept for the backward pass, per item.
    pub fn activations(&self) -> u64 {
        let of_level = |(level, width): (usize, usize)| {
            let frames = self.padded_frames.div_ceil(1 << level) as u64;
            // Two blocks down and two blocks up; the first block up also takes the skip connection.
            24 * width as u64 * frames
        };
        self.channels().into_iter().enumerate().map(of_level).sum()
    }

    /// The network for motion of `in_channels`, conditioned on a vector of width `cond_dim`.
    ///
    /// # Errors
    /// As [`validate`](Self::validate).
    pub fn init(
        &self,
        in_channels: usize,
        cond_dim: usize,
        init: &Initializer,
    ) -> Result<GmdUnet, InvalidSetting> {
        self.validate()?;
        let channels = self.channels();
        let coarsest = channels.len() - 1;
        let width = self.latent_dim;
        let block = |inputs, outputs, init: &Initializer| {
            GmdResBlock::new(inputs, outputs, width, self.adagn, self.zero_init, init)
        };
        let inputs = [in_channels].into_iter().chain(channels.iter().copied());
        let downs = inputs
            .zip(&channels)
            .enumerate()
            .map(|(level, (inputs, &outputs))| {
                let place = init.at("downs").at(&level.to_string());
                let halving = || Conv1d::strided(outputs, outputs, 3, 2, &place.at("3").at("conv"));
                DownLevel {
                    at_0: block(inputs, outputs, &place.at("0")),
                    at_1: block(outputs, outputs, &place.at("1")),
                    at_3_at_conv: (level < coarsest).then(halving),
                }
            });
        let ups = (1..channels.len()).rev().enumerate().map(|(index, level)| {
            let place = init.at("ups").at(&index.to_string());
            let (inputs, outputs) = (2 * channels[level], channels[level - 1]);
            UpLevel {
                at_0: block(inputs, outputs, &place.at("0")),
                at_1: block(outputs, outputs, &place.at("1")),
                at_3_at_conv: ConvTranspose1d::doubling(outputs, &place.at("3").at("conv")),
            }
        });
        let (finest, middle) = (channels[0], channels[coarsest]);
        let (time, last) = (init.at("time_mlp"), init.at("final_conv"));
        let output = Conv1d::new(finest, in_channels, 1, &last.at("1"));
        Ok(GmdUnet {
            time_mlp_at_0: Linear::new(cond_dim, 4 * width, &time.at("0")),
            time_mlp_at_2: Linear::new(4 * width, width, &time.at("2")),
            downs: downs.collect(),
            mid_block1: block(middle, middle, &init.at("mid_block1")),
            mid_block2: block(middle, middle, &init.at("mid_block2")),
            ups: ups.collect(),
            final_conv_at_0_at_block: ConvNorm::new(finest, finest, &last.at("0").at("block")),
            final_conv_at_1: match self.zero_init {
                true => output.zeroed(&last.at("1")),
                false => output,
            },
        })
    }
}

#[derive(Module, Debug)]
struct DownLevel {
    at_0: GmdResBlock,
    at_1: GmdResBlock,
    at_3_at_conv: Option<Conv1d>,
}

#[derive(Module, Debug)]
struct UpLevel {
    at_0: GmdResBlock,
    at_1: GmdResBlock,
    at_3_at_conv: ConvTranspose1d,
}

/// The UNet without the embeddings of timestep and text, made by [`GmdUnetConfig::init`].
///
/// The UNet has one level down per multiplier, and one level less up, counted from the coarsest.
/// The finest level's skip is unused, as in the published models. The blocks' condition is `Linear,
/// Mish, Linear` of the input condition.
#[derive(Module, Debug)]
pub struct GmdUnet {
    time_mlp_at_0: Linear,
    time_mlp_at_2: Linear,
    downs: Vec<DownLevel>,
    mid_block1: GmdResBlock,
    mid_block2: GmdResBlock,
    ups: Vec<UpLevel>,
    final_conv_at_0_at_block: ConvNorm,
    final_conv_at_1: Conv1d,
}

impl GmdUnet {
    /// Passes each stage to `stages`: `c [batch, latent_dim]`, `downI.res0`, `downI.res1` (the
    /// skip), `downI.down`, `mid1`, `mid2`, `upI.res0`, `upI.res1`, `upI.up`, and `final0`, the
    /// last activation.
    ///
    /// # Shapes
    /// - x, output: `[batch, in_channels, time]`, time a multiple of `2^(levels - 1)`
    /// - cond: `[batch, cond_dim]`
    pub fn forward_stages(
        &self,
        mut x: Tensor<3>,
        cond: Tensor<2>,
        stages: &mut impl Stages,
    ) -> Tensor<3> {
        let c = self.time_mlp_at_0.forward(cond);
        let c = self.time_mlp_at_2.forward(mish(c));
        stages.stage(format_args!("c"), || c.clone());
        let c = mish(c);
        let mut skips = Vec::with_capacity(self.downs.len());
        for (index, level) in self.downs.iter().enumerate() {
            x = level.at_0.forward(x, c.clone());
            stages.stage(format_args!("down{index}.res0"), || x.clone());
            x = level.at_1.forward(x, c.clone());
            stages.stage(format_args!("down{index}.res1"), || x.clone());
            skips.push(x.clone());
            if let Some(halving) = &level.at_3_at_conv {
                x = halving.forward(x);
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
            x = level.at_3_at_conv.forward(x);
            stages.stage(format_args!("up{index}.up"), || x.clone());
        }
        let last = &self.final_conv_at_0_at_block;
        let h = last.convolution().forward(x);
        // The last convolution normalizes its input internally, so no other tensor contains this
        // stage.
        stages.stage(format_args!("final0"), || last.norm().forward(h.clone()));
        let output = self.final_conv_at_1.operation();
        output.norm(last.norm()).forward(h)
    }
}
