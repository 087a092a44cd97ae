//! Options for reading motion of any kind.

use clap::Args;
use kinegrad_capture::Units;
use kinegrad_capture::UpAxis;

use super::values::named;

/// Facts that motion files do not contain, and the motion to read.
#[derive(Debug, Args)]
pub struct BvhArguments {
    /// Unit of BVH files: m, cm, mm, inch, cmu, or a number of meters [default: guessed from the
    /// height of the body]
    #[arg(long, value_parser = units)]
    pub units: Option<Units>,
    /// Axis of BVH files that points up: y or z [default: guessed from the feet]
    #[arg(long, value_parser = named::<UpAxis>, value_name = "AXIS")]
    pub up: Option<UpAxis>,
    /// Number of the motion in a file of several, such as the results.npy of MDM and FlowMDM, from
    /// 0 [default: 0]
    #[arg(long, value_name = "N")]
    pub index: Option<usize>,
    /// Frames per second of joint positions and features [default: as in the record beside the file,
    /// else 20 or 12.5, by the skeleton, and 30 for joints of an unknown skeleton]
    #[arg(long, value_name = "FPS")]
    pub fps: Option<f64>,
}

/// Parses a unit: a name, or a length in meters.
fn units(text: &str) -> Result<Units, String> {
    match text.parse::<f64>() {
        Ok(metres) if metres > 0.0 && metres.is_finite() => Ok(Units::Metres(metres)),
        Ok(_) => Err("a length is a positive number of metres".to_string()),
        Err(_) => named(text).map_err(|_| {
            "allowed: m, cm, mm, inch, cmu, or a number of metres such as 0.05".to_string()
        }),
    }
}
