//! `kinegrad train`

use std::fs;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use kinegrad_output::path_text;
use kinegrad_report::facts;
use kinegrad_settings::counted;
use kinegrad_train::checkpoint::Weights;
use kinegrad_train::config::EnvironmentSetting;
use kinegrad_train::config::environment::runs_dir;
use kinegrad_train::run::{self, Outcome, SAMPLES, TrainRequest, UNFINISHED_SAMPLES, remove};
use kinegrad_train::sampling::{self, Request};
use kinegrad_train::{Ending, Error, Systems};
use serde::Serialize;

use super::estimate;
use super::sample::{checkpoint, say_summary};
use crate::args::TrainArguments;
use crate::io::Files;
use crate::output;
use crate::progress::duration;
use crate::ranks::{agreed, guarded, process_group};
use crate::train_progress::TrainProgress;

/// Trains, then generates the samples of `sampling.count_at_end`.
pub fn run(systems: Systems<'_>, arguments: TrainArguments) -> Result<ExitCode, Error> {
    let target = arguments.target()?;
    let (json, dry_run) = (arguments.json, arguments.dry_run);
    let mut overrides = arguments.overrides;
    // With quotes, a name of digits stays a string.
    let set = |key: &str, value: String| format!("{key}={}", serde_json::Value::from(value));
    overrides.extend(arguments.name.map(|name| set("run.name", name)));
    overrides.extend(arguments.device.map(|device| set("run.device", device)));
    let request = TrainRequest {
        target,
        overrides,
        environment: EnvironmentSetting::all()?,
        runs_dir: match arguments.runs_dir {
            Some(folder) => folder,
            None => runs_dir()?.0,
        },
        dry_run,
    };
    let started = Instant::now();
    let group = process_group()?;
    let ranks = group.ranks();
    let mut progress = TrainProgress::new(systems);
    let outcome = guarded(ranks, || {
        run::train_distributed(systems, &request, &group, &mut progress)
    });
    progress.finish();
    let outcome = match agreed(&group, outcome)? {
        Ok(outcome) => outcome,
        Err(code) => return Ok(code),
    };
    if !group.writes() {
        // From here on Ctrl-C ends all processes.
        let stops = progress.end_training();
        let interrupted = outcome.ending == Some(Ending::Interrupted);
        if interrupted {
            group.barrier();
        }
        return Ok(ExitCode::from(if interrupted || stops { 130 } else { 0 }));
    }
    if let Some(estimate) = &outcome.plan {
        estimate::print(estimate, json);
        return Ok(ExitCode::SUCCESS);
    }
    let seconds = started.elapsed().as_secs_f64();
    if !json {
        summarise(&outcome, seconds);
    }
    let summary = |samples| {
        if json {
            output::json(&Summary::of(&outcome, seconds, samples));
        }
    };
    if outcome.ending == Some(Ending::Interrupted) {
        summary(0);
        group.barrier();
        return Ok(ExitCode::from(130));
    }
    if lacks_samples(&outcome) {
        if progress.end_training() {
            tell!("stopped before sampling; `--resume` writes the samples");
            summary(0);
            return Ok(ExitCode::from(130));
        }
        // The outcome keeps the run locked until the samples are written.
        let (count, step, remark) = write_final_samples(systems, &outcome)?;
        if !json {
            let folder = outcome.folder.join(SAMPLES);
            let samples = counted(count, "sample");
            say!("\n{samples} of step {step} in {}", folder.display());
            say_summary(remark);
        }
        summary(count);
        return Ok(ExitCode::SUCCESS);
    }
    summary(0);
    Ok(ExitCode::SUCCESS)
}

/// True if samples of the run's end are missing after an interruption or a removal.
fn lacks_samples(outcome: &Outcome) -> bool {
    let unfinished = outcome.folder.join(UNFINISHED_SAMPLES).exists();
    let owed = unfinished || !outcome.folder.join(SAMPLES).exists();
    owed && outcome.config.sampling.count_at_end > 0
}

/// Writes missing samples of a run's end to the run's folder. Prints nothing.
///
/// # Errors
/// If the samples cannot be generated or written.
pub fn sample_at_end(systems: Systems<'_>, outcome: &Outcome) -> Result<(), Error> {
    if lacks_samples(outcome) {
        write_final_samples(systems, outcome)?;
    }
    Ok(())
}

/// The summary as JSON.
#[derive(Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "path_text")]
    run: &'a Path,
    ended: &'static str,
    steps: u64,
    max_steps: u64,
    best_step: Option<u64>,
    best_val_loss: Option<f64>,
    seconds: f64,
    /// Number of samples at the end.
    samples: usize,
}

impl<'a> Summary<'a> {
    fn of(outcome: &'a Outcome, seconds: f64, samples: usize) -> Self {
        Self {
            run: &outcome.folder,
            ended: match outcome.ending {
                None => "finished_before",
                Some(Ending::Finished) => "finished",
                Some(Ending::EarlyStopped) => "stopped_early",
                Some(Ending::Interrupted) => "interrupted",
            },
            steps: outcome.step,
            max_steps: outcome.max_steps,
            best_step: outcome.progress.best_step,
            best_val_loss: outcome.progress.best_val_loss,
            seconds,
            samples,
        }
    }
}

fn summarise(outcome: &Outcome, seconds: f64) {
    let folder = outcome.folder.display();
    let ending = match outcome.ending {
        None => "finished before, nothing to do; `--set train.max_steps=N` extends it".to_string(),
        Some(Ending::Finished) => "finished".to_string(),
        Some(Ending::EarlyStopped) => {
            "stopped early: the validation loss no longer falls".to_string()
        }
        Some(Ending::Interrupted) => {
            format!("stopped; `kinegrad train --resume {folder}` continues")
        }
    };
    let (progress, time) = (&outcome.progress, duration(seconds));
    let best = progress.best_step.zip(progress.best_val_loss);
    let best = best.map(|(step, loss)| match step {
        0 => format!("{loss:.5} before training: no step was better, so the start is kept"),
        _ => format!("{loss:.5} at step {step}"),
    });
    let best = best.map(|best| ("best val_loss", best));
    let rows = [
        Some(("run", outcome.folder.display().to_string())),
        Some(("ended", ending)),
        Some(("steps", outcome.step.to_string())),
        best,
        Some(("time", format!("{time} in all, with preparation"))),
    ];
    show!("{}", facts(rows.into_iter().flatten()));
}

/// The number of samples at the end of training, the step of their checkpoint, and their summary.
type FinalSamples = (usize, u64, Option<sampling::Summary>);

/// Writes samples for the first held-out items to the run's folder, all or none.
fn write_final_samples(systems: Systems<'_>, outcome: &Outcome) -> Result<FinalSamples, Error> {
    let saved = checkpoint(&outcome.folder)?;
    let trained = systems.trained(saved, &[], Weights::Ema, None)?;
    let count = outcome.config.sampling.count_at_end;
    let request = Request::held_out(count, outcome.config.run.seed);
    let folder = outcome.folder.join(SAMPLES);
    let unfinished = outcome.folder.join(UNFINISHED_SAMPLES);
    remove(&unfinished)?;
    fs::create_dir(&unfinished).map_err(Error::io("create", &unfinished))?;
    let mut files = Files::silent(&unfinished);
    let summary = systems.sample(&trained, &request, &mut files)?;
    move_into(&unfinished, &folder)?;
    Ok((files.motions.len(), trained.saved.state.step, summary))
}

/// Moves a folder. Files move into an existing target folder and replace its files.
fn move_into(from: &Path, to: &Path) -> Result<(), Error> {
    if (to.exists() || to.is_symlink()) && !to.is_dir() {
        let to = to.display();
        return Err(Error::usage(
            format!("the samples cannot be written: {to} is not a folder"),
            "move it away, and `--resume` the run",
        ));
    }
    if !to.exists() {
        return fs::rename(from, to).map_err(Error::io("rename", from));
    }
    for entry in fs::read_dir(from).map_err(Error::io("list", from))? {
        let name = entry.map_err(Error::io("list", from))?.file_name();
        let target = to.join(&name);
        fs::rename(from.join(name), &target).map_err(Error::io("write", &target))?;
    }
    remove(from)
}
