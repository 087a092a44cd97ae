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
use kinegrad_train::telemetry::{Record, read_metrics};

use crate::args::PlotArguments;
use crate::failure::{Failure, UsageError};
use crate::picture::{Panel, Series, check_ending, draw};

/// Draws a motion file or a run.
pub fn run(arguments: PlotArguments) -> Result<ExitCode, Failure> {
    let PlotArguments { input, out } = arguments;
    check_ending(&out)?;
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
        return Err(UsageError::new(message, hint).into());
    };
    draw(&panels, 2, (520, 250), &out)?;
    say!("{}", out.display());
    Ok(ExitCode::SUCCESS)
}

fn over_time(title: &str, series: Vec<Series>) -> Panel {
    Panel::lines(title, "s", series)
}

fn motion_panels(motion: &Motion) -> Vec<Panel> {
    let seconds = |t: usize| t as f64 / FPS;
    let curve = |name: String, value: &dyn Fn(usize) -> f64| -> Series {
        (
            name,
            (0..motion.frames())
                .map(|t| (seconds(t), value(t)))
                .collect(),
        )
    };
    let channels = |range: Range<usize>, names: &[&str]| -> Vec<Series> {
        range
            .zip(names)
            .map(|(channel, name)| {
                curve(name.to_string(), &|t| f64::from(motion.frame(t)[channel]))
            })
            .collect()
    };
    let xyz = ["x", "y", "z"];
    let path: Vec<(f64, f64)> = (0..motion.frames())
        .map(|t| motion.vector(t, POSITION))
        // Seen from above, with +z, towards the viewer, downwards.
        .map(|[x, _, z]| (x, -z))
        .collect();
    let jerk: Vec<(f64, f64)> = jerk(motion)
        .into_iter()
        .enumerate()
        .map(|(t, j)| (seconds(t), length(j)))
        .collect();
    let norm = curve("|q|".into(), &|t| motion.quaternion(t).norm());
    vec![
        Panel::map(
            "path from above (m; x right, z down)",
            "m",
            vec![("path".into(), path)],
        ),
        over_time("position (m)", channels(POSITION, &xyz)),
        over_time("velocity (m/s)", channels(VELOCITY, &xyz)),
        over_time("acceleration (m/s²)", channels(ACCELERATION, &xyz)),
        over_time("quaternion", channels(QUATERNION, &["w", "x", "y", "z"])),
        over_time("angular velocity (rad/s)", channels(ANGULAR_VELOCITY, &xyz)),
        over_time("phase", channels(PHASE..PHASE + 1, &["phase"])),
        over_time(
            "style",
            channels(STYLE, &["0", "1", "2", "3", "4", "5", "6", "7"]),
        ),
        over_time("quaternion norm", vec![norm]),
        over_time("jerk (m/s³)", vec![("|jerk|".into(), jerk)]),
    ]
}

fn loss_panels(records: &[Record]) -> Vec<Panel> {
    let curve = |name: &str| -> Series {
        let points = records
            .iter()
            .filter_map(|r| Some((r.step as f64, r.get(name)?)));
        (name.to_string(), points.collect())
    };
    let losses: Vec<Series> = ["loss", "val_loss"]
        .map(curve)
        .into_iter()
        .filter(|(_, points)| !points.is_empty())
        .collect();
    let panel = |title, series| Panel::lines(title, "step", series);
    vec![
        panel("loss", losses),
        panel("gradient norm", vec![curve("grad_norm")]),
        panel("learning rate", vec![curve("lr")]),
    ]
}
