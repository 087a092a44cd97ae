//! What must hold of the config of a run on clips.

use kinegrad_data::DataKind;
use kinegrad_diffusion::LossType;
use kinegrad_motion::emphasis::{EmphasisError, EmphasisKind};

use super::{Clip, Config, ConfigError, Recipe};
use crate::Error;
use crate::clips::clip_channels;

/// Refuses what recipes on clips cannot work with.
pub(super) fn validate(config: &Config) -> Result<(), Error> {
    let recipe = config.train.recipe.name();
    if !matches!(
        config.data.kind,
        DataKind::Humanml3d | DataKind::SyntheticWalks
    ) {
        let allowed = format!("\"humanml3d\" or \"synthetic_walks\" for recipe `{recipe}`");
        let found = "a kind of phrases";
        return Err(ConfigError::range("data.kind", found, allowed).into());
    }
    config.model.backbone(clip_channels(config))?;
    if let Some(most) = config.model.resolved().padded_frames
        && config.data.target_frames > most
    {
        let allowed = format!("at most `model.padded_frames` ({most})");
        let found = config.data.target_frames;
        return Err(ConfigError::range("data.target_frames", found, allowed).into());
    }
    if config.sampling.clip == Clip::TrainingRange {
        let allowed = "\"none\", \"six\" or \"unit\": the ranges of joint features are not kept";
        return Err(ConfigError::range("sampling.clip", "\"training_range\"", allowed).into());
    }
    if config.sampling.count_at_end > 0 {
        let allowed = "0 for recipes on clips: `kinegrad sample` draws";
        let found = config.sampling.count_at_end;
        return Err(ConfigError::range("sampling.count_at_end", found, allowed).into());
    }
    let diffusion = &config.diffusion;
    if diffusion.loss_type != LossType::Mse {
        let allowed = "\"mse\" for recipes on clips";
        return Err(ConfigError::range("diffusion.loss_type", "another", allowed).into());
    }
    if let Some(snr_gamma) = diffusion.snr_gamma {
        let allowed = "no such key for recipes on clips";
        return Err(ConfigError::range("diffusion.snr_gamma", snr_gamma, allowed).into());
    }
    if !config.init.decoder.as_os_str().is_empty() {
        let found = config.init.decoder.display();
        let allowed = "nothing for recipes on clips: they have no decoder";
        return Err(ConfigError::range("init.decoder", found, allowed).into());
    }
    config.emphasis.validate().map_err(|error| match error {
        EmphasisError::InvalidSetting {
            key,
            found,
            allowed,
        } => ConfigError::range(format!("emphasis.{key}"), found, allowed).into(),
        other => Error::from(other),
    })?;
    let scale = config.loss.trajectory_scale;
    if !(scale > 0.0 && scale.is_finite()) {
        return Err(ConfigError::range("loss.trajectory_scale", scale, "more than 0").into());
    }
    let projects = config.emphasis.kind != EmphasisKind::None;
    if config.train.recipe == Recipe::GmdTrajectory && projects {
        let allowed = "\"none\": the trajectory model's four channels are not projected";
        return Err(ConfigError::range("emphasis.kind", "a projection", allowed).into());
    }
    if scale != 1.0 && (projects || config.train.recipe == Recipe::GmdTrajectory) {
        let allowed = "1 in a projected space, where no channel is the trajectory's, and in recipe \
                       `gmd_trajectory`, where all are";
        return Err(ConfigError::range("loss.trajectory_scale", scale, allowed).into());
    }
    config.sampling.steering.validate()
}

/// Refuses clips for recipes on phrases.
pub(super) fn refuse_clips(config: &Config) -> Result<(), ConfigError> {
    match config.data.kind {
        DataKind::Phrases | DataKind::Synthetic => Ok(()),
        DataKind::Humanml3d | DataKind::SyntheticWalks => {
            let recipe = config.train.recipe.name();
            let allowed = format!("\"phrases\" or \"synthetic\" for recipe `{recipe}`");
            Err(ConfigError::range("data.kind", "a kind of clips", allowed))
        }
    }
}

/// What is doubtful.
pub(super) fn warnings(config: &Config) -> Option<String> {
    let overtrains = config.train.recipe == Recipe::GmdTrajectory
        && (config.train.patience == 0 || config.validation.every_steps == 0);
    overtrains.then(|| {
        "a trajectory model that has learned its paths by heart resists guidance, and this run \
         never stops early: set `train.patience` and `validation.every_steps`"
            .to_string()
    })
}
