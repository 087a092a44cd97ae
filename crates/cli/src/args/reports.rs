//! Arguments of `plot`, `report` and `runs`.

use std::path::PathBuf;

use clap::Args;

use super::reading::ReadingArguments;

/// Motion files are plotted as the path from above and curves over time: all channels, quaternion
/// norm and jerk of phrases `[T, 25]`; poses from the side, when the feet stand, root, feet and jerk
/// of joint features `[T, 263]` or `[T, 251]` and of joint positions `[T, 22, 3]` or `[T, 21, 3]`;
/// height and speed of the root of joint positions `[T, J, 3]` of any other skeleton, drawn as
/// points, and of BVH files; place and speed of ground paths `[T, 2]`. Runs are plotted as loss curves.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad plot dance.npy --out dance.svg
  kinegrad plot walk.npy --goal configs/goal.toml --out walk.png
  kinegrad plot capture.bvh --units cm --out capture.svg
  kinegrad plot runs/quickstart --out losses.svg")]
pub struct PlotArguments {
    /// Motion file: phrase `[T, 25]`, joint features `[T, 263]` or `[T, 251]`, joint positions
    /// `[T, J, 3]` or ground path `[T, 2]` (.npy), or a capture (.bvh); or the folder of a run
    #[arg(value_name = "MOTION|RUN")]
    pub input: PathBuf,
    /// Goal to draw on the floor: key frames, trajectory and obstacles
    #[arg(long, value_name = "GOAL.toml")]
    pub goal: Option<PathBuf>,
    #[command(flatten)]
    pub reading: ReadingArguments,
    /// Image to write
    #[arg(long, value_name = "FILE.svg|FILE.png")]
    pub out: PathBuf,
}

/// The page holds losses, validation, evaluation reports, samples with their checks as moving
/// thumbnails, the resolved config, hardware, versions, times and checkpoints. It is one HTML file
/// that needs no network, and can be made while the run is trained.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad report runs/quickstart
  kinegrad report runs/phrases --out phrases.html")]
pub struct ReportArguments {
    /// Folder of the run
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
    /// Page to write [default: RUN/report.html]
    #[arg(long, value_name = "FILE.html")]
    pub out: Option<PathBuf>,
}

/// Runs are found in the folder and in those below it; the stages of a fine-tuning, which are runs
/// in the folder of another, are listed too.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad runs
  kinegrad runs experiments --json")]
pub struct RunsArguments {
    /// Folder that contains the runs
    #[arg(value_name = "DIR", default_value = "runs")]
    pub folder: PathBuf,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}
