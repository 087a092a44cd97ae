//! `kinegrad report`

mod comparison;
pub mod curves;
mod evaluation;
mod facts;
mod previews;
mod samples;
pub mod terms;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_data::file::{is_inside, read_text};
use kinegrad_report::page::{Block, Cell, Page, Section, Tone, html};
use kinegrad_train::telemetry::{Record, read_environments, read_metrics};
use kinegrad_train::{Error, Systems, config};

use crate::args::ReportArguments;
use crate::folder;
use crate::io::files_in;
use crate::runs::{Run, RunStatus, folder_name, is_run};

/// Writes a page about a run, or a comparison of several.
pub fn run(systems: Systems<'_>, arguments: ReportArguments) -> Result<ExitCode, Error> {
    let ReportArguments { runs: folders, out } = arguments;
    let mut runs = Vec::new();
    for folder in &folders {
        let run = Run::read(systems, folder);
        let stages = stages(systems, &run);
        if !is_run(folder) && stages.is_empty() {
            return Err(Error::usage(
                format!("{} is not a run", folder.display()),
                "give a run's folder, such as runs/quickstart; `kinegrad runs` lists them",
            ));
        }
        runs.push((run, stages));
    }
    let first = &folders[0];
    let (page, beside) = match &runs[..] {
        [(run, stages)] => (page(systems, run, stages), first.join("report.html")),
        _ => {
            let runs: Vec<Run> = runs.into_iter().map(|(run, _)| run).collect();
            let page = comparison::page(&runs);
            (page, first.with_file_name("comparison.html"))
        }
    };
    let out = out.unwrap_or(beside);
    write(&out, &html(&page))?;
    say!("{}", out.display());
    Ok(ExitCode::SUCCESS)
}

/// Writes the page.
fn write(out: &Path, text: &str) -> Result<(), Error> {
    if out.is_dir() {
        let message = format!("`--out {}` is a folder", out.display());
        let file = out.join("report.html");
        let hint = format!("for a file in it: `--out {}`", file.display());
        return Err(Error::usage(message, hint));
    }
    folder::make_for(out)?;
    kinegrad_output::write(out, text.as_bytes()).map_err(|error| {
        let message = format!("cannot write {}: {error}", out.display());
        Error::usage(message, "choose another `--out`")
    })
}

/// The stages of a fine-tuning, in its folder.
fn stages(systems: Systems<'_>, run: &Run) -> Vec<Run> {
    // A run without a config may have stages of any system.
    let all = systems.0.iter().flat_map(|system| system.stages());
    let names: Vec<&str> = match run.config {
        None if run.stages.is_empty() => all.copied().collect(),
        _ => run.stages.to_vec(),
    };
    let folders = names.iter().map(|name| run.folder.join(name));
    let started = folders.filter(|folder| is_run(folder) && is_own(&run.folder, folder));
    started.map(|folder| Run::read(systems, &folder)).collect()
}

fn page(systems: Systems<'_>, run: &Run, stages: &[Run]) -> Page {
    let records = records(run);
    let environments = read_environments(&run.folder);
    let last = environments.last();
    let mut overview = Section::new("Training");
    overview.add(Block::Warning(run.problem.clone().unwrap_or_default()));
    if records.is_empty() {
        let text = "There are no metrics: this run was not trained here.";
        overview.add(Block::Text(text.into()));
    }
    overview.add(Block::Charts(curves::charts(&[("", &records)])));
    let mut sections = vec![overview];
    let samples = samples::section(systems, run);
    if samples.blocks.is_empty() {
        sections.push(previews::section(run));
    }
    let name = folder_name(&run.folder);
    sections.extend([
        samples,
        evaluation::section(std::slice::from_ref(run), &[name]),
    ]);
    sections.extend(stages.iter().map(stage_section));
    let mut machine = Section::new("Hardware and versions");
    machine.add(Block::Facts(facts::machine(run, last)));
    if environments.len() > 1 {
        machine.add(Block::Heading("Starts".into()));
        machine.add(Block::Table(facts::starts(&environments)));
    }
    let mut data = Section::new("Data");
    data.add(Block::Facts(facts::data(run, last)));
    let mut files = Section::new("Checkpoints and files");
    files.add(Block::Table(facts::checkpoints(run)));
    files.add(Block::Facts(facts::files(run)));
    sections.extend([machine, data, files, configuration(run)]);
    Page {
        title: folder_name(&run.folder),
        subtitle: subtitle(run),
        status: status(run, stages),
        highlights: facts::highlights(run, &records, last),
        sections,
    }
}

fn records(run: &Run) -> Vec<Record> {
    let warn = &mut |text: &str| tell!("warning: {text}");
    read_metrics(&run.folder, warn).unwrap_or_else(|error| {
        warn(&error.to_string());
        Vec::new()
    })
}

fn subtitle(run: &Run) -> String {
    let recipe = match (run.system, run.recipe()) {
        (Some(system), Some(recipe)) => format!("Recipe {recipe} of {system}, in "),
        _ => String::new(),
    };
    format!("{recipe}{}", run.folder.display())
}

fn status(run: &Run, stages: &[Run]) -> Cell {
    let mut all = stages.iter().map(|stage| stage.status);
    let training = all.find(|status| *status == RunStatus::Training);
    let status = training.unwrap_or(run.status);
    let tone = match status {
        RunStatus::Finished | RunStatus::StoppedEarly | RunStatus::Weights => Tone::Good,
        RunStatus::Damaged => Tone::Bad,
        RunStatus::Training => Tone::Busy,
        RunStatus::Stopped | RunStatus::NotStarted => Tone::Plain,
    };
    Cell::new(status.name(), tone)
}

/// A stage of a fine-tuning.
fn stage_section(stage: &Run) -> Section {
    let name = stage.folder.file_name().unwrap_or_default();
    let mut section = Section::new(format!("Stage {}", name.to_string_lossy()));
    section.add(Block::Warning(stage.problem.clone().unwrap_or_default()));
    let records = records(stage);
    let environments = read_environments(&stage.folder);
    let mut facts = vec![("state".to_string(), stage.status.name().to_string())];
    facts.extend(facts::highlights(stage, &records, environments.last()));
    section.add(Block::Facts(facts));
    section.add(Block::Charts(curves::charts(&[("", &records)])));
    section
}

/// True for a file or folder of the run. A page is passed on, so links that lead out of the run are
/// not followed.
fn is_own(run: &Path, path: &Path) -> bool {
    is_inside(run, path).unwrap_or(false)
}

/// The files of a folder of the run. Each link that leads out of the run is a warning in the section.
fn own_files(run: &Path, folder: &str, endings: &[&str], section: &mut Section) -> Vec<PathBuf> {
    let files = files_in(&run.join(folder), endings).into_iter();
    let (own, foreign): (Vec<_>, Vec<_>) = files.partition(|path| is_own(run, path));
    for link in foreign {
        let text = format!("{} leads out of the run and is left out", link.display());
        section.add(Block::Warning(text));
    }
    own
}

/// The resolved config.
fn configuration(run: &Run) -> Section {
    let mut section = Section::new("Config");
    let path = run.folder.join("config.toml");
    let saved = is_own(&run.folder, &path).then(|| read_text(&path).ok());
    let text = saved
        .flatten()
        .or_else(|| run.config.as_ref().map(config::to_toml));
    let title = "every key, resolved".into();
    section.add(Block::Source(title, text.unwrap_or_default()));
    section
}
