//! The evaluation of a trained model on goals taken from held-out clips.

use std::path::Path;

use kinegrad_data::humanml::ClipDataset;
use kinegrad_data::{DataKind, ValidationSplit};
use kinegrad_motion::metrics::GoalReport;
use serde_json::to_value;

use super::{GoalSettings, GoalTask, TextMotion, evaluate_goals};
use crate::error::Error;
use crate::evaluation::{Column, Evaluate, Evaluated, EvaluationRequest, Group};
use crate::sampling::Subject;
use crate::systems::gmd::ClipGenerator;
use crate::systems::gmd::sample::{must_draw_paths, name_of};

/// Goals without `--goals`.
const GOALS: usize = 20;

/// Key frames of a goal without `--keyframes`.
const KEYFRAMES: usize = 5;

/// An evaluation that leads the model to goals and measures.
///
/// # Errors
/// If what is asked for does not apply, or nothing is held out.
pub fn prepare<'a>(
    subject: &'a Subject,
    request: &EvaluationRequest,
) -> Result<Evaluate<'a>, Error> {
    if request.items == Some(0) {
        return Err(Error::usage("`--goals` is 0", "ask for at least one goal"));
    }
    for (name, given) in [
        ("--seeds", request.seeds.is_some()),
        ("--cond", request.noise.is_some()),
    ] {
        if given {
            let message = format!("`{name}` with runs on clips of joint features");
            let hint = "they are measured on goals: `--goals`, `--keyframes`, `--obstacles`";
            return Err(Error::usage(message, hint));
        }
    }
    let mut data = subject.config.data.clone();
    if let Some(source) = &request.source {
        data.kind = DataKind::Humanml3d;
        data.source = Some(source.clone());
        // The dataset's own lists say what is held out.
        data.validation = ValidationSplit::default();
    }
    let dataset = ClipDataset::open(&data)?;
    if dataset.validation.is_empty() {
        let message = format!("no clip is held out for {}", subject.checkpoint.display());
        let hint = "goals are taken from held-out clips: give a dataset that holds out some with \
                    `--source URI`";
        return Err(Error::usage(message, hint));
    }
    let wanted = request.items.unwrap_or(GOALS);
    let held_out = (0..dataset.validation.len().min(wanted))
        .map(|position| dataset.validation.get(position))
        .collect::<Result<Vec<_>, _>>()?;
    let mut remarks = Vec::new();
    if held_out.len() < wanted {
        remarks.push(format!(
            "note: {} clips are held out for {}, fewer than {wanted} goals",
            held_out.len(),
            subject.checkpoint.display()
        ));
    }
    if let Some(path) = &request.trajectory {
        must_draw_paths(path)?;
    }
    let trajectory = request.trajectory.clone();
    let read = |files| TextMotion::read(files, &subject.device);
    let evaluator = request.evaluator.as_ref().map(read).transpose()?;
    let settings = GoalSettings {
        task: GoalTask {
            keyframes: request.keyframes.unwrap_or(KEYFRAMES),
            obstacles: request.obstacles.unwrap_or(0),
            frames: data.target_frames,
        },
        sampling: subject.config.sampling.clone(),
        seed: request.seed,
    };
    Ok(Box::new(move |on_step| {
        let load = |path: &Path| ClipGenerator::load(path, subject.weights, &subject.device);
        let generator = load(&subject.checkpoint)?;
        let trajectory = trajectory.as_deref().map(load).transpose()?;
        let evaluation = evaluate_goals(
            &generator,
            trajectory.as_ref(),
            &held_out,
            &settings,
            evaluator.as_ref(),
            &mut |stage, done, all| on_step(name_of(stage), done, all),
        )?;
        if let Some(reports) = &evaluation.text_motion {
            remarks.push(format!("{}: {}", evaluation.run, reports.drawn));
            remarks.push(format!("held out: {}", reports.real));
        }
        Ok(Evaluated {
            run: evaluation.run.clone(),
            report: "eval-goals",
            json: to_value(&evaluation).expect("plain data"),
            drawn: column(Some(evaluation.step), &evaluation.drawn),
            real: column(None, &evaluation.real),
            remarks,
        })
    }))
}

fn column(step: Option<u64>, report: &GoalReport) -> Column {
    let rows = report.rows();
    Column {
        facts: vec![("step", step)],
        groups: vec![Group {
            key: "goals",
            title: "",
            numbers: rows
                .iter()
                .map(|(name, value, _)| (name.to_string(), *value))
                .collect(),
            rows: rows
                .iter()
                .map(|(name, value, unit)| {
                    let shown = value.map(|value| format!("{value:.4}"));
                    (format!("{name}{unit}"), shown)
                })
                .collect(),
        }],
    }
}
