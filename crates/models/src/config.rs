//! The table `model` of a training config.

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::unet1d::UNet1dConfig;

/// Kinds of denoiser.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelKind {
    /// [`crate::UNet1d`].
    #[default]
    Unet1d,
}

/// Named sizes of the UNet. Parameter counts are for 25 motion and 163 audio channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelSize {
    /// Base 32, factors 1, 1, 2, 2: for tests and first steps.
    Tiny,
    /// Base 64, factors 1, 2, 4, 8: 16,342,361 parameters, the size of the reference run.
    #[default]
    Small,
    /// Base 256, factors 1, 2, 4, 8: 225,084,185 parameters, the document's literal defaults.
    Base,
    /// Base 256, factors 1, 2, 4, 4: 104,436,505 parameters, the nearest coherent reading of the
    /// document's claim of 116 M.
    Cc116m,
}

/// Which network to build: a named size and any number of sizes that differ from it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelConfig {
    /// Kind of network.
    pub kind: ModelKind,
    /// Named size that the other keys start from.
    pub size: ModelSize,
    /// Channels of level 0; a multiple of 32.
    pub model_channels: Option<usize>,
    /// Factor of each level's channels.
    pub channel_mult: Option<Vec<usize>>,
    /// Residual blocks of an encoder level.
    pub num_res_blocks: Option<usize>,
    /// Levels with attention, 0 being the finest.
    pub attention_levels: Option<Vec<usize>>,
    /// Attention heads.
    pub num_heads: Option<usize>,
    /// Feed the timestep in as scale and shift (FiLM) instead of adding it.
    pub use_scale_shift_norm: Option<bool>,
    /// Width of the time embedding.
    pub time_embed_dim: Option<usize>,
    /// Width of the projected audio features.
    pub context_dim: Option<usize>,
    /// Dropout inside the residual blocks.
    pub dropout: Option<f64>,
    /// Recompute cheap activations in the backward pass instead of keeping them.
    pub activation_checkpointing: bool,
}

impl ModelConfig {
    /// Every key filled in: what the size says where the config is silent.
    #[must_use]
    pub fn resolved(&self) -> Self {
        let (channels, mult, width): (usize, &[usize], usize) = match self.size {
            ModelSize::Tiny => (32, &[1, 1, 2, 2], 64),
            ModelSize::Small => (64, &[1, 2, 4, 8], 256),
            ModelSize::Base => (256, &[1, 2, 4, 8], 256),
            ModelSize::Cc116m => (256, &[1, 2, 4, 4], 256),
        };
        let channel_mult = self.channel_mult.clone().unwrap_or_else(|| mult.to_vec());
        let attention_levels = self
            .attention_levels
            .clone()
            .unwrap_or_else(|| (1..channel_mult.len()).collect());
        Self {
            kind: self.kind,
            size: self.size,
            model_channels: Some(self.model_channels.unwrap_or(channels)),
            channel_mult: Some(channel_mult),
            num_res_blocks: Some(self.num_res_blocks.unwrap_or(2)),
            attention_levels: Some(attention_levels),
            num_heads: Some(self.num_heads.unwrap_or(8)),
            use_scale_shift_norm: Some(self.use_scale_shift_norm.unwrap_or(true)),
            time_embed_dim: Some(self.time_embed_dim.unwrap_or(width)),
            context_dim: Some(self.context_dim.unwrap_or(width)),
            dropout: Some(self.dropout.unwrap_or(0.1)),
            activation_checkpointing: self.activation_checkpointing,
        }
    }

    /// The UNet for motion of `in_channels` under conditions of `cond_channels` per frame.
    ///
    /// # Errors
    /// As [`UNet1dConfig::validate`].
    pub fn unet1d(&self, in_channels: usize, cond_channels: usize) -> Result<UNet1dConfig, Error> {
        const FILLED: &str = "a resolved config has every key";
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
}
