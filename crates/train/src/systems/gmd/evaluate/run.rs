//! The evaluation of a trained model on goals taken from held-out clips.

use std::path::Path;

use kinegrad_data::ValidationSplit;
use kinegrad_data::humanml::labels_of;
use kinegrad_motion::metrics::GoalReport;
use serde_json::to_value;

use super::{GoalSettings, GoalTask, Models, Replicated, VarietyReport, evaluate_goals};
use crate::captions::must_know_texts;
use crate::checkpoint::{Weights, resolve_checkpoint};
use crate::clips::{dataset_or, with_held_out};
use crate::config::SystemTables;
use crate::error::Error;
use crate::evaluation::{Column, Evaluate, Evaluated, EvaluationRequest, Group, Number};
use crate::sampling::Subject;
use crate::systems::gmd::generate::drawn_frames;
use crate::systems::gmd::networks::footprint;
use crate::systems::gmd::sample::must_draw_paths;
use crate::systems::gmd::{ClipGenerator, EvaluationSplit, GmdConfig};
use crate::systems::text_motion::TextMotion;

/// An evaluation of position control.
///
/// # Errors
/// If the request does not apply, or nothing is held out.
pub fn prepare<'a>(
    subject: &'a Subject,
    request: &EvaluationRequest,
) -> Result<Evaluate<'a>, Error> {
    request.refuse(
        &["--audio-ablation"],
        &subject.checkpoint,
        "a run on clips",
        "only models of phrases hear music",
    )?;
    let asked = GmdConfig::of(&subject.config)?.evaluation;
    let mut data = dataset_or(&subject.config.data, request.source.as_deref());
    if asked.split == EvaluationSplit::Test {
        data.humanml3d.validation_list = data.humanml3d.test_list.clone();
        data.validation = ValidationSplit::default();
    }
    let dataset = with_held_out(
        &data,
        &subject.checkpoint,
        "goals are taken from held-out clips",
        &request.together,
    )?;
    let wanted = asked.goals;
    let held_out = dataset.validation.evenly(wanted)?;
    let mut remarks = Vec::new();
    if held_out.len() < wanted {
        remarks.push(format!(
            "note: {} clips are held out for {}, fewer than {wanted} goals",
            held_out.len(),
            subject.checkpoint.display()
        ));
    }
    must_know_texts(&subject.config, &held_out)?;
    let frames = drawn_frames(&subject.config, data.target_frames);
    let repeated = asked.variety_clips.min(held_out.len()) * asked.variety_repeats;
    let at_once = asked.batch_size.min(held_out.len().max(repeated));
    let networks = footprint(&subject.config, frames)?;
    let needed = networks.of_sampling(at_once, true, subject.on_host);
    let hint = "draw for fewer goals together: `evaluation.batch_size`";
    request.must_fit(needed, hint)?;
    if let Some(path) = &request.trajectory {
        must_draw_paths(path)?;
    }
    let (trajectory, together) = (request.trajectory.clone(), request.together.clone());
    let run = &asked.evaluator.run;
    let evaluator = match run.as_os_str().is_empty() {
        false => {
            let checkpoint = resolve_checkpoint(run, |_| {})?;
            Some(TextMotion::of_run(
                &checkpoint,
                Weights::Ema,
                &subject.device,
            )?)
        }
        true => {
            let files = asked.evaluator.is_given().then_some(&asked.evaluator);
            let read = |files| TextMotion::read(files, &subject.device);
            files.map(read).transpose()?
        }
    };
    let evaluator = match evaluator {
        Some(evaluator) => {
            evaluator.must_take(held_out[0].features.layout())?;
            Some(evaluator.with_labels(labels_of(&data)?.unwrap_or_default()))
        }
        None => None,
    };
    let settings = GoalSettings {
        task: GoalTask {
            keyframes: asked.keyframes,
            keyframe_placement: asked.keyframe_placement,
            obstacles: asked.obstacles,
            margin: asked.margin,
            frames: data.target_frames,
        },
        sampling: subject.config.sampling.clone(),
        seed: request.seed,
        batch_size: asked.batch_size,
        replications: asked.replications,
        variety_clips: asked.variety_clips,
        variety_repeats: asked.variety_repeats,
    };
    // The two are compared: neither replaces the other's report.
    let report = match trajectory {
        Some(_) => "eval-goals-two-stage",
        None => "eval-goals",
    };
    Ok(Box::new(move |on_step| {
        let load = |path: &Path| ClipGenerator::load(path, subject.weights, &subject.device);
        let generator = load(&subject.checkpoint)?;
        let trajectory = trajectory.as_deref().map(load).transpose()?;
        let models = Models {
            generator: &generator,
            trajectory: trajectory.as_ref(),
            evaluator: evaluator.as_ref(),
        };
        let evaluation = evaluate_goals(models, &held_out, &settings, &together, on_step)?;
        if let Some(reports) = &evaluation.text_motion {
            remarks.push(format!("{}: {}", evaluation.run, reports.drawn.mean));
            remarks.push(format!("held out: {}", reports.real.mean));
        }
        // Real motion has one clip of each condition.
        let none = evaluation.variety.as_ref().map(|variety| Replicated {
            mean: VarietyReport {
                trajectory_diversity: None,
                multimodality: None,
                ..variety.mean
            },
            interval: None,
        });
        Ok(Evaluated {
            run: evaluation.run.clone(),
            report,
            json: to_value(&evaluation).expect("plain data"),
            drawn: column(
                Some(evaluation.step),
                &evaluation.drawn,
                evaluation.variety.as_ref(),
            ),
            real: column(None, &evaluation.real, none.as_ref()),
            remarks,
        })
    }))
}

fn column(
    step: Option<u64>,
    report: &Replicated<GoalReport>,
    variety: Option<&Replicated<VarietyReport>>,
) -> Column {
    let interval = report.interval.as_ref();
    let goals = group("goals", &report.mean.rows(), interval.map(GoalReport::rows));
    let variety = variety.map(|report| {
        let interval = report.interval.as_ref();
        group(
            "variety",
            &report.mean.rows(),
            interval.map(VarietyReport::rows),
        )
    });
    Column {
        facts: vec![("step", step)],
        groups: [goals].into_iter().chain(variety).collect(),
    }
}

/// A metric: its name, its value and its unit.
type Row = (&'static str, Option<f64>, &'static str);

fn group<const N: usize>(key: &'static str, means: &[Row; N], interval: Option<[Row; N]>) -> Group {
    let intervals = interval.map_or([None; N], |rows| rows.map(|(_, value, _)| value));
    let numbers = means.iter().zip(intervals);
    let numbers = numbers.map(|(&(name, value, unit), interval)| Number {
        name: name.to_string(),
        value,
        line: Some((
            format!("{name}{unit}"),
            value.map(|value| match interval {
                Some(interval) => format!("{value:.4} ±{interval:.4}"),
                None => format!("{value:.4}"),
            }),
        )),
    });
    Group {
        key,
        title: "",
        numbers: numbers.collect(),
    }
}
