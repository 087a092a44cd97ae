//! `kinegrad eval`

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_train::evaluation::{Evaluated, EvaluationRequest};
use kinegrad_train::sampling::Subject;
use kinegrad_train::systems::Systems;

use super::sample::{checkpoint, subject};
use crate::args::{CondName, EvalArguments};
use crate::comparison::Comparison;
use crate::failure::{Failure, UsageError};
use crate::progress::denoising_bar;

/// Evaluates each run, writes the reports and prints them.
pub fn run(systems: Systems<'_>, arguments: EvalArguments) -> Result<ExitCode, Failure> {
    let subjects: Vec<Subject> = arguments
        .runs
        .iter()
        .map(|run| subject(systems, run, &arguments.draw))
        .collect::<Result<_, _>>()?;
    must_compare(systems, &subjects)?;
    let request = request(&arguments)?;
    // Whatever is wrong with any run is said before the first one costs minutes.
    let mut evaluations = Vec::with_capacity(subjects.len());
    for subject in &subjects {
        let (system, _) = systems.of(&subject.config)?;
        evaluations.push(system.evaluate(subject, &request)?);
    }
    let folders: Vec<PathBuf> = subjects
        .iter()
        .map(|subject| match &arguments.out {
            Some(out) => out.clone(),
            None => run_folder(&subject.checkpoint).join("reports"),
        })
        .collect();
    folders.iter().try_for_each(|folder| make_folder(folder))?;

    let mut evaluated = Vec::with_capacity(subjects.len());
    for (subject, evaluate) in subjects.iter().zip(evaluations) {
        let bar = denoising_bar().with_prefix(format!("{}  ", subject.config.run.name));
        evaluated.push(evaluate(&mut |stage, done, all| {
            if !stage.is_empty() {
                bar.set_message(format!("{stage}  "));
            }
            bar.set_length(all as u64);
            bar.set_position(done as u64);
        })?);
        bar.finish_and_clear();
    }
    let all = Comparison::new(&arguments.runs, &evaluated);
    let mut written = Vec::new();
    match &arguments.out {
        Some(out) => written.extend(write(out, &evaluated[0], &all)?),
        None => {
            for (folder, alone) in folders.iter().zip(&evaluated) {
                let comparison = Comparison::new(&arguments.runs, std::slice::from_ref(alone));
                written.extend(write(folder, alone, &comparison)?);
            }
        }
    }
    if arguments.json {
        say!("{}", all.json());
    } else {
        say!("{}", all.table());
        for remark in evaluated.iter().flat_map(|each| &each.remarks) {
            say!("\n{remark}");
        }
        for path in written {
            say!("{}", path.display());
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Refuses runs that have no measure in common.
fn must_compare(systems: Systems<'_>, subjects: &[Subject]) -> Result<(), Failure> {
    let mut names = Vec::with_capacity(subjects.len());
    for subject in subjects {
        names.push(systems.of(&subject.config)?.0.name());
    }
    if names.windows(2).all(|pair| pair[0] == pair[1]) {
        return Ok(());
    }
    let message = format!("the runs are of several systems: {}", names.join(", "));
    let hint = "they have no measure in common: evaluate them apart";
    Err(UsageError::new(message, hint).into())
}

fn request(arguments: &EvalArguments) -> Result<EvaluationRequest, Failure> {
    let evaluator = [
        &arguments.evaluator,
        &arguments.evaluator_mean,
        &arguments.evaluator_std,
        &arguments.word_vectors,
    ];
    // The command line takes them together only.
    let evaluator = evaluator.map(|path| path.clone().unwrap_or_default());
    Ok(EvaluationRequest {
        source: arguments.source.clone(),
        seeds: arguments.seeds,
        items: arguments.phrases.or(arguments.goals),
        noise: arguments.cond.map(|cond| matches!(cond, CondName::Noise)),
        keyframes: arguments.keyframes,
        obstacles: arguments.obstacles,
        trajectory: arguments
            .trajectory_run
            .as_deref()
            .map(checkpoint)
            .transpose()?,
        evaluator: arguments.evaluator.is_some().then_some(evaluator),
        seed: arguments.seed,
    })
}

/// The run that a checkpoint belongs to; a checkpoint that was moved away stands for itself.
fn run_folder(checkpoint: &Path) -> &Path {
    let inside = checkpoint
        .parent()
        .filter(|folder| folder.ends_with("checkpoints"));
    inside.and_then(Path::parent).unwrap_or(checkpoint)
}

fn make_folder(folder: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(folder).map_err(|error| {
        let message = format!("cannot create the folder {}: {error}", folder.display());
        let hint = "give a folder that can be written with `--out DIR`";
        UsageError::new(message, hint).into()
    })
}

/// Writes the report in both forms and returns where.
fn write(
    folder: &Path,
    first: &Evaluated,
    comparison: &Comparison<'_>,
) -> Result<[PathBuf; 2], Failure> {
    let stem = first.report;
    let [json, csv] = ["json", "csv"].map(|ending| folder.join(format!("{stem}.{ending}")));
    for (path, text) in [(&json, comparison.json() + "\n"), (&csv, comparison.csv())] {
        // A crash between the two leaves the report that was there.
        let temporary = path.with_extension("partial");
        std::fs::write(&temporary, text)
            .and_then(|()| std::fs::rename(&temporary, path))
            .map_err(kinegrad_train::Error::io("write", path))?;
    }
    Ok([json, csv])
}
