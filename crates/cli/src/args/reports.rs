//! Arguments of `plot`, `report` and `runs`.

use std::path::PathBuf;

use clap::Args;

use super::reading::BvhArguments;

/// Arguments of `kinegrad plot`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad plot dance.npy --out dance.svg
  kinegrad plot walk.npy --goal configs/goal.toml --out walk.png
  kinegrad plot capture.bvh --units cm --out capture.svg
  kinegrad plot runs/quickstart --out losses.svg
  kinegrad plot runs/e2e --terms --out terms.svg
  kinegrad plot runs/one runs/two --out losses.svg
  kinegrad plot --schedule configs/gmd_trajectory.toml --out schedule.svg")]
pub struct PlotArguments {
    /// Motion file (.npy or .bvh), or folders of runs to plot together
    #[arg(required = true, value_name = "MOTION|RUN")]
    pub inputs: Vec<PathBuf>,
    /// Plot the noise schedules of configs (.toml) or runs: over the timesteps, shares of motion and
    /// noise, and of the network's output in the mean of a step
    #[arg(long, conflicts_with = "goal")]
    pub schedule: bool,
    /// Goal to plot on the floor: key frames, trajectory and obstacles
    #[arg(long, value_name = "GOAL.toml")]
    pub goal: Option<PathBuf>,
    /// Plot the loss of a run and its terms, six panels on logarithmic axes
    #[arg(long, conflicts_with = "goal")]
    pub terms: bool,
    /// TOML file with the thresholds of phrases: the keys of `evaluation.thresholds`
    /// [default: CC-MotionGen's]
    #[arg(long, value_name = "FILE")]
    pub thresholds: Option<PathBuf>,
    #[command(flatten)]
    pub reading: BvhArguments,
    /// Image to write
    #[arg(long, value_name = "FILE.svg|FILE.png")]
    pub out: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    pub overwrite: bool,
}

/// Arguments of `kinegrad report`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad report runs/quickstart
  kinegrad report runs/phrases --out phrases.html
  kinegrad report runs/one runs/two --out comparison.html")]
pub struct ReportArguments {
    /// Folder of the run; several are compared
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// Page to write [default: RUN/report.html; of several runs comparison.html beside the first]
    #[arg(long, value_name = "FILE.html")]
    pub out: Option<PathBuf>,
}

/// The folder that training creates.
pub const RUNS: &str = "runs";

/// Arguments of `kinegrad runs`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad runs
  kinegrad runs experiments --json")]
pub struct RunsArguments {
    /// Folder that contains the runs [default: KINEGRAD_RUNS_DIR, else runs]
    #[arg(value_name = "DIR")]
    pub folder: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}
