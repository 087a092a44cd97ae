//! `kinegrad runs`

use std::path::Path;
use std::process::ExitCode;
use std::time::{SystemTime, UNIX_EPOCH};

use kinegrad_report::table;
use kinegrad_train::config::environment::runs_dir;
use kinegrad_train::memory::size;
use kinegrad_train::{Error, Systems};
use serde_json::{Value, json};

use crate::args::{RUNS, RunsArguments};
use crate::output;
use crate::progress::duration;
use crate::runs::{Run, find, folder_name};

/// Columns of the list.
const HEADER: [&str; 7] = [
    "run",
    "recipe",
    "state",
    "step",
    "best val_loss",
    "size",
    "age",
];

/// Lists the runs in a folder.
pub fn run(systems: Systems<'_>, arguments: RunsArguments) -> Result<ExitCode, Error> {
    let RunsArguments { folder, json } = arguments;
    let folder = match folder {
        Some(folder) => folder,
        None => runs_dir()?.0,
    };
    // The first training makes the folder `runs`.
    if !folder.is_dir() && folder != Path::new(RUNS) {
        let message = format!("there is no folder {}", folder.display());
        let hint = "give the folder that contains the runs; without one, `kinegrad runs` lists those in `runs`";
        return Err(Error::usage(message, hint));
    }
    let found = find(&folder);
    let runs: Vec<Run> = found.iter().map(|path| Run::read(systems, path)).collect();
    if json {
        let runs: Vec<Value> = runs.iter().map(|run| object(run, &folder)).collect();
        output::json(&json!({ "runs": runs }));
        return Ok(ExitCode::SUCCESS);
    }
    if runs.is_empty() {
        say!("no runs in {}", folder.display());
        return Ok(ExitCode::SUCCESS);
    }
    let rows = runs.iter().map(|run| row(run, &folder));
    show!("{}", table(HEADER, rows));
    for run in &runs {
        if let Some(problem) = &run.problem {
            tell!("warning: {}: {problem}", name(run, &folder));
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The run's path relative to the folder; the folder's name if the folder is the run.
fn name(run: &Run, folder: &Path) -> String {
    let below = run.folder.strip_prefix(folder).unwrap_or(&run.folder);
    match below.as_os_str().is_empty() {
        true => folder_name(folder),
        false => below.display().to_string(),
    }
}

fn row(run: &Run, folder: &Path) -> [String; 7] {
    let recipe = run.system.zip(run.recipe());
    let recipe = recipe.map(|(system, recipe)| format!("{system}/{recipe}"));
    let best = run.best.as_ref();
    let best = best.map(|best| match best.step {
        0 => format!("{:.5} at the start", best.val_loss),
        step => format!("{:.5} at {step}", best.val_loss),
    });
    let age = run.modified.and_then(|time| time.elapsed().ok());
    let or_missing = |text: Option<String>| text.unwrap_or("-".to_string());
    [
        name(run, folder),
        or_missing(recipe),
        run.status.name().into(),
        run.steps(|step| step.to_string()),
        or_missing(best),
        size(run.bytes),
        or_missing(age.map(|age| age_of(age.as_secs_f64()))),
    ]
}

/// A duration; long durations are in days.
fn age_of(seconds: f64) -> String {
    let days = seconds / 86_400.0;
    match days < 2.0 {
        true => duration(seconds),
        false => format!("{days:.0}d"),
    }
}

fn object(run: &Run, folder: &Path) -> Value {
    let seconds = |time: SystemTime| Some(time.duration_since(UNIX_EPOCH).ok()?.as_secs_f64());
    json!({
        "name": name(run, folder),
        "path": run.folder.display().to_string(),
        "system": run.system,
        "recipe": run.recipe(),
        "state": run.status.name(),
        "problem": run.problem,
        "step": run.step,
        "max_steps": run.max_steps(),
        "best_step": run.best.as_ref().map(|best| best.step),
        "best_val_loss": run.best.as_ref().map(|best| best.val_loss),
        "bytes": run.bytes,
        "modified": run.modified.and_then(seconds),
    })
}
