//! Arguments of `plot`, `report` and `runs`.

use std::path::PathBuf;

use clap::Args;

use super::reading::ReadingArguments;

/// Motion is plotted as the root path, top view, and as curves over time. Phrases `[T, 25]`: all
/// channels, quaternion norm and jerk. Joint features `[T, 263]` or `[T, 251]` and joint positions
/// `[T, 22, 3]` or `[T, 21, 3]`: poses from the side, foot contacts, root, feet and jerk. Other joint
/// positions `[T, J, 3]` and BVH files: height and speed of the root. Ground paths `[T, 2]`: position
/// and speed. Runs are plotted as loss curves.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad plot dance.npy --out dance.svg
  kinegrad plot walk.npy --goal configs/goal.toml --out walk.png
  kinegrad plot capture.bvh --units cm --out capture.svg
  kinegrad plot runs/quickstart --out losses.svg")]
pub struct PlotArguments {
    /// Motion file (.npy or .bvh), or folder of a run
    #[arg(value_name = "MOTION|RUN")]
    pub input: PathBuf,
    /// Goal to plot on the floor: key frames, trajectory and obstacles
    #[arg(long, value_name = "GOAL.toml")]
    pub goal: Option<PathBuf>,
    #[command(flatten)]
    pub reading: ReadingArguments,
    /// Image to write
    #[arg(long, value_name = "FILE.svg|FILE.png")]
    pub out: PathBuf,
}

/// One HTML file that needs no network: losses, evaluation reports, moving samples with their checks,
/// the resolved config, hardware, versions, times and checkpoints. It can be written during training.
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

/// Searches the folder and those below it. Stages of a fine-tuning, which are runs inside the folder
/// of another, are listed too.
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
