//! The tables of a config that are this system's own, and what must hold of them.

use std::path::PathBuf;

use kinegrad_data::DataKind;
use kinegrad_diffusion::DiffusionConfig;
use kinegrad_models::ModelConfig;
use kinegrad_motion::emphasis::{EmphasisConfig, EmphasisError, EmphasisKind};
use serde::{Deserialize, Serialize};

use super::TRAJECTORY;
use super::networks::channels_of;
use crate::config::{Clip, Config, ConfigError, SystemTables};
use crate::error::Error;

/// The tables of this system.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GmdConfig {
    /// What a fine-tuning starts from.
    pub init: GmdInitConfig,
    /// The denoiser.
    pub model: ModelConfig,
    /// The space that a motion model works in.
    pub emphasis: EmphasisConfig,
    /// The diffusion process.
    pub diffusion: DiffusionConfig,
    /// The loss.
    pub loss: GmdLossConfig,
}

/// The table `init`: what a fine-tuning starts from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GmdInitConfig {
    /// Run or checkpoint of the same recipe; its averaged weights are taken, and its network,
    /// process, space and statistics.
    pub diffusion: PathBuf,
}

/// The table `loss`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GmdLossConfig {
    /// Of a motion model without a projection: the first four channels (root rotation, x, z and
    /// height) count by the square of this factor (Guided Motion Diffusion, appendix C.1).
    pub trajectory_scale: f64,
}

impl Default for GmdLossConfig {
    fn default() -> Self {
        Self {
            trajectory_scale: 1.0,
        }
    }
}

impl SystemTables for GmdConfig {
    const NAMES: &'static [&'static str] = &["init", "model", "emphasis", "diffusion", "loss"];

    const PASSED_OVER: &'static str = include_str!("passed_over.toml");

    fn resolved(self) -> Self {
        Self {
            model: self.model.resolved(),
            ..self
        }
    }
}

/// Refuses what this system cannot work with.
///
/// # Errors
/// Names the first key with a bad value.
pub(super) fn validate(config: &Config) -> Result<(), Error> {
    let own = GmdConfig::of(config)?;
    let recipe = &config.train.recipe;
    own.diffusion.validate()?;
    if !matches!(
        config.data.kind,
        DataKind::Humanml3d | DataKind::SyntheticWalks
    ) {
        let allowed = format!("\"humanml3d\" or \"synthetic_walks\" for recipe `{recipe}`");
        let found = "a kind of phrases";
        return Err(ConfigError::range("data.kind", found, allowed).into());
    }
    own.model.backbone(channels_of(config))?;
    if let Some(most) = own.model.resolved().padded_frames
        && config.data.target_frames > most
    {
        let allowed = format!("at most `model.padded_frames` ({most})");
        let found = config.data.target_frames;
        return Err(ConfigError::range("data.target_frames", found, allowed).into());
    }
    let timesteps = own.diffusion.num_train_timesteps;
    config.sampling.sampler.validate(timesteps)?;
    if config.sampling.clip == Clip::TrainingRange {
        let allowed = "\"none\", \"six\" or \"unit\": the ranges of joint features are not kept";
        return Err(ConfigError::range("sampling.clip", "\"training_range\"", allowed).into());
    }
    own.emphasis.validate().map_err(|error| match error {
        EmphasisError::InvalidSetting {
            key,
            found,
            allowed,
        } => ConfigError::range(format!("emphasis.{key}"), found, allowed).into(),
        other => Error::from(other),
    })?;
    let scale = own.loss.trajectory_scale;
    if !(scale > 0.0 && scale.is_finite()) {
        return Err(ConfigError::range("loss.trajectory_scale", scale, "more than 0").into());
    }
    let projects = own.emphasis.kind != EmphasisKind::None;
    if recipe == TRAJECTORY && projects {
        let allowed = "\"none\": the trajectory model's four channels are not projected";
        return Err(ConfigError::range("emphasis.kind", "a projection", allowed).into());
    }
    if scale != 1.0 && (projects || recipe == TRAJECTORY) {
        let allowed = "1 in a projected space, where no channel is the trajectory's, and in recipe \
                       `gmd_trajectory`, where all are";
        return Err(ConfigError::range("loss.trajectory_scale", scale, allowed).into());
    }
    config.sampling.steering.validate()
}

/// What is doubtful.
pub(super) fn warnings(config: &Config) -> Option<String> {
    let overtrains = config.train.recipe == TRAJECTORY
        && (config.train.patience == 0 || config.validation.every_steps == 0);
    overtrains.then(|| {
        "a trajectory model that has learned its paths by heart resists guidance, and this run \
         never stops early: set `train.patience` and `validation.every_steps`"
            .to_string()
    })
}
