//! Training on clips of joint features.

use std::sync::Arc;

use kinegrad_data::Dataset;
use kinegrad_data::humanml::{Clip, ClipSamples};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_motion::Representation;

use super::BpeTables;
use super::networks::{network, statistics_in};
use super::recipe::recipe;
use crate::captions::{TextInput, with_captions};
use crate::config::{Config, SystemTables};
use crate::error::Error;
use crate::observer::Observer;
use crate::run::{Material, Outcome, Setup};

/// Trains as the setup's config says.
pub(super) fn train(setup: Setup, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let own = BpeTables::of(&setup.config)?;
    let mut setup = setup.with_gradients(own.model.activation_checkpointing);
    let data = &setup.config.data;
    let dataset = Dataset::<Clip>::open_with_progress(data, &*observer.reading())?;
    for warning in &dataset.warnings {
        observer.warning(warning);
    }
    setup.same_dataset(dataset.digest)?;
    let config = with_captions(setup.config.clone(), &dataset, observer)?;
    setup.config = config.clone();
    let statistics = match &setup.checkpoint {
        Some(checkpoint) => statistics_in(&checkpoint.state)?.clone(),
        None => dataset.statistics_with_progress(&*observer.reading())?,
    };
    let channels = config.data.humanml3d.representation().channels();
    let network = network(&config, &setup.device)?;
    let diffusion = GaussianDiffusion::new(&own.diffusion)?;
    let text = TextInput::of(&config)?;
    let (representation, shared) = (dataset.representation.clone(), Arc::new(statistics.clone()));
    let samples = move |clips, config: &Config| {
        let (data, seed) = (&config.data, config.run.seed);
        let (representation, statistics) = (representation.clone(), shared.clone());
        let samples = ClipSamples::new(clips, representation, statistics, channels, data, seed);
        match text.labels() {
            Some(labels) => samples.with_labels(labels.clone()),
            None => samples,
        }
    };
    let (material, held_out) = Material::new(dataset, statistics, &config, samples)?;
    setup.train(
        material,
        recipe(diffusion, channels, &own, held_out),
        network,
        observer,
    )
}
