//! Validation of common settings that models of clips do not support.

use kinegrad_data::DataKind;
use kinegrad_diffusion::{DiffusionConfig, PredictionType};
use kinegrad_settings::{InvalidSetting, Refused, in_range, require};

use crate::config::{Config, SelectBy};

/// Rejects data other than clips, and selection by metrics of phrases.
///
/// # Errors
/// Names the key.
pub fn must_be_of_clips(config: &Config) -> Result<(), InvalidSetting> {
    let recipe = &config.train.recipe;
    require(
        matches!(
            config.data.kind,
            DataKind::Humanml3d | DataKind::SyntheticWalks
        ),
        "data.kind",
        "a kind of phrases",
        format!("\"humanml3d\" or \"synthetic_walks\" for recipe `{recipe}`"),
    )?;
    require(
        config.validation.select_by == SelectBy::Loss,
        "validation.select_by",
        "a metric of phrases",
        format!("\"loss\" for recipe `{recipe}`"),
    )
}

/// Rejects style settings in the sampler and `process`, because clips have no style.
///
/// # Errors
/// Names the key.
pub fn must_have_no_style(
    config: &Config,
    process: &DiffusionConfig,
) -> Result<(), InvalidSetting> {
    for (key, value) in [
        (
            "sampling.sampler.style_guidance_scale",
            config.sampling.sampler.style_guidance_scale,
        ),
        ("diffusion.style_drop_prob", process.style_drop_prob),
    ] {
        let Some(value) = value else { continue };
        let allowed = "nothing for models of clips, which have no style";
        require(false, key, value, allowed).hint("leave the key out")?;
    }
    Ok(())
}

/// Validates `loss.velocity`, which needs a network that predicts the clean motion.
///
/// # Errors
/// Names the key.
pub fn validate_velocity(velocity: f64, process: &DiffusionConfig) -> Result<(), InvalidSetting> {
    let key = "loss.velocity";
    in_range(key, velocity, 0.0..)?;
    require(
        velocity == 0.0 || process.prediction_type == PredictionType::Sample,
        key,
        velocity,
        "0 unless `diffusion.prediction_type = \"sample\"`: noise has no velocity",
    )
}
