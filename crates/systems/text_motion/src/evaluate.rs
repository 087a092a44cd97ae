//! The evaluation of the encoders: retrieval of held-out clips by their captions.

use std::sync::Arc;

use kinegrad_data::humanml::{Clip, labels_of};
use kinegrad_train::clips::evaluator::TextMotionEvaluator as _;
use kinegrad_train::evaluation::{
    Evaluation, EvaluationRequest, Group, Results, clips_with_held_out,
};
use kinegrad_train::{Error, TrainedModel};
use serde_json::json;

use super::TextMotion;

/// An evaluation of the encoders on the held-out clips themselves.
pub(super) fn prepare<'a>(
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
) -> Result<Evaluation<'a>, Error> {
    let purpose = "captions are matched with held-out clips";
    let own_data = &trained.config().data;
    let (data, dataset) = clips_with_held_out(own_data, trained, request, purpose)?;
    let held_out = dataset.validation.load()?;
    let labels = labels_of(&data)?.unwrap_or_default();
    let (seed, frames) = (request.seed, data.target_frames);
    Ok(Evaluation {
        report: "eval-text-motion",
        memory: 0,
        memory_hint: "",
        remarks: Vec::new(),
        measure: Box::new(move |_| {
            let evaluator = TextMotion::of_run(&trained.saved, trained.weights, &trained.device)?;
            let clips: Vec<&Clip> = held_out.iter().map(Arc::as_ref).collect();
            let features = clips.iter().map(|clip| &clip.features);
            let cut = features.map(|features| features.slice(0..features.frames().min(frames)));
            let real: Vec<_> = cut.collect();
            let report = evaluator.reports(&real, &real, &clips, &labels, seed)?.real;
            let count = |count: usize| [Some(count as u64); 2];
            Ok(Results {
                json: json!({ "real": report }),
                facts: vec![
                    ("clips", count(report.samples)),
                    ("pools", count(report.pools)),
                ],
                samples: None,
                real: vec![Group::new("text_motion", "", &report)],
                verdict: Vec::new(),
                remarks: Vec::new(),
            })
        }),
    })
}
