//! Training on clips of joint features.

use std::sync::Arc;

use kinegrad_data::Dataset;
use kinegrad_data::humanml::{Clip, ClipSamples};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_motion::Representation;

use super::BpeTables;
use super::BpeTransformer;
use super::networks::text_input;
use super::networks::{begun, statistics_in};
use super::recipe::recipe;
use super::told::Ways;
use crate::clips::captions::with_captions;
use crate::config::Config;
use crate::error::Error;
use crate::observer::Observer;
use crate::run::{Material, Outcome, Setup};
use crate::start::Start;

/// Trains as the setup's config says.
pub(super) fn train(setup: Setup, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let mut own = setup.config.own::<BpeTables>().clone();
    let mut setup = setup.with_gradients(own.model.activation_checkpointing);
    let data = &setup.config.data;
    let dataset = Dataset::<Clip>::open_among(data, &*observer.reading(), &*setup.together)?;
    setup.check_dataset(&dataset, observer)?;
    let (data, together) = (&setup.config.data, &setup.together);
    own.text = with_captions(own.text, data, &dataset, together, observer)?;
    let config = setup.config.clone().with_own(own.clone());
    setup.config = config.clone();
    let start = match &setup.checkpoint {
        Some(_) => None,
        None => Start::named("init.diffusion", &own.init.diffusion, &BpeTransformer)?,
    };
    let statistics = match (&setup.checkpoint, &start) {
        (Some(checkpoint), _) => statistics_in(&checkpoint.state)?.clone(),
        (None, Some(start)) => statistics_in(start.state())?.clone(),
        (None, None) => dataset.statistics_among(&*observer.reading(), &*setup.together)?,
    };
    let humanml3d = &config.data.humanml3d;
    let fps = humanml3d.skeleton.skeleton().description().fps;
    let ways = Ways::new(humanml3d.root, &statistics, fps);
    let channels = config.data.humanml3d.representation().channels();
    let network = begun(&config, start.as_ref(), &setup.device)?;
    let diffusion = GaussianDiffusion::new(&own.diffusion)?;
    let text = text_input(&config);
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
    let held_out = held_out.among(&setup.together);
    setup.train(
        material,
        recipe(diffusion, channels, &own, ways, held_out)
            .measuring_first(!own.init.diffusion.as_os_str().is_empty()),
        network,
        observer,
    )
}
