//! `kinegrad train`

use std::fs;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use kinegrad_report::facts;
use kinegrad_train::checkpoint::{State, Weights};
use kinegrad_train::run::{self, Outcome, SAMPLES, TrainRequest, UNFINISHED_SAMPLES, remove};
use kinegrad_train::sampling::{self, Conditions, Remark, Request};
use kinegrad_train::systems::Systems;
use kinegrad_train::{Ending, Error};

use super::sample::{Files, checkpoint, say_remark};
use crate::args::TrainArguments;
use crate::progress::{TrainProgress, duration};

/// Trains, then generates the samples of `sampling.count_at_end`.
pub fn run(systems: Systems<'_>, arguments: TrainArguments) -> Result<ExitCode, Error> {
    let mut overrides = arguments.overrides;
    for (key, value) in [
        ("run.name", arguments.name),
        ("run.device", arguments.device),
    ] {
        if let Some(value) = value {
            // Quoted, so that a name of digits stays a name.
            overrides.push(format!("{key}={}", serde_json::Value::from(value)));
        }
    }
    let config = match arguments.config {
        Some(config) => config,
        None => super::init::default_config()?,
    };
    let request = TrainRequest {
        config,
        overrides,
        runs_dir: arguments.runs_dir,
        resume: arguments.resume,
    };
    let started = Instant::now();
    let mut progress = TrainProgress::new(systems);
    let outcome = run::train(systems, &request, &mut progress);
    progress.finish();
    let outcome = outcome?;
    summarise(&outcome, started);
    if outcome.ending == Some(Ending::Interrupted) {
        return Ok(ExitCode::from(130));
    }
    if owes_samples(&outcome) {
        if progress.end_training() {
            tell!("stopped before the samples were drawn; `--resume` draws them");
            return Ok(ExitCode::from(130));
        }
        // The outcome holds the run's lock until they are.
        let drawn = draw_samples(systems, &outcome)?;
        say!(
            "\n{} samples of step {} in {}",
            drawn.count,
            drawn.step,
            outcome.folder.join(SAMPLES).display()
        );
        say_remark(drawn.remark);
    }
    Ok(ExitCode::SUCCESS)
}

/// Whether the samples of the run's end are still to be drawn: a process that ended before has left
/// them to this one, or a user has removed them.
fn owes_samples(outcome: &Outcome) -> bool {
    let unfinished = outcome.folder.join(UNFINISHED_SAMPLES).exists();
    let owed = unfinished || !outcome.folder.join(SAMPLES).exists();
    owed && outcome.config.sampling.count_at_end > 0
}

/// Draws the samples of a run's end into its folder, if they are owed, without printing anything.
///
/// # Errors
/// If they cannot be drawn or written.
pub fn draw_samples_at_end(systems: Systems<'_>, outcome: &Outcome) -> Result<(), Error> {
    if owes_samples(outcome) {
        draw_samples(systems, outcome)?;
    }
    Ok(())
}

fn summarise(outcome: &Outcome, started: Instant) {
    let ending = match outcome.ending {
        None => "finished before, nothing to do",
        Some(Ending::Finished) => "finished",
        Some(Ending::EarlyStopped) => "stopped early: the validation loss no longer falls",
        Some(Ending::Interrupted) => "stopped; `--resume` continues",
    };
    let progress = &outcome.progress;
    let best = progress.best_step.zip(progress.best_val_loss);
    let best = best.map(|(step, loss)| ("best val_loss", format!("{loss:.5} at step {step}")));
    let rows = [
        Some(("run", outcome.folder.display().to_string())),
        Some(("ended", ending.to_string())),
        Some(("steps", outcome.step.to_string())),
        best,
        Some(("time", duration(started.elapsed().as_secs_f64()))),
    ];
    say!("{}", facts(rows.into_iter().flatten()));
}

/// The samples of a run's end.
struct SamplesAtEnd {
    count: usize,
    /// Step of the weights that they are drawn from.
    step: u64,
    remark: Option<Remark>,
}

/// Writes samples for the first held-out items to the run's folder: all of them or, if this process
/// ends before they are drawn, none.
fn draw_samples(systems: Systems<'_>, outcome: &Outcome) -> Result<SamplesAtEnd, Error> {
    let path = checkpoint(&outcome.folder)?;
    let subject = systems.trained(&path, &[], Weights::Ema, None)?;
    let request = Request {
        conditions: Conditions {
            held_out: Some(outcome.config.sampling.count_at_end),
            ..Conditions::default()
        },
        count: 1,
        frames: None,
        seed: outcome.config.run.seed,
    };
    let folder = outcome.folder.join(SAMPLES);
    let unfinished = outcome.folder.join(UNFINISHED_SAMPLES);
    remove(&unfinished)?;
    fs::create_dir(&unfinished).map_err(Error::io("create", &unfinished))?;
    let mut files = Files::silent(&unfinished);
    let remark = sampling::sample(systems, &subject, &request, &mut files)?;
    move_into(&unfinished, &folder)?;
    Ok(SamplesAtEnd {
        count: files.written(),
        step: State::read(&path)?.step,
        remark,
    })
}

/// Moves a folder, or what it holds into one that is there, over files of the same names.
fn move_into(from: &Path, to: &Path) -> Result<(), Error> {
    if (to.exists() || to.is_symlink()) && !to.is_dir() {
        return Err(Error::usage(
            format!(
                "the samples cannot be written: {} is not a folder",
                to.display()
            ),
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
