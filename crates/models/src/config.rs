//! The table `model` of a training config.

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::gmd::GmdUnetConfig;
use crate::text_denoiser::Backbone;
use crate::transformer::EncoderConfig;
use crate::unet1d::UNet1dConfig;

/// Kinds of denoiser.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelKind {
    /// [`crate::UNet1d`], under audio.
    #[default]
    Unet1d,
    /// [`crate::gmd::GmdUnet`], under a text.
    GmdUnet,
    /// [`crate::transformer::Encoder`], under a text.
    MdmTransformer,
}

impl ModelKind {
    /// Its name in a config.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unet1d => "unet1d",
            Self::GmdUnet => "gmd_unet",
            Self::MdmTransformer => "mdm_transformer",
        }
    }

    /// Whether its condition is a text and not audio.
    pub fn reads_text(self) -> bool {
        self != Self::Unet1d
    }
}

/// Named sizes. Parameter counts are for 25 motion and 163 audio channels, or for the 263 or 4
/// channels of the published models under a text.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelSize {
    /// Base 32, factors 1, 1, 2, 2: for tests and first steps.
    Tiny,
    /// Base 64, factors 1, 2, 4, 8: 16,342,361 parameters, the size of the reference run.
    #[default]
    Small,
    /// Base 256, factors 1, 2, 4, 8: 225,084,185 parameters, CC-MotionGen's literal defaults.
    Base,
    /// Base 256, factors 1, 2, 4, 4: 104,436,505 parameters, the nearest coherent reading of
    /// CC-MotionGen's claim of 116 M (docs/sources.md, section 1.15).
    Cc116m,
    /// Of `gmd_unet`: 512 wide, factors 2, 2, 2, 2: 233,507,079 parameters (Guided Motion
    /// Diffusion, table D.1).
    GmdMotion,
    /// Of `gmd_unet`: 512 wide, factors 0.125, 0.25, 0.5: 8,549,316 parameters (table D.1).
    GmdTrajectory,
    /// Of `gmd_unet`: 40 wide, factors 1, 1, 1: for tests and first steps.
    GmdMotionTiny,
    /// Of `gmd_unet`: 64 wide, factors 0.25, 0.5, 1: for tests and first steps.
    GmdTrajectoryTiny,
    /// Of `mdm_transformer`: 512 wide, 8 layers, 4 heads.
    Mdm,
    /// Of `mdm_transformer`: 64 wide, 2 layers, 4 heads: for tests and first steps.
    MdmTiny,
}

impl ModelSize {
    /// The kind of network it is a size of.
    pub fn kind(self) -> ModelKind {
        match self {
            Self::Tiny | Self::Small | Self::Base | Self::Cc116m => ModelKind::Unet1d,
            Self::GmdMotion
            | Self::GmdTrajectory
            | Self::GmdMotionTiny
            | Self::GmdTrajectoryTiny => ModelKind::GmdUnet,
            Self::Mdm | Self::MdmTiny => ModelKind::MdmTransformer,
        }
    }
}

/// Which network to build: a named size and any number of sizes that differ from it. Keys of
/// another kind of network are refused.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelConfig {
    /// Kind of network.
    pub kind: ModelKind,
    /// Named size that the other keys start from; must be one of the kind.
    pub size: ModelSize,
    /// Of `unet1d`: channels of level 0; a multiple of 32.
    pub model_channels: Option<usize>,
    /// Of `unet1d`: factor of each level's channels.
    pub channel_mult: Option<Vec<usize>>,
    /// Of `unet1d`: residual blocks of an encoder level.
    pub num_res_blocks: Option<usize>,
    /// Of `unet1d`: levels with attention, 0 being the finest.
    pub attention_levels: Option<Vec<usize>>,
    /// Of `unet1d` and `mdm_transformer`: attention heads.
    pub num_heads: Option<usize>,
    /// Of `unet1d`: feed the timestep in as scale and shift (FiLM) instead of adding it.
    pub use_scale_shift_norm: Option<bool>,
    /// Of `unet1d`: width of the time embedding.
    pub time_embed_dim: Option<usize>,
    /// Of `unet1d`: width of the projected audio features.
    pub context_dim: Option<usize>,
    /// Of `unet1d`: dropout inside the residual blocks.
    pub dropout: Option<f64>,
    /// Of `gmd_unet` and `mdm_transformer`: width of the condition, and of a token.
    pub latent_dim: Option<usize>,
    /// Of `gmd_unet`: channels of each level over `latent_dim`.
    pub dim_mults: Option<Vec<f64>>,
    /// Of `gmd_unet`: the condition scales and shifts (AdaGN) instead of being added.
    pub adagn: Option<bool>,
    /// Of `gmd_unet`: second convolutions and the last one begin at zero.
    pub zero_init: Option<bool>,
    /// Of `gmd_unet`: frames that every clip is padded to.
    pub padded_frames: Option<usize>,
    /// Of `mdm_transformer`: layers.
    pub num_layers: Option<usize>,
    /// Of `mdm_transformer`: width inside each layer's two linear maps.
    pub ff_size: Option<usize>,
    /// Recompute cheap activations in the backward pass instead of keeping them.
    pub activation_checkpointing: bool,
}

/// Why the keys of its kind are there once a config is resolved.
const FILLED: &str = "a resolved config has every key of its kind";

impl ModelConfig {
    /// Every key of its kind filled in: what the size says where the config is silent.
    #[must_use]
    pub fn resolved(&self) -> Self {
        match self.kind {
            ModelKind::Unet1d => self.resolved_unet1d(),
            ModelKind::GmdUnet => self.resolved_gmd_unet(),
            ModelKind::MdmTransformer => self.resolved_transformer(),
        }
    }

    fn resolved_unet1d(&self) -> Self {
        let (channels, mult, width): (usize, &[usize], usize) = match self.size {
            ModelSize::Tiny => (32, &[1, 1, 2, 2], 64),
            ModelSize::Base => (256, &[1, 2, 4, 8], 256),
            ModelSize::Cc116m => (256, &[1, 2, 4, 4], 256),
            _ => (64, &[1, 2, 4, 8], 256),
        };
        let channel_mult = self.channel_mult.clone().unwrap_or_else(|| mult.to_vec());
        let attention_levels = self
            .attention_levels
            .clone()
            .unwrap_or_else(|| (1..channel_mult.len()).collect());
        Self {
            model_channels: Some(self.model_channels.unwrap_or(channels)),
            channel_mult: Some(channel_mult),
            num_res_blocks: Some(self.num_res_blocks.unwrap_or(2)),
            attention_levels: Some(attention_levels),
            num_heads: Some(self.num_heads.unwrap_or(8)),
            use_scale_shift_norm: Some(self.use_scale_shift_norm.unwrap_or(true)),
            time_embed_dim: Some(self.time_embed_dim.unwrap_or(width)),
            context_dim: Some(self.context_dim.unwrap_or(width)),
            dropout: Some(self.dropout.unwrap_or(0.1)),
            ..self.clone()
        }
    }

    fn resolved_gmd_unet(&self) -> Self {
        let (width, mults): (usize, &[f64]) = match self.size {
            ModelSize::GmdTrajectory => (512, &[0.125, 0.25, 0.5]),
            ModelSize::GmdMotionTiny => (40, &[1.0, 1.0, 1.0]),
            ModelSize::GmdTrajectoryTiny => (64, &[0.25, 0.5, 1.0]),
            _ => (512, &[2.0, 2.0, 2.0, 2.0]),
        };
        Self {
            latent_dim: Some(self.latent_dim.unwrap_or(width)),
            dim_mults: Some(self.dim_mults.clone().unwrap_or_else(|| mults.to_vec())),
            adagn: Some(self.adagn.unwrap_or(true)),
            zero_init: Some(self.zero_init.unwrap_or(true)),
            padded_frames: Some(self.padded_frames.unwrap_or(224)),
            ..self.clone()
        }
    }

    fn resolved_transformer(&self) -> Self {
        let (width, layers, inner) = match self.size {
            ModelSize::MdmTiny => (64, 2, 128),
            _ => (512, 8, 1024),
        };
        Self {
            latent_dim: Some(self.latent_dim.unwrap_or(width)),
            num_layers: Some(self.num_layers.unwrap_or(layers)),
            num_heads: Some(self.num_heads.unwrap_or(4)),
            ff_size: Some(self.ff_size.unwrap_or(inner)),
            ..self.clone()
        }
    }

    /// Refuses a size or a key of another kind of network.
    ///
    /// # Errors
    /// Names the key.
    pub fn validate_kind(&self) -> Result<(), Error> {
        let kind = self.kind;
        let refuse = |key: &str, found: String, allowed: String| {
            let hint = format!("`model.kind` is `{}`", kind.name());
            Err(Error::Config {
                key: format!("model.{key}"),
                found,
                allowed,
                hint,
            })
        };
        // The default size stands for the kind's own largest.
        if self.size.kind() != kind && self.size != ModelSize::default() {
            let found = format!("a size of `{}`", self.size.kind().name());
            return refuse("size", found, format!("the sizes of `{}`", kind.name()));
        }
        use ModelKind::{GmdUnet, MdmTransformer, Unet1d};
        let keys: [(&str, bool, &[ModelKind]); 16] = [
            ("model_channels", self.model_channels.is_some(), &[Unet1d]),
            ("channel_mult", self.channel_mult.is_some(), &[Unet1d]),
            ("num_res_blocks", self.num_res_blocks.is_some(), &[Unet1d]),
            (
                "attention_levels",
                self.attention_levels.is_some(),
                &[Unet1d],
            ),
            (
                "num_heads",
                self.num_heads.is_some(),
                &[Unet1d, MdmTransformer],
            ),
            (
                "use_scale_shift_norm",
                self.use_scale_shift_norm.is_some(),
                &[Unet1d],
            ),
            ("time_embed_dim", self.time_embed_dim.is_some(), &[Unet1d]),
            ("context_dim", self.context_dim.is_some(), &[Unet1d]),
            ("dropout", self.dropout.is_some(), &[Unet1d]),
            (
                "latent_dim",
                self.latent_dim.is_some(),
                &[GmdUnet, MdmTransformer],
            ),
            ("dim_mults", self.dim_mults.is_some(), &[GmdUnet]),
            ("adagn", self.adagn.is_some(), &[GmdUnet]),
            ("zero_init", self.zero_init.is_some(), &[GmdUnet]),
            ("padded_frames", self.padded_frames.is_some(), &[GmdUnet]),
            ("num_layers", self.num_layers.is_some(), &[MdmTransformer]),
            ("ff_size", self.ff_size.is_some(), &[MdmTransformer]),
        ];
        for (key, set, kinds) in keys {
            if set && !kinds.contains(&kind) {
                let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
                let allowed = format!("this key in networks of kind `{}`", names.join("`, `"));
                return refuse(key, "set".into(), allowed);
            }
        }
        Ok(())
    }

    /// The UNet for motion of `in_channels` under conditions of `cond_channels` per frame.
    ///
    /// # Errors
    /// As [`UNet1dConfig::validate`] and [`validate_kind`](Self::validate_kind).
    pub fn unet1d(&self, in_channels: usize, cond_channels: usize) -> Result<UNet1dConfig, Error> {
        self.must_be(&[ModelKind::Unet1d])?;
        let resolved = self.resolved();
        let config = UNet1dConfig {
            in_channels,
            cond_channels,
            model_channels: resolved.model_channels.expect(FILLED),
            channel_mult: resolved.channel_mult.expect(FILLED),
            num_res_blocks: resolved.num_res_blocks.expect(FILLED),
            attention_levels: resolved.attention_levels.expect(FILLED),
            num_heads: resolved.num_heads.expect(FILLED),
            use_scale_shift_norm: resolved.use_scale_shift_norm.expect(FILLED),
            time_embed_dim: resolved.time_embed_dim.expect(FILLED),
            context_dim: resolved.context_dim.expect(FILLED),
            dropout: resolved.dropout.expect(FILLED),
        };
        config.validate()?;
        Ok(config)
    }

    /// The network for clips of `in_channels` under a text.
    ///
    /// # Errors
    /// As [`GmdUnetConfig::validate`], [`EncoderConfig::validate`] and
    /// [`validate_kind`](Self::validate_kind).
    pub fn backbone(&self, in_channels: usize) -> Result<Backbone, Error> {
        self.must_be(&[ModelKind::GmdUnet, ModelKind::MdmTransformer])?;
        let resolved = self.resolved();
        let latent_dim = resolved.latent_dim.expect(FILLED);
        if self.kind == ModelKind::MdmTransformer {
            let config = EncoderConfig {
                in_channels,
                latent_dim,
                num_layers: resolved.num_layers.expect(FILLED),
                num_heads: resolved.num_heads.expect(FILLED),
                ff_size: resolved.ff_size.expect(FILLED),
            };
            config.validate()?;
            return Ok(Backbone::Transformer(config));
        }
        let config = GmdUnetConfig {
            in_channels,
            cond_dim: latent_dim,
            latent_dim,
            dim_mults: resolved.dim_mults.expect(FILLED),
            adagn: resolved.adagn.expect(FILLED),
            zero_init: resolved.zero_init.expect(FILLED),
        };
        config.validate()?;
        Ok(Backbone::Unet(
            config,
            resolved.padded_frames.expect(FILLED),
        ))
    }

    fn must_be(&self, kinds: &[ModelKind]) -> Result<(), Error> {
        if !kinds.contains(&self.kind) {
            let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
            return Err(Error::Config {
                key: "model.kind".into(),
                found: self.kind.name().into(),
                allowed: names.join(", "),
                hint: "that is what `train.recipe` trains".into(),
            });
        }
        self.validate_kind()
    }
}
