//! `kinegrad data`

use std::path::Path;
use std::process::ExitCode;

use kinegrad_data::humanml::{SkeletonName, write_walks};
use kinegrad_data::manifest::Selection;
use kinegrad_data::{
    ChannelSummary, DataConfig, DataKind, Inspection, MANIFEST, Problem, Store, StoreConfig,
    synthetic,
};

use crate::args::{InspectArguments, SkeletonArgument, SynthArguments};
use crate::failure::{Failure, UsageError};
use crate::output::{grouped, table};
use crate::picture::{Panel, draw};
use crate::progress::reading;

/// The shortest clips that KIT-ML is trained on.
const KIT_MIN_FRAMES: usize = 24;

/// Writes a synthetic dataset.
pub fn synth(arguments: SynthArguments) -> Result<ExitCode, Failure> {
    let SynthArguments {
        out,
        walks,
        phrases,
        frames,
        seed,
    } = arguments;
    let what = if walks {
        write_walks(&out, phrases, frames, seed)?;
        "walks"
    } else {
        synthetic::write_dataset(&out, phrases, frames, seed)?;
        "phrases"
    };
    say!("{phrases} {what} of {frames} frames in {}", out.display());
    Ok(ExitCode::SUCCESS)
}

/// Prints what a dataset holds; exit code 1 if items cannot be used.
pub fn inspect(arguments: InspectArguments) -> Result<ExitCode, Failure> {
    if arguments.condition.is_some() || arguments.plot.is_some() {
        return select(&arguments);
    }
    let mut config = DataConfig {
        source: Some(arguments.source.clone()),
        ..Default::default()
    };
    if arguments.humanml3d {
        config.kind = DataKind::Humanml3d;
        if let SkeletonArgument::Kit = arguments.skeleton {
            config.humanml3d.skeleton = SkeletonName::Kit;
            config.humanml3d.min_frames = KIT_MIN_FRAMES;
        }
    }
    let inspection = kinegrad_data::inspect(&config, &*reading())?;
    if arguments.json {
        say!(
            "{}",
            serde_json::to_string(&inspection).expect("plain data")
        );
    } else {
        print(&inspection);
    }
    Ok(match inspection.bad_items {
        0 => ExitCode::SUCCESS,
        _ => ExitCode::from(1),
    })
}

/// Lists or draws the rows of a dataset's manifest.
fn select(arguments: &InspectArguments) -> Result<ExitCode, Failure> {
    let store = Store::open(&arguments.source, &StoreConfig::default())?;
    let Some(all) = Selection::read(&store)? else {
        let is_there = store.is_remote() || Path::new(&store.uri()).is_dir();
        let message = match is_there {
            true => format!("{} has no {MANIFEST}", store.uri()),
            false => format!("there is no folder {}", store.uri()),
        };
        let hint = "`--where` and `--plot` answer from the manifest, which `kinegrad data prepare` \
                    writes";
        return Err(UsageError::new(message, hint).into());
    };
    let chosen = match &arguments.condition {
        None => all.clone(),
        Some(condition) => all.filter(condition).map_err(|problem| {
            let hint = "as in `tempo > 100 and split = train`; =, !=, <, <=, >, >=, like, and, or, \
                        not and brackets are known";
            UsageError::new(format!("`--where {condition}`: {problem}"), hint)
        })?,
    };
    if let Some(out) = &arguments.plot {
        plot(&chosen, out)?;
        tell!("{}", out.display());
    }
    if arguments.json {
        say!(
            "{}",
            serde_json::to_string(&chosen.texts("id").unwrap_or_default()).expect("plain data")
        );
    } else if arguments.condition.is_some() {
        print_selection(&chosen, all.len());
    }
    Ok(ExitCode::SUCCESS)
}

fn print_selection(chosen: &Selection, all: usize) {
    const COLUMNS: [&str; 6] = ["id", "frames", "tempo", "beats", "split", "flags"];
    let columns = COLUMNS.map(|name| {
        let texts = chosen.texts(name).unwrap_or_default();
        let numbers = chosen
            .numbers(name)
            .filter(|_| name == "tempo" || name == "beats");
        match numbers {
            Some(numbers) => numbers
                .iter()
                .map(|number| number.map_or(String::new(), |number| format!("{number:.1}")))
                .collect(),
            None => texts,
        }
    });
    let header = COLUMNS.map(String::from).to_vec();
    let rows = (0..chosen.len()).map(|row| {
        let cell = |column: &Vec<String>| column.get(row).cloned().unwrap_or_default();
        columns.iter().map(cell).collect()
    });
    say!("{}", table(std::iter::once(header).chain(rows)));
    let frames = chosen.numbers("frames").unwrap_or_default();
    // A sum of nothing is minus zero.
    let frames = frames.into_iter().flatten().fold(0.0, |sum, f| sum + f);
    say!(
        "{} of {} phrases, {:.2} minutes",
        grouped(chosen.len()),
        grouped(all),
        frames / kinegrad_motion::FPS / 60.0
    );
}

fn plot(chosen: &Selection, out: &Path) -> Result<(), Failure> {
    let histogram = |title: &str, label, column: &str| {
        let values: Vec<f64> = chosen
            .numbers(column)
            .unwrap_or_default()
            .into_iter()
            .flatten()
            .collect();
        Panel::histogram(
            format!("{title} of {} phrases", values.len()),
            label,
            &values,
            24,
        )
    };
    let panels = [
        histogram("tempo", "beats per minute", "tempo"),
        histogram("length", "frames", "frames"),
        histogram("beats", "beats in a phrase", "beats"),
        histogram("place in the song", "first frame", "first_frame"),
    ];
    draw(&panels, 2, (520, 250), out)
}

fn print(inspection: &Inspection) {
    let Inspection { kind, fps, .. } = inspection;
    let (shortest, longest) = (inspection.shortest_frames, inspection.longest_frames);
    let (train, held_out) = (grouped(inspection.train), grouped(inspection.validation));
    let (frames, minutes) = (grouped(inspection.frames), inspection.hours * 60.0);
    let row = |name: &str, value: String| vec![name.to_string(), value];
    let mut facts = vec![
        row("source", inspection.source.clone()),
        row(&format!("{kind}s"), grouped(inspection.items)),
        row(&format!("unusable {kind}s"), grouped(inspection.bad_items)),
        row(&format!("{kind}s left out"), grouped(inspection.left_out)),
        row("to train on, held out", format!("{train}, {held_out}")),
        row(
            "frames",
            format!("{frames} ({minutes:.2} minutes at {fps} fps)"),
        ),
        row(
            &format!("frames a {kind}"),
            format!("{shortest} to {longest}"),
        ),
        row(
            "motion",
            format!(
                "[frames, {}], {}",
                inspection.channels, inspection.representation
            ),
        ),
    ];
    let counts = inspection.counts.iter();
    facts.extend(counts.map(|(name, count)| row(name, grouped(*count))));
    say!("{}\n", table(facts));
    say!("{}", channels(&inspection.motion));
    if !inspection.conditions.is_empty() {
        say!("\n{}", channels(&inspection.conditions));
    }
    print_problems(&inspection.warnings, &inspection.problems);
}

/// What is odd about a dataset, and what is wrong with single items.
fn print_problems(warnings: &[String], problems: &[Problem]) {
    for warning in warnings {
        say!("warning: {warning}");
    }
    if !problems.is_empty() {
        say!("\nproblems:");
    }
    for problem in problems {
        let grade = if problem.unusable {
            "unusable"
        } else {
            "usable"
        };
        say!("  {} ({grade}): {}", problem.id, problem.problem);
    }
}

/// Range, mean and deviation of channels, or of groups of them.
fn channels(summaries: &[ChannelSummary]) -> String {
    let header = ["channel", "min", "max", "mean", "std"]
        .map(String::from)
        .to_vec();
    let rows = summaries.iter().map(|channel| {
        let ChannelSummary {
            name,
            min,
            max,
            mean,
            std,
        } = channel;
        let numbers = [min, max, mean, std].map(|number| format!("{number:.4}"));
        std::iter::once(name.clone()).chain(numbers).collect()
    });
    table(std::iter::once(header).chain(rows))
}
