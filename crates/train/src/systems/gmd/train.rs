//! Runs on clips of joint features: recipes `gmd_motion` and `gmd_trajectory`.

use std::sync::Arc;

use kinegrad_data::Dataset;
use kinegrad_data::humanml::{Clip, ClipSamples};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_models::TextDenoiser;
use kinegrad_motion::Statistics;
use kinegrad_motion::emphasis::EmphasisProjection;

use super::networks::{channels_of, model_in_space, started, statistics_in, text_input};
use super::recipes::{JointMotion, clip_recipe};
use super::{Gmd, GmdConfig};
use crate::clips::captions::with_captions;
use crate::config::Config;
use crate::error::Error;
use crate::observer::Observer;
use crate::run::{Material, Outcome, Setup};
use crate::start::Start;

/// The loss of the joints that `own` asks for, in the space of `model`.
fn joint_motion(
    own: &GmdConfig,
    config: &Config,
    model: &TextDenoiser,
    statistics: &Statistics,
) -> Result<Option<JointMotion>, Error> {
    let channels = statistics.channels();
    let projection = model.projection().map(|projection| {
        let matrix = projection.to_host();
        EmphasisProjection::from_matrix(
            &matrix,
            channels,
            own.emphasis.scale,
            &own.emphasis.channels,
        )
    });
    let projection = projection.transpose()?;
    let skeleton = config.data.humanml3d.skeleton.skeleton();
    let projection = projection.as_ref();
    Ok(JointMotion::new(
        &own.loss, &skeleton, statistics, projection,
    ))
}

/// Trains as the setup's config says.
pub(super) fn train(setup: Setup, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let mut own = setup.config.own::<GmdConfig>().clone();
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
        None => Start::named("init.diffusion", &own.init.diffusion, &Gmd)?,
    };
    let statistics = match (&setup.checkpoint, &start) {
        (Some(checkpoint), _) => statistics_in(&checkpoint.state)?.clone(),
        (None, Some(start)) => statistics_in(start.state())?.clone(),
        (None, None) => dataset.statistics_among(&*observer.reading(), &*setup.together)?,
    };
    let channels = channels_of(&config);
    let model = match start {
        Some(start) => started(&start, &config, &setup.device)?,
        None => model_in_space(&config, &setup.device)?,
    };
    let joint_motion = joint_motion(&own, &config, &model, &statistics)?;
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
    let recipe = clip_recipe(diffusion, channels, &own.loss, joint_motion, held_out)
        .measuring_first(!own.init.diffusion.as_os_str().is_empty());
    setup.train(material, recipe, model, observer)
}
