//! Training on clips of joint features.

use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_motion::Representation;
use kinegrad_train::clips::captions::with_captions;
use kinegrad_train::clips::training;
use kinegrad_train::run::{Outcome, RunContext};
use kinegrad_train::{Error, Observer};

use super::load::{initial_network, text_input};
use super::recipe::recipe;
use super::{BpeTables, BpeTransformer};
use kinegrad_train::clips::path_condition::RootTrajectories;

pub(super) fn train(context: RunContext, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let mut own = context.config.own::<BpeTables>().clone();
    let mut context = context.with_gradients(own.model.activation_checkpointing);
    let dataset = training::open(&context, observer)?;
    own.text = with_captions(own.text, &context, &dataset, observer)?;
    let config = context.config.clone().with_own(own.clone());
    context.config = config.clone();
    let start = training::start_of(&context, &own.init.diffusion, &BpeTransformer)?;
    let statistics = training::statistics(&context, start.as_ref(), &dataset, observer)?;
    let humanml3d = &config.data.humanml3d;
    let fps = humanml3d.skeleton().description().fps;
    let trajectories = RootTrajectories::new(humanml3d.root, &statistics, fps);
    let channels = config.data.humanml3d.representation().channels();
    let network = initial_network(&config, start.as_ref(), &context.device)?;
    let diffusion = GaussianDiffusion::new(&own.diffusion)?;
    let samples = training::samples(&dataset, &statistics, channels, text_input(&config));
    let (training_data, held_out) = context.training_data(dataset, statistics, samples)?;
    context.train(
        training_data,
        recipe(diffusion, channels, &own, trajectories, held_out)
            .measuring_first(!own.init.diffusion.as_os_str().is_empty()),
        network,
        observer,
    )
}
