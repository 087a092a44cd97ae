//! `kinegrad eval`

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::rc::Rc;

use kinegrad_report::{Column, Section, columns_csv, columns_table};
use kinegrad_train::checkpoint::SavedCheckpoint;
use kinegrad_train::evaluation::{self, Evaluated, EvaluationRequest};
use kinegrad_train::{Error, ProcessGroup, Systems, TrainedModel, config};
use serde_json::json;

use super::sample::{checkpoint, trained_for, while_it_is_trained};
use crate::args::EvalArguments;
use crate::progress::Denoising;
use crate::ranks::{agreed, guarded, process_group};

/// Evaluates each run, writes the reports and prints them.
pub fn run(systems: Systems<'_>, arguments: EvalArguments) -> Result<ExitCode, Error> {
    let group = process_group()?;
    let ranks = group.ranks();
    let outcome = match ranks.size() {
        1 => while_it_is_trained(|| evaluate(systems, arguments.clone(), &group)),
        // Ranks cannot read a checkpoint again.
        _ => guarded(ranks, || {
            group.report_failure(evaluate(systems, arguments, &group))
        }),
    };
    Ok(match agreed(&group, outcome)? {
        Ok(()) => ExitCode::SUCCESS,
        Err(code) => code,
    })
}

fn evaluate(
    systems: Systems<'_>,
    arguments: EvalArguments,
    group: &Rc<ProcessGroup>,
) -> Result<(), Error> {
    let runs = &arguments.runs;
    let scales = arguments.sampler.guidance_scale.len();
    if scales > 1 && !arguments.audio_ablation {
        let message = format!("`--guidance-scale` names {scales} scales");
        let hint = "give one, or compare them with `--audio-ablation`";
        return Err(Error::usage(message, hint));
    }
    let open = |run: &PathBuf| trained_for(systems, run, &arguments.sampler, group);
    let models = runs.iter().map(open).collect::<Result<Vec<_>, _>>()?;
    must_compare(systems, &models)?;
    let trajectory = arguments.trajectory_run.as_deref().map(checkpoint);
    let request = EvaluationRequest {
        source: arguments.source,
        trajectory: trajectory.transpose()?,
        evaluator: None,
        seed: arguments.seed,
        audio_ablation: arguments.audio_ablation,
        group: group.clone(),
    };
    must_evaluate_the_same(group, &models, &request)?;
    // Every run is checked before the first evaluation.
    let evaluations = models
        .iter()
        .map(|trained| systems.evaluate(trained, &request));
    let evaluations = evaluations.collect::<Result<Vec<_>, _>>()?;
    let own = |trained: &TrainedModel| run_folder(trained.path()).join("reports");
    let folders: Vec<PathBuf> = match arguments.out {
        Some(out) => vec![out],
        None => models.iter().map(own).collect(),
    };
    if group.writes() {
        let mut folders = folders.iter();
        folders.try_for_each(|folder| crate::folder::make(folder))?;
    }

    let mut evaluated = Vec::with_capacity(models.len());
    for (trained, evaluate) in models.iter().zip(evaluations) {
        let bar = Denoising::of(&trained.config().run.name);
        evaluated.push(evaluate(&mut |stage, done, all| {
            bar.show(stage, done, all);
            ControlFlow::Continue(())
        })?);
        bar.finish();
    }
    // One folder for all runs, or one folder per run.
    let each = evaluated.chunks(models.len() / folders.len());
    let each = folders.iter().zip(each);
    let each = each.filter(|_| group.writes());
    let written = each.map(|(folder, each)| write(folder, runs, each));
    let written: Vec<[PathBuf; 2]> = group.done(written.collect())?;
    if !group.writes() {
        return Ok(());
    }
    if arguments.json {
        say!("{}", report(&evaluated));
    } else {
        say!("{}", columns_table(&columns(runs, &evaluated, false)));
        for remark in evaluated.iter().flat_map(|each| &each.remarks) {
            say!("\n{remark}");
        }
        for path in written.concat() {
            say!("{}", path.display());
        }
    }
    Ok(())
}

/// Rejects processes with different evaluations. Collective.
fn must_evaluate_the_same(
    group: &ProcessGroup,
    models: &[TrainedModel],
    request: &EvaluationRequest,
) -> Result<(), Error> {
    let weights = |saved: &SavedCheckpoint| format!("{:?}", saved.state.checksums);
    let run = |trained: &TrainedModel| {
        let config = config::to_toml(trained.config());
        format!("{:?} {} {config}", trained.weights, weights(&trained.saved))
    };
    let runs: String = models.iter().map(run).collect();
    let trajectory = request.trajectory.as_ref().map(weights);
    group.done(Ok(()))?;
    let options = (&request.source, request.seed, request.audio_ablation);
    group.must_compute_alike()?;
    group.must_match(&[
        ("run", &runs),
        ("trajectory run", &trajectory.unwrap_or_default()),
        ("command", &format!("{options:?}")),
    ])
}

/// Rejects runs without common measures.
fn must_compare(systems: Systems<'_>, models: &[TrainedModel]) -> Result<(), Error> {
    let systems = models.iter().map(|trained| systems.of(trained.config()));
    let names = systems.map(|found| Ok(found?.0.name()));
    let names = names.collect::<Result<Vec<_>, Error>>()?;
    if names.windows(2).all(|pair| pair[0] == pair[1]) {
        return Ok(());
    }
    let message = format!("the runs are of several systems: {}", names.join(", "));
    let hint = "they have no measure in common: evaluate them apart";
    Err(Error::usage(message, hint))
}

/// The folder of a checkpoint's run; the checkpoint's own folder if the checkpoint was moved.
fn run_folder(checkpoint: &Path) -> &Path {
    let inside = checkpoint
        .parent()
        .filter(|folder| folder.ends_with("checkpoints"));
    inside.and_then(Path::parent).unwrap_or(checkpoint)
}

/// Writes the report as JSON and CSV, and returns the files.
fn write(folder: &Path, runs: &[PathBuf], all: &[Evaluated]) -> Result<[PathBuf; 2], Error> {
    let stem = all[0].report;
    let [json, csv] = ["json", "csv"].map(|ending| folder.join(format!("{stem}.{ending}")));
    let columns = columns(runs, all, true);
    let texts = [
        report(all) + "\n",
        columns_csv(["samples", "measure"], &columns),
    ];
    for (path, text) in [&json, &csv].into_iter().zip(texts) {
        // After a crash, the former report remains.
        let temporary = path.with_extension("partial");
        std::fs::write(&temporary, text)
            .and_then(|()| std::fs::rename(&temporary, path))
            .map_err(Error::io("write", path))?;
    }
    Ok([json, csv])
}

/// All numbers as JSON.
fn report(all: &[Evaluated]) -> String {
    let all: Vec<_> = all.iter().map(|each| &each.json).collect();
    serde_json::to_string_pretty(&json!({ "evaluations": all })).expect("plain data")
}

/// A column for each run, and a column for real motion. Run columns have the runs' names or, if two
/// names are equal, the runs' `paths`.
fn columns<'a>(paths: &[PathBuf], all: &'a [Evaluated], in_full: bool) -> Vec<Column<'a>> {
    let mut names: Vec<&str> = all.iter().map(|each| each.run.as_str()).collect();
    names.sort_unstable();
    let by_path = names.windows(2).any(|pair| pair[0] == pair[1]);
    let same = all.iter().all(|each| each.real == all[0].real);
    let column = |label: String, column: &'a evaluation::Column| Column {
        label,
        sections: sections(column, in_full),
    };
    let mut columns = Vec::new();
    for (path, each) in paths.iter().zip(all) {
        let label = match by_path {
            true => path.display().to_string(),
            false => each.run.clone(),
        };
        // Real motion differs between the runs.
        let real = (!same).then(|| column(format!("real ({label})"), &each.real));
        columns.push(column(label, &each.samples));
        columns.extend(real);
    }
    if same {
        columns.push(column("real".into(), &all[0].real));
    }
    columns
}

/// Facts, then groups of measures: all numbers in full, or the main numbers as shown in tables.
fn sections(column: &evaluation::Column, in_full: bool) -> Vec<Section<'_>> {
    let facts = column.facts.iter();
    let facts = facts.map(|(name, count)| (*name, count.map(|count| count.to_string())));
    let groups = column.groups.iter().map(|group| {
        let numbers = group.numbers.iter();
        if in_full {
            let full = |value: f64| value.to_string();
            let cells = numbers.map(|number| (number.name.as_str(), number.value.map(full)));
            return (group.key, cells.collect());
        }
        let lines = numbers.filter_map(|number| number.line.as_ref());
        let cells = lines.map(|(title, shown)| (title.as_str(), shown.clone()));
        (group.title, cells.collect())
    });
    [("", facts.collect())].into_iter().chain(groups).collect()
}
