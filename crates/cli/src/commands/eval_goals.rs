//! `kinegrad eval` of models of clips.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_data::humanml::ClipDataset;
use kinegrad_data::{DataKind, ValidationSplit};
use kinegrad_motion::metrics::GoalReport;
use kinegrad_train::checkpoint::State;
use kinegrad_train::systems::gmd::ClipGenerator;
use kinegrad_train::device;
use kinegrad_train::systems::BUILT_IN;
use kinegrad_train::systems::gmd::evaluate::{
    EvaluatorFiles, GoalEvaluation, GoalSettings, GoalTask, TextMotion, evaluate_goals,
};
use kinegrad_train::checkpoint::resolve_checkpoint;

use super::clips::{trajectory_checkpoint, weights};
use super::eval::{make_folder, run_folder};
use super::sample::{sampling_of, scale, steps};
use crate::args::EvalArguments;
use crate::failure::{Failure, UsageError};
use crate::output::table;
use crate::progress::{denoising_bar, on_stage};

/// Whether the runs are on clips.
///
/// # Errors
/// If one is not there, or only some of them are.
pub fn are_of_clips(runs: &[PathBuf]) -> Result<bool, Failure> {
    let mut kinds = Vec::with_capacity(runs.len());
    for run in runs {
        let checkpoint = resolve_checkpoint(run, |_| {})?;
        let config = State::read(&checkpoint)?.config;
        kinds.push(BUILT_IN.of(&config)?.0.name() == "gmd");
    }
    let clips = kinds.first() == Some(&true);
    if kinds.iter().any(|&kind| kind != clips) {
        let message = "some runs are on phrases, others on clips of joint features";
        let hint = "they have no measure in common: evaluate them apart";
        return Err(UsageError::new(message, hint).into());
    }
    Ok(clips)
}

/// Leads each run to the same goals, writes the reports and prints them.
pub fn run(arguments: &EvalArguments) -> Result<ExitCode, Failure> {
    refuse_phrases(arguments)?;
    if arguments.goals == 0 {
        return Err(UsageError::new("`--goals` is 0", "ask for at least one goal").into());
    }
    let trajectory = arguments.trajectory_run.as_deref();
    let trajectory = trajectory.map(trajectory_checkpoint).transpose()?;
    let evaluator = match (&arguments.evaluator, &arguments.evaluator_mean) {
        (Some(weights), Some(mean)) => Some(TextMotion::read(&EvaluatorFiles {
            weights: weights.clone(),
            mean: mean.clone(),
            std: arguments.evaluator_std.clone().unwrap_or_default(),
            word_vectors: arguments.word_vectors.clone().unwrap_or_default(),
        })?),
        _ => None,
    };
    let (mut evaluations, mut written) = (Vec::new(), Vec::new());
    for run in &arguments.runs {
        let (folder, evaluation) =
            evaluate(run, trajectory.as_deref(), evaluator.as_ref(), arguments)?;
        make_folder(&folder)?;
        let path = folder.join("eval-goals.json");
        let text = serde_json::to_string_pretty(&evaluation).expect("plain data") + "\n";
        // A crash midway leaves the report that was there.
        let temporary = path.with_extension("partial");
        std::fs::write(&temporary, text)
            .and_then(|()| std::fs::rename(&temporary, &path))
            .map_err(kinegrad_train::Error::io("write", &path))?;
        evaluations.push(evaluation);
        written.push(path);
    }
    if arguments.json {
        let text = serde_json::to_string_pretty(&evaluations).expect("plain data");
        say!("{text}");
    } else {
        say!("{}", comparison(&evaluations));
        for evaluation in &evaluations {
            if let Some(reports) = &evaluation.text_motion {
                say!("\n{}: {}", evaluation.run, reports.drawn);
                say!("\nheld out: {}", reports.real);
            }
        }
        for path in written {
            say!("{}", path.display());
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn refuse_phrases(arguments: &EvalArguments) -> Result<(), UsageError> {
    let given = [
        ("--seeds", arguments.seeds.is_some()),
        ("--phrases", arguments.phrases.is_some()),
        ("--cond", arguments.cond.is_some()),
    ];
    match given.into_iter().find(|(_, given)| *given) {
        Some((name, _)) => Err(UsageError::new(
            format!("`{name}` with runs on clips of joint features"),
            "they are measured on goals: `--goals`, `--keyframes`, `--obstacles`",
        )),
        None => Ok(()),
    }
}

fn evaluate(
    run: &Path,
    trajectory: Option<&Path>,
    evaluator: Option<&TextMotion>,
    arguments: &EvalArguments,
) -> Result<(PathBuf, GoalEvaluation), Failure> {
    let checkpoint = resolve_checkpoint(run, |damaged| tell!("warning: {damaged}"))?;
    let given = [arguments.steps.map(steps), arguments.guidance_scale.map(scale)];
    let config = sampling_of(&checkpoint, &arguments.overrides, given)?;
    let mut data = config.data.clone();
    if let Some(source) = &arguments.source {
        data.kind = DataKind::Humanml3d;
        data.source = Some(source.clone());
        // The dataset's own lists say what is held out.
        data.validation = ValidationSplit::default();
    }
    let dataset = ClipDataset::open(&data)?;
    if dataset.validation.is_empty() {
        let message = format!("no clip is held out for {}", run.display());
        let hint = "goals are taken from held-out clips: give a dataset that holds out some with \
                    `--source URI`";
        return Err(UsageError::new(message, hint).into());
    }
    let held_out = (0..dataset.validation.len().min(arguments.goals))
        .map(|position| dataset.validation.get(position))
        .collect::<Result<Vec<_>, _>>()?;
    if held_out.len() < arguments.goals {
        tell!(
            "note: {} clips are held out for {}, fewer than `--goals`",
            held_out.len(),
            run.display()
        );
    }
    let weights = weights(arguments.no_ema);
    let (device, _) = device::open(arguments.device.as_deref().unwrap_or(&config.run.device))?;
    let generator = ClipGenerator::load(&checkpoint, weights, &device)?;
    let trajectory = match trajectory {
        Some(checkpoint) => Some(ClipGenerator::load(checkpoint, weights, &device)?),
        None => None,
    };
    let settings = GoalSettings {
        task: GoalTask {
            keyframes: arguments.keyframes,
            obstacles: arguments.obstacles,
            frames: data.target_frames,
        },
        sampling: config.sampling.clone(),
        seed: arguments.seed,
    };
    let bar = denoising_bar().with_prefix(format!("{}  ", config.run.name));
    let evaluation = evaluate_goals(
        &generator,
        trajectory.as_ref(),
        &held_out,
        &settings,
        evaluator,
        &mut on_stage(&bar),
    )?;
    bar.finish_and_clear();
    let folder = match &arguments.out {
        Some(out) => out.join(&config.run.name),
        None => run_folder(&checkpoint).join("reports"),
    };
    Ok((folder, evaluation))
}

/// One row a metric, one column a run, the held-out clips last.
fn comparison(evaluations: &[GoalEvaluation]) -> String {
    let reports: Vec<(&str, &GoalReport)> = evaluations
        .iter()
        .map(|evaluation| (evaluation.run.as_str(), &evaluation.drawn))
        .chain(evaluations.first().map(|first| ("held out", &first.real)))
        .collect();
    let header = std::iter::once(String::new());
    let header = header.chain(reports.iter().map(|(name, _)| (*name).to_string()));
    let rows = (0..reports[0].1.rows().len()).filter_map(|row| {
        let (name, _, unit) = reports[0].1.rows()[row];
        let values = reports.iter().map(|(_, report)| report.rows()[row].1);
        if values.clone().all(|value| value.is_none()) {
            return None;
        }
        let shown = values.map(|value| match value {
            Some(value) => format!("{value:.4}"),
            None => "-".to_string(),
        });
        Some(
            std::iter::once(format!("{name}{unit}"))
                .chain(shown)
                .collect(),
        )
    });
    table(std::iter::once(header.collect()).chain(rows))
}
