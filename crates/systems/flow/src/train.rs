//! Training of both networks.

use std::sync::Arc;

use kinegrad_data::Dataset;
use kinegrad_data::humanml::Clip;
use kinegrad_motion::humanml::Root;
use kinegrad_motion::{ChannelMoments, Statistics};
use kinegrad_train::clips::captions::with_captions;
use kinegrad_train::clips::training;
use kinegrad_train::config::Config;
use kinegrad_train::run::{Outcome, RunContext, TrainingData};
use kinegrad_train::{Error, Observer, ProcessGroup};

use super::load::{model, text_input};
use super::recipe::FlowRecipe;
use super::windows::{PoseSpace, PoseWindows};
use super::{FlowTables, statistics_in};

pub(super) fn train(context: RunContext, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let mut own = context.config.own::<FlowTables>().clone();
    let mut context = context.with_gradients(own.model.activation_checkpointing);
    let dataset = training::open(&context, observer)?;
    own.text = with_captions(own.text, &context, &dataset, observer)?;
    let config = context.config.clone().with_own(own.clone());
    context.config = config.clone();
    let skeleton = config.data.humanml3d.skeleton();
    let space = PoseSpace::new(skeleton, &own.pose, config.data.target_frames);
    let [features, target] = match &context.checkpoint {
        Some(checkpoint) => statistics_in(&checkpoint.state)?,
        None => measured(&dataset, &space, &context.group, observer)?,
    };
    let model = model(&config, &context.device)?;
    let text = text_input(&config);
    let shared = [&features, &target].map(|statistics| Arc::new(statistics.clone()));
    let samples = move |clips, config: &Config| {
        let [features, target] = shared.clone();
        PoseWindows {
            clips,
            space: space.clone(),
            features,
            target,
            text: text.clone(),
            seed: config.run.seed,
        }
    };
    let (training_data, held_out) = context.training_data(dataset, features, samples)?;
    let training_data = TrainingData {
        network_statistics: Some(target),
        ..training_data
    };
    let recipe = FlowRecipe {
        pose: own.pose,
        held_out,
    };
    context.train(training_data, recipe, model, observer)
}

/// The statistics of the training clips with each frame's own heading. The dataset's statistics use
/// smoothed headings.
fn measured(
    dataset: &Dataset<Clip>,
    space: &PoseSpace,
    group: &ProcessGroup,
    observer: &mut dyn Observer,
) -> Result<[Statistics; 2], Error> {
    let mut all: Option<[ChannelMoments; 2]> = None;
    let take = |of_clip: [ChannelMoments; 2]| match &mut all {
        Some(all) => all
            .iter_mut()
            .zip(&of_clip)
            .for_each(|(all, one)| all.merge(one)),
        None => all = Some(of_clip),
    };
    let (train, progress) = (&dataset.train, observer.reading());
    train.measure_among(|clip| space.moments(clip), take, &*progress, group)?;
    let all = all.expect("a dataset has training clips");
    let [mut features, target] = all.map(Statistics::standard);
    features.root = Some(Root::Relative);
    Ok([features, target])
}
