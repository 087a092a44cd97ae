//! Arguments of `kinegrad warp`.

use std::path::PathBuf;

use clap::Args;
use kinegrad_motion::path::{Along, Turning};

use super::values::named;

/// Moves a motion onto a path over the ground, without any model: each frame is turned about the
/// vertical and moved so that the root is on the path. Heights and bones stay as they are.
///
/// The path is a TOML file with `points = [[x, z], ..]` in metres, a table with columns x and z
/// (.csv), or a drawing (.svg). docs/paths.md describes them.
///
/// Joint positions `[T, J, 3]` in metres are written to PATH.npy, joint features to PATH.features.npy
/// (contacts and velocities computed again, beginning at the origin), a BVH file in centimetres to
/// PATH.bvh, and how it was made to PATH.json.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad warp walk.npy --path circle.toml --lock-feet --out circle
  kinegrad warp walk.npy --path corridor.csv --along own --out corridor
  kinegrad warp walk.features.npy --path map.svg --metres-per-unit 0.01 --out map")]
pub struct WarpArguments {
    /// Motion to move (.npy): joint positions or joint features
    #[arg(value_name = "MOTION.npy")]
    pub motion: PathBuf,
    /// Path to move it onto (.toml, .csv or .svg)
    #[arg(long, value_name = "FILE")]
    pub path: PathBuf,
    /// Output path without extension
    #[arg(long, value_name = "PATH")]
    pub out: PathBuf,
    /// Replace files that exist
    #[arg(long)]
    pub overwrite: bool,
    /// `stretch`: over all of the path, faster or slower than it was; `own`: at its own speed, up to
    /// where the path ends
    #[arg(long, value_parser = named::<Along>, default_value = "stretch")]
    pub along: Along,
    /// How the body turns: `relative`, as the direction of its way (side steps stay side steps);
    /// `face`, to face along the path; `free`, not at all
    #[arg(long, value_parser = named::<Turning>, default_value = "relative", value_name = "TURNING")]
    pub heading: Turning,
    /// Do not smooth turns over time
    #[arg(long)]
    pub sharp: bool,
    /// Hold feet still where they stand in the motion, by two-bone inverse kinematics
    #[arg(long)]
    pub lock_feet: bool,
    /// Metres of a unit of a drawing
    #[arg(long, value_name = "METRES")]
    pub metres_per_unit: Option<f64>,
    /// Print the record as JSON
    #[arg(long)]
    pub json: bool,
}
