//! `kinegrad plot`

use std::path::Path;
use std::process::ExitCode;

use kinegrad_data::read_array;
use kinegrad_motion::Representation;
use kinegrad_motion::goal::{Goal, Obstacle};
use kinegrad_report::scene::Floor;
use kinegrad_report::{Panel, Series, body_panels, check_ending};
use kinegrad_train::Error;
use kinegrad_train::systems::Systems;
use kinegrad_train::systems::gmd::read_goal;
use kinegrad_train::telemetry::{Record, read_metrics};

use crate::args::PlotArguments;
use crate::output::{draw, unusable};
use crate::scene;

/// Plots a motion file or a run.
pub fn run(systems: Systems<'_>, arguments: PlotArguments) -> Result<ExitCode, Error> {
    let PlotArguments { input, goal, out } = arguments;
    check_ending(&out).map_err(unusable)?;
    let panels = if input.is_dir() && goal.is_some() {
        return Err(Error::usage(
            format!("`--goal` with the folder {}", input.display()),
            "a goal is drawn below a motion file",
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
        let goal = goal.as_deref().map(read_goal).transpose()?;
        let array = read_array(&input)?;
        let representation = systems.representation_of(&input, &array.shape, &array.values)?;
        motion_panels(&input, &*representation, &array.values, goal.as_ref())
    } else if input.join("config.toml").exists() || input.join("checkpoints").exists() {
        return Err(Error::usage(
            format!("the run {} has no metrics.jsonl to plot", input.display()),
            "training writes it; runs that were imported or merged have none",
        ));
    } else {
        let message = format!(
            "there is neither a motion file nor a run at {}",
            input.display()
        );
        let hint = "give a .npy file such as `kinegrad sample` writes, or a folder such as \
                    runs/quickstart";
        return Err(Error::usage(message, hint));
    };
    draw(&panels, 2, (520, 250), &out)?;
    say!("{}", out.display());
    Ok(ExitCode::SUCCESS)
}

/// The body along its path with the goal on the floor, and what the representation says is worth
/// drawing.
fn motion_panels(
    path: &Path,
    representation: &dyn Representation,
    rows: &[f32],
    goal: Option<&Goal>,
) -> Vec<Panel> {
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let figure = scene::of(representation, rows, name.to_string());
    let floor = goal.map(floor).unwrap_or_default();
    let body = figure.map(|figure| body_panels(&figure, &floor));
    let fps = representation.fps();
    let curves = representation.curves(rows).into_iter().map(|curves| {
        let series = curves.series.iter();
        let tracks = series.map(|(name, values)| (name.as_str(), values.clone()));
        Panel::over_time(curves.title.clone(), fps, tracks)
    });
    body.into_iter().flatten().chain(curves).collect()
}

/// What a goal puts on the floor.
fn floor(goal: &Goal) -> Floor {
    let near = |[x, z]: [f64; 2]| [x as f32, z as f32];
    let keyframes = goal.keyframes.iter();
    let path = goal.trajectory.iter().flat_map(|path| &path.points);
    let mut floor = Floor {
        path: path.map(|&point| near(point)).collect(),
        keyframes: keyframes
            .map(|keyframe| (keyframe.frame, near(keyframe.position())))
            .collect(),
        ..Floor::default()
    };
    for obstacle in &goal.obstacles {
        match obstacle {
            &Obstacle::Disc { x, z, radius } => {
                floor.obstacles.push((near([x, z]), radius as f32));
            }
            Obstacle::Polygon { vertices } => {
                let corners = vertices.iter().map(|&vertex| near(vertex));
                floor.polygons.push(corners.collect());
            }
        }
    }
    floor
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
