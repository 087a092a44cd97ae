//! `kinegrad plot`

use std::ops::Range;
use std::process::ExitCode;

use kinegrad_data::read_motion;
use kinegrad_motion::kinematics::jerk;
use kinegrad_motion::phrase::{
    ACCELERATION, ANGULAR_VELOCITY, PHASE, POSITION, QUATERNION, STYLE, VELOCITY,
};
use kinegrad_motion::rotation::length;
use kinegrad_motion::{FPS, Motion};
use kinegrad_report::{Panel, Series, check_ending};
use kinegrad_train::Error;
use kinegrad_train::telemetry::{Record, read_metrics};

use crate::args::PlotArguments;
use crate::output::{draw, no_picture};

/// Draws a motion file or a run.
pub fn run(arguments: PlotArguments) -> Result<ExitCode, Error> {
    let PlotArguments { input, out } = arguments;
    check_ending(&out).map_err(no_picture)?;
    let panels = if input.join("metrics.jsonl").exists() {
        loss_panels(&read_metrics(&input)?)
    } else if input.is_file() {
        motion_panels(&read_motion(&input)?)
    } else {
        let message = format!(
            "there is neither a motion file nor a run at {}",
            input.display()
        );
        let hint = "give a .npy file of [T, 25], or a folder such as runs/quickstart";
        return Err(Error::usage(message, hint));
    };
    draw(&panels, 2, (520, 250), &out)?;
    say!("{}", out.display());
    Ok(ExitCode::SUCCESS)
}

fn motion_panels(motion: &Motion) -> Vec<Panel> {
    let frames = || 0..motion.frames();
    let channels = |title, range: Range<usize>, names: &[&'static str]| {
        let track = |channel: usize| frames().map(move |t| f64::from(motion.frame(t)[channel]));
        let tracks = range.zip(names);
        let tracks = tracks.map(|(channel, name)| (*name, track(channel).collect()));
        Panel::over_time(title, FPS, tracks)
    };
    let xyz = ["x", "y", "z"];
    // Seen from above, with +z, towards the viewer, downwards.
    let above = |[x, _, z]: [f64; 3]| (x, -z);
    let path = frames().map(|t| above(motion.vector(t, POSITION)));
    let norm = frames().map(|t| motion.quaternion(t).norm());
    let jerk = jerk(motion).into_iter().map(length);
    vec![
        Panel::map(
            "path from above (m; x right, z down)",
            "m",
            vec![("path".into(), path.collect())],
        ),
        channels("position (m)", POSITION, &xyz),
        channels("velocity (m/s)", VELOCITY, &xyz),
        channels("acceleration (m/s²)", ACCELERATION, &xyz),
        channels("quaternion", QUATERNION, &["w", "x", "y", "z"]),
        channels("angular velocity (rad/s)", ANGULAR_VELOCITY, &xyz),
        channels("phase", PHASE..PHASE + 1, &["phase"]),
        channels("style", STYLE, &["0", "1", "2", "3", "4", "5", "6", "7"]),
        Panel::over_time("quaternion norm", FPS, [("|q|", norm.collect())]),
        Panel::over_time("jerk (m/s³)", FPS, [("|jerk|", jerk.collect())]),
    ]
}

fn loss_panels(records: &[Record]) -> Vec<Panel> {
    let panel = |title, names: &[&str]| {
        let curves = names.iter().map(|name| -> Series {
            let points = records
                .iter()
                .filter_map(|r| Some((r.step as f64, r.get(name)?)));
            (name.to_string(), points.collect())
        });
        let measured = curves.filter(|(_, points)| !points.is_empty());
        Panel::lines(title, "step", measured.collect())
    };
    vec![
        panel("loss", &["loss", "val_loss"]),
        panel("gradient norm", &["grad_norm"]),
        panel("learning rate", &["lr"]),
    ]
}
