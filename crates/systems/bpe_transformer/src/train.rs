//! Training on clips of joint features.

use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_motion::Representation;

use super::load::{initial_network, text_input};
use super::path_condition::RootTrajectories;
use super::recipe::recipe;
use super::{BpeTables, BpeTransformer};
use kinegrad_train::Error;
use kinegrad_train::Observer;
use kinegrad_train::clips::captions::with_captions;
use kinegrad_train::clips::training;
use kinegrad_train::run::{Outcome, Setup};

/// Trains according to the setup's config.
pub(super) fn train(setup: Setup, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let mut own = setup.config.own::<BpeTables>().clone();
    let mut setup = setup.with_gradients(own.model.activation_checkpointing);
    let dataset = training::open(&setup, observer)?;
    own.text = with_captions(own.text, &setup, &dataset, observer)?;
    let config = setup.config.clone().with_own(own.clone());
    setup.config = config.clone();
    let start = training::start_of(&setup, &own.init.diffusion, &BpeTransformer)?;
    let statistics = training::statistics(&setup, start.as_ref(), &dataset, observer)?;
    let humanml3d = &config.data.humanml3d;
    let fps = humanml3d.skeleton.skeleton().description().fps;
    let trajectories = RootTrajectories::new(humanml3d.root, &statistics, fps);
    let channels = config.data.humanml3d.representation().channels();
    let network = initial_network(&config, start.as_ref(), &setup.device)?;
    let diffusion = GaussianDiffusion::new(&own.diffusion)?;
    let samples = training::samples(&dataset, &statistics, channels, text_input(&config));
    let (material, held_out) = setup.material(dataset, statistics, samples)?;
    setup.train(
        material,
        recipe(diffusion, channels, &own, trajectories, held_out)
            .measuring_first(!own.init.diffusion.as_os_str().is_empty()),
        network,
        observer,
    )
}
