//! The evaluation of a trained model on goals derived from held-out clips.

use kinegrad_data::ValidationSplit;
use kinegrad_data::humanml::labels_of;
use kinegrad_train::clips::captions::must_know_texts;
use kinegrad_train::evaluation::{
    Evaluation, EvaluationRequest, clips_with_held_out, note_if_fewer,
};
use kinegrad_train::{Error, TrainedModel};

use super::super::load::text_input;
use super::GoalTask;
use super::goals::GoalEvaluation;
use crate::generate::sampled_frames;
use crate::load::footprint;
use crate::sample::trajectory_model;
use crate::{ClipGenerator, EvaluationSplit, GmdConfig};

/// An evaluation of position control.
pub fn prepare<'a>(
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
) -> Result<Evaluation<'a>, Error> {
    let settings = &trained.config().own::<GmdConfig>().evaluation;
    let mut data = trained.config().data.clone();
    if settings.split == EvaluationSplit::Test {
        data.humanml3d.validation_list = data.humanml3d.test_list.clone();
        data.validation = ValidationSplit::default();
    }
    let purpose = "goals are derived from held-out clips";
    let (data, dataset) = clips_with_held_out(&data, trained, request, purpose)?;
    let held_out = dataset.validation.evenly(settings.goals)?;
    let note = note_if_fewer(held_out.len(), settings.goals, "goals", trained);
    must_know_texts(&text_input(trained.config()), &held_out)?;
    let frames = sampled_frames(trained.config(), data.target_frames);
    let repeated = settings.variety_clips.min(held_out.len()) * settings.variety_repeats;
    let at_once = settings.batch_size.min(held_out.len().max(repeated));
    let networks = footprint(trained.config(), frames)?;
    let trajectory = request
        .trajectory
        .clone()
        .map(|saved| trajectory_model(trained, saved));
    let trajectory = trajectory.transpose()?;
    let mut labels = Default::default();
    if let Some(evaluator) = &request.evaluator {
        evaluator.must_take(held_out[0].features.layout())?;
        labels = labels_of(&data)?.unwrap_or_default();
    }
    let task = GoalTask {
        keyframes: settings.keyframes,
        keyframe_placement: settings.keyframe_placement,
        obstacles: settings.obstacles,
        margin: settings.margin,
        frames: data.target_frames,
    };
    let request = request.clone();
    Ok(Evaluation {
        // Evaluations with and without a trajectory model write separate reports, for comparison.
        report: match trajectory {
            Some(_) => "eval-goals-two-stage",
            None => "eval-goals",
        },
        memory: networks.of_sampling(at_once, true, trained.on_host),
        memory_hint: "generate for fewer goals at a time: `evaluation.batch_size`",
        remarks: note.into_iter().collect(),
        measure: Box::new(move |on_step| {
            let generator = ClipGenerator::load(trained)?;
            let trajectory = trajectory.as_ref().map(ClipGenerator::load).transpose()?;
            let evaluation = GoalEvaluation {
                request: &request,
                task,
                held_out: &held_out,
                labels: &labels,
                generator: &generator,
                trajectory: trajectory.as_ref(),
            };
            evaluation.run(on_step)
        }),
    })
}
