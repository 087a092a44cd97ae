//! `kinegrad data`

use std::path::Path;
use std::process::ExitCode;

use kinegrad_data::humanml::{SkeletonName, write_walks};
use kinegrad_data::manifest::Selection;
use kinegrad_data::{
    AudioLayout, ChannelSummary, DataConfig, DataKind, Inspection, MANIFEST, MOTION_FILE, Problem,
    Store, StoreConfig, synthetic,
};
use kinegrad_report::{Panel, facts, grouped, table};
use kinegrad_settings::{counted, plural};
use kinegrad_train::Error;

use crate::args::{InspectArguments, SynthArguments};
use crate::output::{self, draw};
use crate::progress::reading;

/// Minimum clip length of KIT-ML.
const KIT_MIN_FRAMES: usize = 24;

/// Writes a synthetic dataset.
pub fn synth(arguments: SynthArguments) -> Result<ExitCode, Error> {
    let SynthArguments {
        out,
        walks,
        phrases,
        frames,
        seed,
        beats,
    } = arguments;
    let what = if walks {
        write_walks(&out, phrases, frames, seed)?;
        "walk"
    } else {
        let layout = AudioLayout { beats };
        synthetic::write_dataset(&out, layout, phrases, frames, seed)?;
        "phrase"
    };
    let (items, frames) = (counted(phrases, what), counted(frames, "frame"));
    say!("{items} of {frames} in {}", out.display());
    Ok(ExitCode::SUCCESS)
}

/// Prints a summary of a dataset; the exit code is 1 if an item cannot be used.
pub fn inspect(arguments: InspectArguments) -> Result<ExitCode, Error> {
    if arguments.condition.is_some() || arguments.plot.is_some() {
        return select(&arguments);
    }
    let mut config = DataConfig {
        source: Some(arguments.source.clone()),
        ..Default::default()
    };
    let clips = kinegrad_data::humanml::find_clips(&config)?;
    if arguments.humanml3d || arguments.skeleton.is_some() || clips.is_some() {
        config.kind = DataKind::Humanml3d;
        let skeleton = arguments.skeleton.or(clips.flatten());
        config.humanml3d.skeleton = skeleton.unwrap_or(SkeletonName::Humanml3d);
        if config.humanml3d.skeleton == SkeletonName::Kit {
            config.humanml3d.min_frames = KIT_MIN_FRAMES;
        }
    }
    let inspection = kinegrad_data::inspect(&config, &*reading(Default::default()));
    let inspection = inspection.map_err(|error| match error {
        kinegrad_data::Error::MissingFolder(path) if path.ends_with(MOTION_FILE.0) => {
            no_dataset(&arguments.source)
        }
        error => error.into(),
    })?;
    if arguments.json {
        output::json(&inspection);
    } else {
        print(&inspection, &config);
    }
    Ok(ExitCode::from(u8::from(inspection.bad_items > 0)))
}

/// The error of a source without a known layout.
fn no_dataset(source: &str) -> Error {
    let message = match source.contains("://") || Path::new(source).is_dir() {
        true => format!(
            "{source} is not a dataset: it has neither a folder `{}` of phrases, nor a list `train.txt` or a \
             folder `new_joint_vecs` of clips",
            MOTION_FILE.0
        ),
        false => format!("there is no folder {source}"),
    };
    let hint = "phrases are motion/ID/trajectory.npy and audio_features/ID/features.npz; clips of \
                HumanML3D or KIT-ML are new_joint_vecs/ID.npy and texts/ID.txt with train.txt and \
                val.txt; `kinegrad data synth --out DIR` makes phrases to try, or clips with \
                `--walks`; `kinegrad data prepare` makes a dataset from captures";
    Error::usage(message, hint)
}

/// Lists or plots the rows of a dataset's manifest.
fn select(arguments: &InspectArguments) -> Result<ExitCode, Error> {
    let store = Store::open(&arguments.source, &StoreConfig::default())?;
    let Some(all) = Selection::read(&store)? else {
        let uri = store.uri();
        let message = match store.is_remote() || Path::new(&uri).is_dir() {
            true => format!("{uri} has no {MANIFEST}"),
            false => format!("there is no folder {uri}"),
        };
        let hint = "`--where` and `--plot` need the manifest, which `kinegrad data prepare` \
                    writes";
        return Err(Error::usage(message, hint));
    };
    let chosen = match &arguments.condition {
        None => all.clone(),
        Some(condition) => all.filter(condition).map_err(|problem| {
            let hint = "for example `tempo > 100 and split = train`, with =, !=, <, <=, >, >=, like, and, \
                        or, not and brackets";
            Error::usage(format!("`--where {condition}`: {problem}"), hint)
        })?,
    };
    if let Some(out) = &arguments.plot {
        plot(&chosen, out)?;
        tell!("{}", out.display());
    }
    if arguments.json {
        output::json(&chosen.texts("id").unwrap_or_default());
    } else if arguments.condition.is_some() {
        print_selection(&chosen, all.len());
    }
    Ok(ExitCode::SUCCESS)
}

fn print_selection(chosen: &Selection, all: usize) {
    const PHRASES: [&str; 6] = ["id", "frames", "tempo", "beats", "split", "flags"];
    const CLIPS: [&str; 6] = ["id", "frames", "map", "mirrored", "split", "caption"];
    let clips = chosen.texts("caption").is_some();
    let (names, item) = match clips {
        true => (CLIPS, "clip"),
        false => (PHRASES, "phrase"),
    };
    let shown = |number: Option<f64>| number.map_or(String::new(), |n| format!("{n:.1}"));
    let columns = names.map(|name| match (name, chosen.numbers(name)) {
        ("tempo" | "beats", Some(numbers)) => numbers.into_iter().map(shown).collect(),
        _ => chosen.texts(name).unwrap_or_default(),
    });
    let rows = (0..chosen.len()).map(|row| {
        let cell = |column: &Vec<String>| column.get(row).cloned().unwrap_or_default();
        columns.each_ref().map(cell)
    });
    show!("{}", table(names, rows));
    // An empty sum of f64 is -0.
    let sum = |column: &str| {
        let values = chosen.numbers(column).into_iter().flatten().flatten();
        values.fold(0.0, |sum, value| sum + value)
    };
    let seconds = match clips {
        true => sum("seconds"),
        false => sum("frames") / kinegrad_motion::FPS,
    };
    let items = plural(all, item);
    let (count, all, minutes) = (grouped(chosen.len()), grouped(all), seconds / 60.0);
    say!("{count} of {all} {items}, {minutes:.2} minutes");
}

fn plot(chosen: &Selection, out: &Path) -> Result<(), Error> {
    let (item, place) = match chosen.texts("caption") {
        Some(_) => ("clip", "place in the take"),
        None => ("phrase", "place in the song"),
    };
    // Clips have neither tempo nor beats.
    let histogram = |title: &str, label, column: &str| {
        let values = chosen.numbers(column)?;
        let values: Vec<f64> = values.into_iter().flatten().collect();
        let title = format!("{title} of {}", counted(values.len(), item));
        Some(Panel::histogram(title, label, &values, 24))
    };
    let panels = [
        histogram("tempo", "beats per minute", "tempo"),
        histogram("length", "frames", "frames"),
        histogram("beats", "beats in a phrase", "beats"),
        histogram(place, "first frame", "first_frame"),
    ];
    let panels: Vec<Panel> = panels.into_iter().flatten().collect();
    draw(&panels, 2, (520, 250), out)
}

fn print(inspection: &Inspection, config: &DataConfig) {
    let Inspection { kind, fps, .. } = inspection;
    let (shortest, longest) = (inspection.shortest_frames, inspection.longest_frames);
    let (train, held_out) = (grouped(inspection.train), grouped(inspection.validation));
    let (frames, minutes) = (grouped(inspection.frames), inspection.hours * 60.0);
    let (items, unusable, left_out, lengths) = (
        format!("{kind}s"),
        format!("unusable {kind}s"),
        format!("{kind}s left out"),
        format!("frames a {kind}"),
    );
    let length = format!("{frames} ({minutes:.2} minutes at {fps} fps)");
    let layout = match config.kind {
        DataKind::Humanml3d => {
            let skeleton = config.humanml3d.skeleton;
            format!("clips in the HumanML3D layout, skeleton {skeleton}")
        }
        _ => "phrases".to_owned(),
    };
    let shown = [
        ("source", inspection.source.clone()),
        ("read as", layout),
        (&items, grouped(inspection.items)),
        (&unusable, grouped(inspection.bad_items)),
        (&left_out, grouped(inspection.left_out)),
        ("to train on, held out", format!("{train}, {held_out}")),
        ("frames", length),
        (&lengths, format!("{shortest} to {longest}")),
        ("motion", inspection.representation.clone()),
        ("channels", grouped(inspection.channels)),
    ];
    let counts = inspection.counts.iter();
    let counts = counts.map(|(name, count)| (name.as_str(), grouped(*count)));
    let beats = inspection.beats.iter();
    let beats = beats.map(|beats| ("phase from tracked beats", beats.to_string()));
    show!("{}\n", facts(shown.into_iter().chain(counts).chain(beats)));
    show!("{}", channels(&inspection.motion));
    if !inspection.conditions.is_empty() {
        show!("\n{}", channels(&inspection.conditions));
    }
    print_problems(&inspection.warnings, &inspection.problems);
}

/// Warnings about the dataset, and problems of items.
fn print_problems(warnings: &[String], problems: &[Problem]) {
    for warning in warnings {
        say!("warning: {warning}");
    }
    if !problems.is_empty() {
        say!("\nproblems:");
    }
    for problem in problems {
        let prefix = if problem.unusable { "un" } else { "" };
        say!("  {} ({prefix}usable): {}", problem.id, problem.problem);
    }
}

/// Range, mean and standard deviation of channels or groups of channels.
fn channels(summaries: &[ChannelSummary]) -> String {
    let rows = summaries.iter().map(|channel| {
        let numbers = [channel.min, channel.max, channel.mean, channel.std];
        let [min, max, mean, std] = numbers.map(|number| format!("{number:.4}"));
        [channel.name.clone(), min, max, mean, std]
    });
    table(["channel", "min", "max", "mean", "std"], rows)
}
