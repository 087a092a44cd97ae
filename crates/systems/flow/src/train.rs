//! Training of both networks.

use std::sync::Arc;

use kinegrad_data::Dataset;
use kinegrad_data::humanml::Clip;
use kinegrad_motion::humanml::Root;
use kinegrad_motion::{ChannelMoments, Statistics};

use super::load::{model, text_input};
use super::recipe::FlowRecipe;
use super::windows::{PoseSpace, PoseWindows};
use super::{FlowTables, statistics_in};
use kinegrad_train::Error;
use kinegrad_train::Observer;
use kinegrad_train::ProcessGroup;
use kinegrad_train::clips::captions::with_captions;
use kinegrad_train::clips::training;
use kinegrad_train::config::Config;
use kinegrad_train::run::{Outcome, RunContext, TrainingData};

/// Statistics of features and poses.
pub(super) type Both = [Statistics; 2];

/// Trains according to the context's config.
pub(super) fn train(context: RunContext, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let mut own = context.config.own::<FlowTables>().clone();
    let mut context = context.with_gradients(own.model.activation_checkpointing);
    let dataset = training::open(&context, observer)?;
    own.text = with_captions(own.text, &context, &dataset, observer)?;
    let config = context.config.clone().with_own(own.clone());
    context.config = config.clone();
    let skeleton = config.data.humanml3d.skeleton.skeleton();
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
        let labels = text.labels().cloned();
        let seed = config.run.seed;
        PoseWindows::new(clips, space.clone(), features, target, labels, seed)
    };
    let (training_data, held_out) = context.training_data(dataset, features, samples)?;
    let training_data = TrainingData {
        network_statistics: Some(target),
        ..training_data
    };
    context.train(
        training_data,
        FlowRecipe::new(own.pose, held_out),
        model,
        observer,
    )
}

/// The statistics of the training clips, each frame with a heading of its own: not those of the
/// dataset's features, whose heading is smoothed.
fn measured(
    dataset: &Dataset<Clip>,
    space: &PoseSpace,
    group: &ProcessGroup,
    observer: &mut dyn Observer,
) -> Result<Both, Error> {
    let mut all: Option<[ChannelMoments; 2]> = None;
    let take = |of_clip: [ChannelMoments; 2]| match &mut all {
        Some(all) => all
            .iter_mut()
            .zip(&of_clip)
            .for_each(|(all, one)| all.merge(one)),
        None => all = Some(of_clip),
    };
    let progress = observer.reading();
    dataset
        .train
        .measure_among(|clip| space.moments(clip), take, &*progress, group)?;
    let [features, target] = all
        .expect("a dataset has training clips")
        .map(Statistics::standard);
    Ok([
        Statistics {
            root: Some(Root::Relative),
            ..features
        },
        target,
    ])
}
