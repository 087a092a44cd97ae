//! `kinegrad eval`

mod reports;
mod summary;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::rc::Rc;

use kinegrad_report::{Column, Section, columns_csv, columns_table};
use kinegrad_train::checkpoint::SavedCheckpoint;
use kinegrad_train::evaluation::{self, Evaluated, EvaluationRequest};
use kinegrad_train::run::{REPORTS, must_be_inside};
use kinegrad_train::{Error, ProcessGroup, Systems, TrainedModel, config};

use super::sample::{checkpoint, trained_for, while_it_is_trained};
use crate::args::EvalArguments;
use crate::output;
use crate::progress::Denoising;
use crate::ranks::{agreed, guarded, process_group};
use crate::runs::labels;
use reports::{Reports, Settings};

/// Header of the column of directions, the last one of tables.
pub const BETTER: &str = "better";

/// Evaluates each run, writes the reports and prints them.
pub fn run(systems: Systems<'_>, arguments: EvalArguments) -> Result<ExitCode, Error> {
    let arguments = arguments.with_quick();
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
    let settings = |trained: &[TrainedModel]| Settings::of(trained, &arguments);
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
        source: arguments.source.clone(),
        songs: arguments.songs.clone(),
        num_samples: arguments.num_samples,
        num_frames: arguments.num_frames,
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
    let stem = evaluations[0].report;
    // One folder for all runs, or one folder per run.
    let reports: Vec<Reports> = match &arguments.out {
        Some(out) => vec![Reports::together(
            out,
            stem,
            settings(&models).of_runs(runs),
        )],
        None => {
            let own = models.iter().zip(runs).map(|(trained, run)| {
                let folder = run_folder(trained.path());
                must_be_inside(folder, REPORTS)?;
                let settings = settings(std::slice::from_ref(trained)).of_checkpoint(run);
                Ok(Reports::named(&folder.join(REPORTS), stem, settings))
            });
            own.collect::<Result<_, Error>>()?
        }
    };
    let mut made = Ok(());
    if group.writes() {
        let mut reports = reports.iter();
        made = reports.try_for_each(|reports| reports.make(arguments.overwrite));
    }
    group.done(made)?;

    let mut evaluated = Vec::with_capacity(models.len());
    for (trained, prepared) in models.iter().zip(evaluations) {
        let bar = Denoising::of(&trained.config().run.name);
        evaluated.push((prepared.evaluate)(&mut |stage, done, all| {
            bar.show(stage, done, all);
            ControlFlow::Continue(())
        })?);
        bar.finish();
    }
    let each = evaluated.chunks(models.len() / reports.len());
    let each = reports.iter().zip(each);
    let each = each.filter(|_| group.writes());
    let written = each.map(|(reports, each)| {
        let mut columns = columns(runs, each, true);
        columns.push(directions(each));
        reports.write(each, &columns_csv(["samples", "measure"], &columns))
    });
    let written: Vec<String> = group.done(written.collect())?;
    if !group.writes() {
        return Ok(());
    }
    if arguments.json {
        let settings = match &reports[..] {
            [one] => one.settings.clone(),
            _ => settings(&models),
        };
        show!("{}", reports::json(&evaluated, &settings));
        return Ok(());
    }
    let (labels, width) = (labels(names(&evaluated), runs), output::width());
    for line in summary::verdict(&labels, &evaluated) {
        show!("{}", kinegrad_report::wrapped(&line, width));
    }
    if arguments.all {
        let columns = columns(runs, &evaluated, false);
        show!("\n{}", columns_table(&columns, width));
    } else {
        show!("{}", summary::table(&labels, &evaluated, width));
    }
    for remark in evaluated.iter().flat_map(|each| &each.remarks) {
        show!("{}", kinegrad_report::wrapped(remark, width));
    }
    for files in written {
        say!("{files}");
    }
    if !arguments.all {
        say!("all measures: --all");
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
    let options = (
        &request.source,
        &request.songs,
        [request.num_samples, request.num_frames],
        request.seed,
        request.audio_ablation,
    );
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

/// The runs' names.
fn names(all: &[Evaluated]) -> Vec<String> {
    all.iter().map(|each| each.run.clone()).collect()
}

/// A column for each run, and a column for real motion.
fn columns<'a>(paths: &[PathBuf], all: &'a [Evaluated], in_full: bool) -> Vec<Column<'a>> {
    let same = all.iter().all(|each| each.real == all[0].real);
    let column = |label: String, column: &'a evaluation::Column| Column {
        label,
        sections: sections(column, in_full),
    };
    let mut columns = Vec::new();
    for (label, each) in labels(names(all), paths).into_iter().zip(all) {
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

/// The column of the main measures' directions.
fn directions(all: &[Evaluated]) -> Column<'_> {
    let mut sections = sections(&all[0].samples, true);
    for (index, (_, cells)) in sections.iter_mut().enumerate() {
        cells.clear();
        // Runs differ in the guidance scales that measures are named by.
        let groups = all
            .iter()
            .filter_map(|each| each.samples.groups.get(index.checked_sub(1)?));
        for number in groups.flat_map(|group| &group.numbers) {
            let better = number.better.map(|better| better.name().to_owned());
            cells.extend(better.map(|better| (number.name.as_str(), Some(better))));
        }
    }
    Column {
        label: BETTER.into(),
        sections,
    }
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
