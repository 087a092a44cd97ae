//! `kinegrad data`

use std::process::ExitCode;

use kinegrad_data::{ChannelSummary, DataConfig, Inspection, synthetic};

use crate::args::{InspectArguments, SynthArguments};
use crate::failure::Failure;
use crate::output::{grouped, table};

/// Writes a synthetic dataset.
pub fn synth(arguments: SynthArguments) -> Result<ExitCode, Failure> {
    let SynthArguments {
        out,
        phrases,
        frames,
        seed,
    } = arguments;
    synthetic::write_dataset(&out, phrases, frames, seed)?;
    println!("{phrases} phrases of {frames} frames in {}", out.display());
    Ok(ExitCode::SUCCESS)
}

/// Prints what a dataset holds; exit code 1 if phrases cannot be used.
pub fn inspect(arguments: InspectArguments) -> Result<ExitCode, Failure> {
    let config = DataConfig {
        source: Some(arguments.source),
        ..Default::default()
    };
    let inspection = kinegrad_data::inspect(&config)?;
    if arguments.json {
        println!(
            "{}",
            serde_json::to_string(&inspection).expect("plain data")
        );
    } else {
        print(&inspection);
    }
    Ok(match inspection.bad_phrases {
        0 => ExitCode::SUCCESS,
        _ => ExitCode::from(1),
    })
}

fn print(inspection: &Inspection) {
    let Inspection {
        phrases,
        bad_phrases,
        frames,
        hours,
        fps,
        ..
    } = inspection;
    let (shortest, longest) = (inspection.shortest_frames, inspection.longest_frames);
    let facts = [
        ("source", inspection.source.clone()),
        ("phrases", grouped(*phrases)),
        ("unusable phrases", grouped(*bad_phrases)),
        (
            "frames",
            format!(
                "{} ({:.2} minutes at {fps} fps)",
                grouped(*frames),
                hours * 60.0
            ),
        ),
        ("frames a phrase", format!("{shortest} to {longest}")),
        (
            "motion",
            format!("[frames, {}]", inspection.motion_channels),
        ),
        (
            "audio features",
            format!("[{}, frames]", inspection.audio_channels),
        ),
    ];
    println!(
        "{}\n",
        table(facts.map(|(name, value)| vec![name.to_string(), value]))
    );
    println!("{}\n", channels(&inspection.motion));
    println!("{}", channels(&inspection.audio));
    for warning in &inspection.warnings {
        println!("warning: {warning}");
    }
    if !inspection.problems.is_empty() {
        println!("\nproblems:");
    }
    for problem in &inspection.problems {
        let grade = if problem.unusable {
            "unusable"
        } else {
            "usable"
        };
        println!("  {} ({grade}): {}", problem.id, problem.problem);
    }
}

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
