//! The tables of a config that are this system's own, and what must hold of them.

use std::path::PathBuf;

use kinegrad_data::DataKind;
use kinegrad_diffusion::DiffusionConfig;
use kinegrad_models::Backbone;
use kinegrad_models::gmd::GmdUnetConfig;
use kinegrad_models::transformer::EncoderConfig;
use kinegrad_motion::emphasis::{EmphasisConfig, EmphasisKind};
use kinegrad_settings::{ABOVE_ZERO, Refused, in_range, require};
use serde::{Deserialize, Serialize};

use super::TRAJECTORY;
use crate::config::{Clip, Config, ModelTable, NetworkKind, SystemTables};
use crate::error::Error;

/// The tables of this system.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GmdConfig {
    /// What a fine-tuning starts from.
    pub init: GmdInitConfig,
    /// The denoiser.
    pub model: ModelTable<Backbone>,
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

    const NETWORKS: &'static [NetworkKind] = &[
        NetworkKind::of::<GmdUnetConfig>(),
        NetworkKind::of::<EncoderConfig>(),
    ];
}

/// Refuses what this system cannot work with.
///
/// # Errors
/// Names the first key with a bad value.
pub(super) fn validate(config: &Config) -> Result<(), Error> {
    let own = GmdConfig::of(config)?;
    let Config { data, sampling, .. } = config;
    let recipe = &config.train.recipe;
    own.diffusion.validate()?;
    require(
        matches!(data.kind, DataKind::Humanml3d | DataKind::SyntheticWalks),
        "data.kind",
        "a kind of phrases",
        format!("\"humanml3d\" or \"synthetic_walks\" for recipe `{recipe}`"),
    )?;
    own.model.network.validate()?;
    if let Some(most) = own.model.network.longest() {
        let allowed = format!("at most `model.padded_frames` ({most})");
        let found = data.target_frames;
        require(found <= most, "data.target_frames", found, allowed)?;
    }
    let timesteps = own.diffusion.num_train_timesteps;
    sampling.sampler.validate(timesteps)?;
    require(
        sampling.clip != Clip::TrainingRange,
        "sampling.clip",
        "\"training_range\"",
        "\"none\", \"six\" or \"unit\": the ranges of joint features are not kept",
    )?;
    own.emphasis.validate()?;
    let scale = own.loss.trajectory_scale;
    in_range("loss.trajectory_scale", scale, ABOVE_ZERO)?;
    let projects = own.emphasis.kind != EmphasisKind::None;
    require(
        !(recipe == TRAJECTORY && projects),
        "emphasis.kind",
        "a projection",
        "\"none\": the trajectory model's four channels are not projected",
    )?;
    require(
        scale == 1.0 || !(projects || recipe == TRAJECTORY),
        "loss.trajectory_scale",
        scale,
        "1 in a projected space, where no channel is the trajectory's, and in recipe \
         `gmd_trajectory`, where all are",
    )?;
    Ok(sampling.steering.validate().within("sampling.steering")?)
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
