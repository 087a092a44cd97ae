//! `kinegrad data inspect --humanml3d`

use std::process::ExitCode;

use kinegrad_data::humanml::{ClipInspection, SkeletonName, inspect_clips};
use kinegrad_data::{DataConfig, DataKind};

use super::data::{channels, print_problems};
use crate::args::{InspectArguments, SkeletonArgument};
use crate::failure::Failure;
use crate::output::{grouped, table};
use crate::progress::reading;

/// Fewest frames of a clip of KIT-ML, in the published trainings.
const KIT_MIN_FRAMES: usize = 24;

/// Prints what a dataset of clips holds; exit code 1 if clips cannot be used.
pub fn run(arguments: &InspectArguments, mut config: DataConfig) -> Result<ExitCode, Failure> {
    config.kind = DataKind::Humanml3d;
    config.humanml3d.skeleton = match arguments.skeleton {
        SkeletonArgument::Humanml3d => SkeletonName::Humanml3d,
        SkeletonArgument::Kit => SkeletonName::Kit,
    };
    if config.humanml3d.skeleton == SkeletonName::Kit {
        config.humanml3d.min_frames = KIT_MIN_FRAMES;
    }
    let inspection = inspect_clips(&config, &*reading())?;
    if arguments.json {
        let text = serde_json::to_string(&inspection).expect("plain data");
        say!("{text}");
    } else {
        print(&inspection);
    }
    Ok(match inspection.bad_clips {
        0 => ExitCode::SUCCESS,
        _ => ExitCode::from(1),
    })
}

fn print(inspection: &ClipInspection) {
    let row = |name: &str, value: String| vec![name.to_string(), value];
    say!(
        "{}",
        table([
            row("dataset", inspection.source.clone()),
            row("skeleton", inspection.skeleton.clone()),
            row("clips", grouped(inspection.clips)),
            row("of them held out", grouped(inspection.validation)),
            row("left out by length", grouped(inspection.left_out)),
            row("that cannot be used", grouped(inspection.bad_clips)),
            row(
                "length",
                format!(
                    "{:.2} hours at {} frames a second",
                    inspection.hours, inspection.fps
                ),
            ),
            row(
                "frames",
                format!(
                    "{} to {}",
                    inspection.shortest_frames, inspection.longest_frames
                ),
            ),
            row("captions", grouped(inspection.captions)),
            row("of them of passages", grouped(inspection.passage_captions)),
            row(
                "text embeddings",
                if inspection.conditional { "yes" } else { "no" }.to_string(),
            ),
        ])
    );
    say!("{}", channels(&inspection.groups));
    print_problems(&inspection.warnings, &inspection.problems);
}
