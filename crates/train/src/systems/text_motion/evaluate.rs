//! How well the encoders tell held-out clips apart.

use std::sync::Arc;

use kinegrad_data::humanml::{Clip, labels_of};
use kinegrad_motion::metrics::text_motion::TextMotionReport;
use serde_json::json;

use super::TextMotion;
use crate::TrainedModel;
use crate::clips::evaluator::TextMotionEvaluator as _;
use crate::clips::{dataset_or, with_held_out};
use crate::error::Error;
use crate::evaluation::{Column, Evaluate, Evaluated, EvaluationRequest, Group, Number};

/// An evaluation of the encoders on the held-out clips themselves.
///
/// # Errors
/// If the request does not apply, or nothing is held out.
pub(super) fn prepare<'a>(
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
) -> Result<Evaluate<'a>, Error> {
    request.refuse(
        &["--audio-ablation", "--trajectory-run"],
        trained.path(),
        "a run of recipe `text_motion`",
        "its encoders generate nothing: leave it out",
    )?;
    let data = dataset_or(&trained.config().data, request.source.as_deref());
    let dataset = with_held_out(
        &data,
        trained.path(),
        "texts are matched with held-out clips",
        &request.together,
    )?;
    let held_out = dataset.validation.load()?;
    let labels = labels_of(&data)?.unwrap_or_default();
    let (seed, frames) = (request.seed, data.target_frames);
    Ok(Box::new(move |_| {
        let evaluator = TextMotion::of_run(&trained.saved, trained.weights, &trained.device)?;
        let clips: Vec<&Clip> = held_out.iter().map(Arc::as_ref).collect();
        let cut = clips.iter().map(|clip| {
            let length = clip.features.frames().min(frames);
            clip.features.slice(0..length)
        });
        let real: Vec<_> = cut.collect();
        let report = evaluator.reports(&real, &real, &clips, &labels, seed)?.real;
        let run = trained.config().run.name.clone();
        Ok(Evaluated {
            run: run.clone(),
            report: "eval-text-motion",
            json: json!({ "run": run, "seed": seed, "real": report }),
            drawn: column(&report),
            real: column(&report),
            remarks: Vec::new(),
        })
    }))
}

fn column(report: &TextMotionReport) -> Column {
    let numbers = report.rows().into_iter().map(|(name, value)| Number {
        name: name.clone(),
        value,
        line: Some((name, value.map(|value| format!("{value:.4}")))),
    });
    Column {
        facts: vec![
            ("clips", Some(report.samples as u64)),
            ("pools", Some(report.pools as u64)),
        ],
        groups: vec![Group {
            key: "text_motion",
            title: "",
            numbers: numbers.collect(),
        }],
    }
}
