//! Runs on clips of joint features: recipes `gmd_motion` and `gmd_trajectory`.

use std::sync::Arc;

use kinegrad_data::humanml::{Clip, ClipSamples};
use kinegrad_data::{Dataset, Loader};
use kinegrad_diffusion::GaussianDiffusion;

use super::networks::{ClipStart, channels_of, model_in_space, statistics_in};
use super::recipes::{GmdMotionRecipe, GmdTrajectoryRecipe};
use super::{GmdConfig, TRAJECTORY};
use crate::config::{Config, SystemTables};
use crate::denoising::HeldOut;
use crate::error::Error;
use crate::observer::Observer;
use crate::run::{Material, Outcome, Setup};

/// Trains as the setup's config says.
pub(super) fn train(setup: Setup, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let config = setup.config.clone();
    let own = GmdConfig::of(&config)?;
    let setup = setup.with_gradients(own.model.activation_checkpointing);
    let dataset = Dataset::<Clip>::open_with_progress(&config.data, &*observer.reading())?;
    for warning in &dataset.warnings {
        observer.warning(warning);
    }
    setup.same_dataset(dataset.digest)?;
    let start = match &setup.checkpoint {
        Some(_) => None,
        None => ClipStart::named(&config)?,
    };
    let statistics = match (&setup.checkpoint, &start) {
        (Some(checkpoint), _) => statistics_in(&checkpoint.state)?.clone(),
        (None, Some(start)) => start.statistics()?,
        (None, None) => dataset.statistics()?,
    };
    let channels = channels_of(&config);
    let model = match start {
        Some(start) => start.model(&config, &setup.device)?,
        None => model_in_space(&config, &setup.device)?,
    };
    let kept = statistics.clone();
    let statistics = Arc::new(statistics);
    let representation = dataset.representation.clone();
    let samples = move |clips, config: &Config| {
        let (data, seed) = (&config.data, config.run.seed);
        let (representation, statistics) = (representation.clone(), statistics.clone());
        ClipSamples::new(clips, representation, statistics, channels, data, seed)
    };
    let clips = dataset.validation.load()?.into();
    let held_out = HeldOut::new(samples(clips, &config), &config.validation);
    let diffusion = GaussianDiffusion::new(&own.diffusion)?;
    let material = Material {
        train: dataset.train.len(),
        validation: dataset.validation.len(),
        skipped: dataset.skipped,
        digest: dataset.digest,
        statistics: kept,
        loader: Box::new(move |config, first_batch| {
            let samples = samples(dataset.train, config);
            Loader::new(samples, &config.data, config.run.seed, first_batch)
        }),
    };
    match setup.recipe.name {
        TRAJECTORY => {
            let recipe = GmdTrajectoryRecipe::new(diffusion, held_out);
            setup.train(material, recipe, model, observer)
        }
        _ => {
            let scale = own.loss.trajectory_scale;
            let recipe = GmdMotionRecipe::new(diffusion, channels, scale, held_out);
            setup.train(material, recipe, model, observer)
        }
    }
}
