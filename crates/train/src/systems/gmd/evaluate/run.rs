//! The evaluation of a trained model on goals taken from held-out clips.

use kinegrad_data::ValidationSplit;
use kinegrad_data::humanml::labels_of;
use kinegrad_motion::metrics::GoalReport;
use serde_json::to_value;

use super::super::networks::text_input;
use super::{GoalSettings, GoalTask, Models, Replicated, VarietyReport, evaluate_goals};
use crate::TrainedModel;
use crate::clips::captions::must_know_texts;
use crate::clips::{dataset_or, with_held_out};
use crate::error::Error;
use crate::evaluation::{Column, Evaluate, Evaluated, EvaluationRequest, Group, Number};
use crate::systems::gmd::generate::drawn_frames;
use crate::systems::gmd::networks::footprint;
use crate::systems::gmd::sample::trajectory_model;
use crate::systems::gmd::{ClipGenerator, EvaluationSplit, GmdConfig};

/// An evaluation of position control.
///
/// # Errors
/// If the request does not apply, or nothing is held out.
pub fn prepare<'a>(
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
) -> Result<Evaluate<'a>, Error> {
    request.refuse(
        &["--audio-ablation"],
        trained.path(),
        "a run on clips",
        "only models of phrases hear music",
    )?;
    let asked = &trained.config().own::<GmdConfig>().evaluation;
    let mut data = dataset_or(&trained.config().data, request.source.as_deref());
    if asked.split == EvaluationSplit::Test {
        data.humanml3d.validation_list = data.humanml3d.test_list.clone();
        data.validation = ValidationSplit::default();
    }
    let dataset = with_held_out(
        &data,
        trained.path(),
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
            trained.path().display()
        ));
    }
    must_know_texts(&text_input(trained.config()), &held_out)?;
    let frames = drawn_frames(trained.config(), data.target_frames);
    let repeated = asked.variety_clips.min(held_out.len()) * asked.variety_repeats;
    let at_once = asked.batch_size.min(held_out.len().max(repeated));
    let networks = footprint(trained.config(), frames)?;
    let needed = networks.of_sampling(at_once, true, trained.on_host);
    let hint = "draw for fewer goals together: `evaluation.batch_size`";
    request.must_fit(needed, hint)?;
    let trajectory = request.trajectory.clone();
    let trajectory = trajectory
        .map(|saved| trajectory_model(trained, saved))
        .transpose()?;
    let together = request.together.clone();
    let evaluator = request.evaluator.clone();
    if let Some(evaluator) = &evaluator {
        evaluator.must_take(held_out[0].features.layout())?;
    }
    let labels = labels_of(&data)?.unwrap_or_default();
    let settings = GoalSettings {
        task: GoalTask {
            keyframes: asked.keyframes,
            keyframe_placement: asked.keyframe_placement,
            obstacles: asked.obstacles,
            margin: asked.margin,
            frames: data.target_frames,
        },
        sampling: trained.config().sampling.clone(),
        steering: trained.config().own::<GmdConfig>().steering.clone(),
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
        let generator = ClipGenerator::load(trained)?;
        let trajectory = trajectory.as_ref().map(ClipGenerator::load).transpose()?;
        let models = Models {
            generator: &generator,
            trajectory: trajectory.as_ref(),
            evaluator: evaluator.as_deref(),
            labels: &labels,
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
