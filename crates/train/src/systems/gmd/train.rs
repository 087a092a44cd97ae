//! Runs on clips of joint features: recipes `gmd_motion` and `gmd_trajectory`.

use std::ops::Range;
use std::sync::Arc;

use kinegrad_data::Loader;
use kinegrad_data::humanml::{ClipDataset, collate_clips};
use kinegrad_diffusion::GaussianDiffusion;

use super::networks::{ClipStart, channels_of, model_in_space};
use super::recipes::{GmdMotionRecipe, GmdTrajectoryRecipe};
use super::{GmdConfig, TRAJECTORY};
use crate::config::SystemTables;
use crate::denoising::HeldOut;
use crate::error::Error;
use crate::observer::Observer;
use crate::run::{Material, Outcome, Setup};

/// Trains as the setup's config says.
pub(super) fn train(setup: Setup, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let config = setup.config.clone();
    let own = GmdConfig::of(&config)?;
    let setup = setup.with_gradients(own.model.activation_checkpointing);
    let dataset = ClipDataset::open_with_progress(&config.data, &*observer.reading())?;
    for warning in &dataset.warnings {
        observer.warning(warning);
    }
    setup.same_dataset(dataset.digest)?;
    let start = match &setup.checkpoint {
        Some(_) => None,
        None => ClipStart::named(&config)?,
    };
    let statistics = match (&setup.checkpoint, &start) {
        (Some(checkpoint), _) => checkpoint.state.statistics.features()?.clone(),
        (None, Some(start)) => start.statistics()?,
        (None, None) => dataset.statistics.clone(),
    };
    let channels = 0..channels_of(&config);
    let model = match start {
        Some(start) => start.model(&config, &setup.device)?,
        None => model_in_space(&config, &setup.device)?,
    };
    let statistics = Arc::new(statistics);
    let held_out = dataset.validation.load()?;
    let ids = held_out.iter().map(|clip| clip.id.clone()).collect();
    let collate = {
        let (statistics, channels) = (statistics.clone(), channels.clone());
        let data = config.data.clone();
        move |range: Range<usize>| {
            collate_clips(&held_out[range], &statistics, channels.clone(), &data)
        }
    };
    let held_out = HeldOut::new(ids, &config.validation, collate);
    let diffusion = GaussianDiffusion::new(&own.diffusion)?;
    let material = Material {
        train: dataset.train.len(),
        validation: dataset.validation.len(),
        skipped: dataset.skipped,
        digest: dataset.digest,
        statistics: (*statistics).clone().into(),
        loader: {
            let (train, channels) = (dataset.train, channels.clone());
            Box::new(move |config, first_batch| {
                let (data, seed) = (&config.data, config.run.seed);
                Loader::clips(train, statistics, channels, data, seed, first_batch)
            })
        },
    };
    match setup.recipe.name {
        TRAJECTORY => {
            let recipe = GmdTrajectoryRecipe::new(diffusion, held_out);
            setup.train(material, recipe, model, observer)
        }
        _ => {
            let scale = own.loss.trajectory_scale;
            let recipe = GmdMotionRecipe::new(diffusion, channels.len(), scale, held_out);
            setup.train(material, recipe, model, observer)
        }
    }
}
