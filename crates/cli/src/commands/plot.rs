//! `kinegrad plot`

use std::path::Path;
use std::process::ExitCode;

use kinegrad_report::scene::Floor;
use kinegrad_report::{Panel, Series, body_panels, check_ending};
use kinegrad_train::clips::read_goal;
use kinegrad_train::telemetry::{Record, read_metrics};
use kinegrad_train::{Error, Systems};

use crate::args::PlotArguments;
use crate::io::{Motion, MotionArray, file_stem};
use crate::output::{draw, unusable};
use crate::scene::{self, Reading};

/// Plots a motion file or a run.
pub fn run(systems: Systems<'_>, arguments: PlotArguments) -> Result<ExitCode, Error> {
    let PlotArguments {
        input,
        goal,
        reading,
        out,
    } = arguments;
    check_ending(&out).map_err(unusable)?;
    let panels = if input.is_dir() && goal.is_some() {
        return Err(Error::usage(
            format!("`--goal` with the folder {}", input.display()),
            "a goal is plotted with a motion file",
        ));
    } else if input.join("metrics.jsonl").exists() {
        let records = read_metrics(&input, &mut |text| tell!("warning: {text}"))?;
        if records.is_empty() {
            let metrics = input.join("metrics.jsonl");
            return Err(Error::usage(
                format!("{} has no line that can be plotted", metrics.display()),
                "a run writes one every `train.log_every_steps` steps",
            ));
        }
        loss_panels(&records)
    } else if input.is_file() {
        let goal = goal
            .as_deref()
            .map(read_goal)
            .transpose()?
            .map(|(goal, _)| goal);
        let floor = goal.as_ref().map(scene::floor).unwrap_or_default();
        motion_panels(systems, &input, &Reading::of(&reading), &floor)?
    } else if input.join("config.toml").exists() || input.join("checkpoints").exists() {
        return Err(Error::usage(
            format!("the run {} has no metrics.jsonl to plot", input.display()),
            "training writes it; imported and merged runs have none",
        ));
    } else {
        let message = format!(
            "there is neither a motion file nor a run at {}",
            input.display()
        );
        let hint = "give a .npy file such as `kinegrad sample` writes, a .bvh file, or a folder \
                    such as runs/quickstart";
        return Err(Error::usage(message, hint));
    };
    draw(&panels, 2, (520, 250), &out)?;
    say!("{}", out.display());
    Ok(ExitCode::SUCCESS)
}

/// Panels of the motion in a file.
fn motion_panels(
    systems: Systems<'_>,
    path: &Path,
    reading: &Reading,
    floor: &Floor,
) -> Result<Vec<Panel>, Error> {
    let name = file_stem(path);
    let motion = Motion::read(systems, path, &reading.bvh)?;
    if let Motion::Array(array) = &motion {
        return Ok(known_panels(array, name, floor));
    }
    let figure = scene::of_motion(&motion, name, reading.fps)?;
    let body = body_panels(&figure, floor).into_iter();
    Ok(body.chain(scene::curve_panels(&figure)).collect())
}

/// The body along its path with the goal on the floor, and the curves of the representation.
fn known_panels(array: &MotionArray, name: String, floor: &Floor) -> Vec<Panel> {
    let representation = &*array.representation;
    let figure = scene::of(representation, &array.values, name);
    let body = figure.map(|figure| body_panels(&figure, floor));
    let fps = representation.fps();
    let curves = representation.curves(&array.values).into_iter();
    let curves = curves.map(|curves| {
        let series = curves.series.iter();
        let tracks = series.map(|(name, values)| (name.as_str(), values.clone()));
        Panel::over_time(curves.title.clone(), fps, tracks)
    });
    body.into_iter().flatten().chain(curves).collect()
}

fn loss_panels(records: &[Record]) -> Vec<Panel> {
    let panel = |title, names: &[&str]| {
        let curves = names.iter().map(|name| -> Series {
            let records = records.iter();
            let points = records.filter_map(|r| Some((r.step as f64, r.get(name)?)));
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
