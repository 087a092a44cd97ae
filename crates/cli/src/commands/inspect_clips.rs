//! `kinegrad data inspect --humanml3d`

use std::process::ExitCode;

use kinegrad_data::humanml::{ClipInspection, SkeletonName, inspect_clips};
use kinegrad_data::{DataConfig, DataKind};
use kinegrad_report::{facts, grouped};
use kinegrad_train::Error;

use super::data::{channels, print_problems};
use crate::args::InspectArguments;
use crate::output;
use crate::progress::reading;

/// Fewest frames of a clip of KIT-ML, in the published trainings.
const KIT_MIN_FRAMES: usize = 24;

/// Prints what a dataset of clips holds; exit code 1 if clips cannot be used.
pub fn run(arguments: &InspectArguments, mut config: DataConfig) -> Result<ExitCode, Error> {
    config.kind = DataKind::Humanml3d;
    config.humanml3d.skeleton = arguments.skeleton;
    if config.humanml3d.skeleton == SkeletonName::Kit {
        config.humanml3d.min_frames = KIT_MIN_FRAMES;
    }
    let inspection = inspect_clips(&config, &*reading())?;
    if arguments.json {
        output::json(&inspection);
    } else {
        print(&inspection);
    }
    Ok(ExitCode::from(u8::from(inspection.bad_clips > 0)))
}

fn print(inspection: &ClipInspection) {
    let ClipInspection {
        hours,
        fps,
        shortest_frames,
        longest_frames,
        ..
    } = inspection;
    let texts = if inspection.conditional { "yes" } else { "no" };
    let shown = facts([
        ("dataset", inspection.source.clone()),
        ("skeleton", inspection.skeleton.clone()),
        ("clips", grouped(inspection.clips)),
        ("of them held out", grouped(inspection.validation)),
        ("left out by length", grouped(inspection.left_out)),
        ("that cannot be used", grouped(inspection.bad_clips)),
        (
            "length",
            format!("{hours:.2} hours at {fps} frames a second"),
        ),
        ("frames", format!("{shortest_frames} to {longest_frames}")),
        ("captions", grouped(inspection.captions)),
        ("of them of passages", grouped(inspection.passage_captions)),
        ("text embeddings", texts.to_string()),
    ]);
    say!("{shown}");
    say!("{}", channels(&inspection.groups));
    print_problems(&inspection.warnings, &inspection.problems);
}
