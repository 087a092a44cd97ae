//! Runs on clips of joint features: recipes `gmd_motion` and `gmd_trajectory`.

use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_motion::{Representation as _, Statistics};
use kinegrad_train::clips::captions::with_captions;
use kinegrad_train::clips::path_condition::RootTrajectories;
use kinegrad_train::clips::training;
use kinegrad_train::config::Config;
use kinegrad_train::run::{Outcome, RunContext};
use kinegrad_train::{Error, Observer};

use super::load::{channels_of, model_in_space, projection_of, started, text_input};
use super::recipes::{JointMotion, clip_recipe};
use super::{Gmd, GmdConfig};
use crate::network::TextDenoiser;

fn joint_motion(
    own: &GmdConfig,
    config: &Config,
    model: &TextDenoiser,
    statistics: &Statistics,
) -> Result<Option<JointMotion>, Error> {
    let channels = statistics.channels();
    let projection = model
        .projection()
        .map(|projection| projection_of(&own.emphasis, &projection.to_host(), channels))
        .transpose()?;
    let skeleton = config.data.humanml3d.skeleton();
    let projection = projection.as_ref();
    Ok(JointMotion::new(
        &own.loss, &skeleton, statistics, projection,
    ))
}

pub(super) fn train(context: RunContext, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let mut own = context.config.own::<GmdConfig>().clone();
    let mut context = context.with_gradients(own.model.activation_checkpointing);
    let dataset = training::open(&context, observer)?;
    own.text = with_captions(own.text, &context, &dataset, observer)?;
    let config = context.config.clone().with_own(own.clone());
    context.config = config.clone();
    let start = training::start_of(&context, &own.init.diffusion, &Gmd)?;
    let statistics = training::statistics(&context, start.as_ref(), &dataset, observer)?;
    let channels = channels_of(&config);
    let model = match start {
        Some(start) => started(&start, &config, &context.device)?,
        None => model_in_space(&config, &context.device)?,
    };
    let joint_motion = joint_motion(&own, &config, &model, &statistics)?;
    let humanml3d = &config.data.humanml3d;
    let fps = humanml3d.representation().fps();
    let trajectories = || RootTrajectories::new(humanml3d.root, &statistics, fps);
    let trajectories = model.has_path().then(trajectories);
    let diffusion = GaussianDiffusion::new(&own.diffusion)?;
    let samples = training::samples(&dataset, &statistics, channels, text_input(&config));
    let (training_data, held_out) = context.training_data(dataset, statistics, samples)?;
    let recipe = clip_recipe(
        diffusion,
        channels,
        &own,
        trajectories,
        joint_motion,
        held_out,
    )
    .measuring_first(!own.init.diffusion.as_os_str().is_empty());
    context.train(training_data, recipe, model, observer)
}
