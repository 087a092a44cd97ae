//! `kinegrad train`

use std::process::ExitCode;
use std::time::Instant;

use kinegrad_train::Ending;
use kinegrad_train::checkpoint::{State, Weights};
use kinegrad_train::run::{self, Outcome, TrainRequest};
use kinegrad_train::sampling::{Conditions, Request, Subject};
use kinegrad_train::systems::Systems;

use super::sample::{Files, checkpoint, say_remark};
use crate::args::TrainArguments;
use crate::failure::Failure;
use crate::output::table;
use crate::progress::{TrainProgress, duration};

/// Trains, then draws the samples that the config asks for.
pub fn run(systems: Systems<'_>, arguments: TrainArguments) -> Result<ExitCode, Failure> {
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
    let request = TrainRequest {
        config: arguments.config,
        overrides,
        runs_dir: arguments.runs_dir,
        resume: arguments.resume,
    };
    let started = Instant::now();
    let mut progress = TrainProgress::new();
    let outcome = run::train(systems, &request, &mut progress);
    progress.finish();
    let outcome = outcome?;
    summarise(&outcome, started);
    if outcome.ending == Some(Ending::Interrupted) {
        return Ok(ExitCode::from(130));
    }
    if outcome.ending.is_some() && outcome.config.sampling.count_at_end > 0 {
        draw_samples(systems, &outcome)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn summarise(outcome: &Outcome, started: Instant) {
    let ending = match outcome.ending {
        None => "finished before, nothing to do",
        Some(Ending::Finished) => "finished",
        Some(Ending::EarlyStopped) => "stopped early: the validation loss no longer falls",
        Some(Ending::Interrupted) => "stopped; `--resume` continues",
    };
    let mut rows = vec![
        vec!["run".to_string(), outcome.folder.display().to_string()],
        vec!["ended".to_string(), ending.to_string()],
        vec!["steps".to_string(), outcome.step.to_string()],
    ];
    if let (Some(step), Some(loss)) = (outcome.progress.best_step, outcome.progress.best_val_loss) {
        rows.push(vec![
            "best val_loss".to_string(),
            format!("{loss:.5} at step {step}"),
        ]);
    }
    rows.push(vec![
        "time".to_string(),
        duration(started.elapsed().as_secs_f64()),
    ]);
    say!("{}", table(rows));
}

/// Draws samples for the first held-out items into the run's folder.
fn draw_samples(systems: Systems<'_>, outcome: &Outcome) -> Result<(), Failure> {
    let path = checkpoint(&outcome.folder)?;
    let subject = Subject::open(systems, &path, &[], Weights::Ema, None)?;
    let request = Request {
        conditions: Conditions {
            held_out: Some(outcome.config.sampling.count_at_end),
            ..Conditions::default()
        },
        count: 1,
        frames: None,
        seed: outcome.config.run.seed,
    };
    let folder = outcome.folder.join("samples");
    let (system, _) = systems.of(&subject.config)?;
    let mut files = Files::silent(&folder);
    let remark = system.sample(&subject, &request, &mut files)?;
    say!(
        "\n{} samples of step {} in {}",
        files.written(),
        State::read(&path)?.step,
        folder.display()
    );
    say_remark(remark);
    Ok(())
}
