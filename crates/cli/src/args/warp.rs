//! Arguments of `kinegrad warp`.

use std::path::PathBuf;

use clap::Args;
use kinegrad_motion::path::{ArcLengthMode, HeadingMode};

use super::reading::BvhArguments;
use super::values::named;

/// Arguments of `kinegrad warp`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad warp walk.npy --path circle.toml --lock-feet --out circle
  kinegrad warp walk.npy --path corridor.csv --along own --out corridor
  kinegrad warp capture.bvh --path circle.toml --out circle
  kinegrad warp walk.features.npy --path map.svg --metres-per-unit 0.01 --out map")]
pub struct WarpArguments {
    /// Motion to move: joint positions or joint features (.npy), or a capture (.bvh), which is
    /// resampled to 20 frames per second
    #[arg(value_name = "MOTION")]
    pub motion: PathBuf,
    /// Path: points in meters (.toml or .csv), or a drawing (.svg)
    #[arg(long, value_name = "FILE")]
    pub path: PathBuf,
    /// Output path without extension
    #[arg(long, value_name = "PATH")]
    pub out: PathBuf,
    /// Replace existing files
    #[arg(long)]
    pub overwrite: bool,
    /// `stretch` covers the entire path at a changed speed, or goes at the `speed` that the path
    /// names; `own` keeps the motion's speed. Where the path ends first, the motion stands
    #[arg(long, value_parser = named::<ArcLengthMode>, default_value = "stretch")]
    pub along: ArcLengthMode,
    /// Heading of the body: `relative` turns with the direction of movement (side steps stay side
    /// steps), `face` faces along the path, `free` does not turn
    #[arg(long, value_parser = named::<HeadingMode>, default_value = "relative", value_name = "MODE")]
    pub heading: HeadingMode,
    /// Do not smooth turns over time
    #[arg(long)]
    pub sharp: bool,
    /// Lock the motion's standing feet by two-bone inverse kinematics
    #[arg(long)]
    pub lock_feet: bool,
    /// Write motion that is far out of the bounds of captured people under its usual name, and exit
    /// with 0
    #[arg(long)]
    pub allow_unusable: bool,
    /// Meters per unit of a drawing
    #[arg(long, value_name = "METRES")]
    pub metres_per_unit: Option<f64>,
    #[command(flatten)]
    pub bvh: BvhArguments,
    /// Print the record as JSON
    #[arg(long)]
    pub json: bool,
}
