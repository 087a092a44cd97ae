//! `kinegrad plot`

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_motion::SanityThresholds;
use kinegrad_report::scene::Floor;
use kinegrad_report::{Panel, body_panels, check_ending};
use kinegrad_train::clips::read_goal;
use kinegrad_train::run::load_config;
use kinegrad_train::telemetry::{Record, read_metrics};
use kinegrad_train::{Error, Systems};

use super::check::thresholds as read_thresholds;
use super::report::curves::{Metrics, charts};
use super::report::terms::term_charts;
use crate::args::PlotArguments;
use crate::io::{Motion, MotionArray, file_stem, must_be_new};
use crate::output::{draw, unusable};
use crate::runs::{folder_name, labels};
use crate::scene::{self, Reading};

/// Plots a motion file or runs.
pub fn run(systems: Systems<'_>, arguments: PlotArguments) -> Result<ExitCode, Error> {
    let PlotArguments {
        inputs,
        schedule,
        goal,
        terms,
        thresholds,
        reading,
        out,
        overwrite,
    } = arguments;
    check_ending(&out).map_err(unusable)?;
    must_be_new([&out], &inputs, overwrite, "--out")?;
    if schedule {
        let panels = inputs.iter().map(|input| schedule_panels(systems, input));
        let panels = panels.collect::<Result<Vec<_>, Error>>()?.concat();
        return write(&panels, 2, &out);
    }
    let folder = inputs.iter().find(|input| input.is_dir());
    if let (Some(folder), Some(file)) = (folder, &thresholds) {
        return Err(Error::usage(
            format!(
                "`--thresholds {}` with the folder {}",
                file.display(),
                folder.display()
            ),
            "thresholds belong to the plot of a motion: give a motion file, or leave them out",
        ));
    }
    let panels = match (&inputs[..], goal, folder) {
        ([input], ..) if terms && input.is_file() => {
            return Err(Error::usage(
                format!("`--terms` with the file {}", input.display()),
                "terms of the loss are those of a run: give its folder",
            ));
        }
        (_, Some(_), Some(folder)) => {
            return Err(Error::usage(
                format!("`--goal` with the folder {}", folder.display()),
                "a goal is plotted with a motion file",
            ));
        }
        ([input], goal, _) if input.is_file() => {
            let goal = goal.as_deref().map(read_goal).transpose()?;
            let thresholds = thresholds.as_deref().map(read_thresholds).transpose()?;
            let floor = goal.map(|(goal, _)| scene::floor(&goal));
            motion_panels(
                systems,
                input,
                &Reading::of(&reading),
                &floor.unwrap_or_default(),
                &thresholds.unwrap_or_default(),
            )?
        }
        _ => run_panels(&inputs, terms)?,
    };
    let columns = if terms { 3 } else { 2 };
    write(&panels, columns, &out)
}

fn write(panels: &[Panel], columns: usize, out: &Path) -> Result<ExitCode, Error> {
    draw(panels, columns, (520, 250), out)?;
    say!("{}", out.display());
    Ok(ExitCode::SUCCESS)
}

/// The noise schedule of a config file, or of a run's config.
fn schedule_panels(systems: Systems<'_>, input: &Path) -> Result<Vec<Panel>, Error> {
    let file = match input.is_dir() {
        true => input.join("config.toml"),
        false => input.to_path_buf(),
    };
    let (config, _) = load_config(systems, &file, &[], &[], &mut |missing| {
        tell!("warning: {missing}; its process is not shown");
    })?;
    let Some(schedule) = config.noise_schedule()? else {
        let message = format!("{} has no diffusion process", file.display());
        let hint = "give a config or a run with the table `diffusion`";
        return Err(Error::usage(message, hint));
    };
    let name = &config.run.name;
    let series = |name: &str, values: &[f64]| {
        let values = values.iter().enumerate();
        let points = values.map(|(t, value)| (t as f64, *value));
        (name.to_owned(), points.collect())
    };
    let shares = schedule.output_shares();
    Ok(vec![
        Panel::lines(
            format!("{name}: factors in x_t"),
            "timestep",
            vec![
                series("motion", &schedule.sqrt_alphas_cumprod),
                series("noise", &schedule.sqrt_one_minus_alphas_cumprod),
            ],
        ),
        Panel::lines(
            format!("{name}: share of the output in a step's mean"),
            "timestep",
            vec![
                series("sample", &shares.sample),
                series("epsilon", &shares.epsilon),
            ],
        ),
    ])
}

/// Panels of the motion in a file.
fn motion_panels(
    systems: Systems<'_>,
    path: &Path,
    reading: &Reading,
    floor: &Floor,
    thresholds: &SanityThresholds,
) -> Result<Vec<Panel>, Error> {
    let name = file_stem(path);
    let motion = Motion::read(systems, path, &reading.bvh)?;
    if let Motion::Array(array) = &motion {
        return Ok(known_panels(array, name, floor, thresholds));
    }
    let figure = scene::of_motion(&motion, name)?;
    let body = body_panels(&figure, floor).into_iter();
    Ok(body.chain(scene::curve_panels(&figure)).collect())
}

/// The body along its path with the goal on the floor, and the curves of the representation with the
/// thresholds of their checks.
fn known_panels(
    array: &MotionArray,
    name: String,
    floor: &Floor,
    thresholds: &SanityThresholds,
) -> Vec<Panel> {
    let representation = &*array.representation;
    let figure = scene::of(representation, &array.values, name);
    let body = figure.map(|figure| body_panels(&figure, floor));
    let fps = representation.fps();
    let curves = representation.curves(&array.values).into_iter();
    let curves = curves.map(|curves| {
        let series = curves.series.iter();
        let tracks = series.map(|(name, values)| (name.as_str(), values.clone()));
        let lines = curves.check.map(|check| thresholds.of_check(check));
        let panel = Panel::over_time(curves.title.clone(), fps, tracks);
        panel.with_thresholds(&lines.unwrap_or_default())
    });
    body.into_iter().flatten().chain(curves).collect()
}

/// The curves of the runs in `folders`, or those of the terms of their losses.
fn run_panels(folders: &[PathBuf], terms: bool) -> Result<Vec<Panel>, Error> {
    let records = folders.iter().map(|folder| metrics(folder));
    let records = records.collect::<Result<Vec<_>, Error>>()?;
    let names = folders.iter().map(|folder| folder_name(folder)).collect();
    let names = labels(names, folders);
    let runs = names.iter().zip(&records);
    let runs: Vec<Metrics<'_>> = runs.map(|(name, records)| (&**name, &**records)).collect();
    Ok(match terms {
        true => term_charts(&runs),
        false => charts(&runs),
    })
}

/// The metrics of a run. Fails if there are none.
fn metrics(folder: &Path) -> Result<Vec<Record>, Error> {
    let shown = folder.display();
    if folder.join("metrics.jsonl").exists() {
        let records = read_metrics(folder, &mut |text| tell!("warning: {text}"))?;
        if !records.is_empty() {
            return Ok(records);
        }
        let metrics = folder.join("metrics.jsonl");
        return Err(Error::usage(
            format!("{} has no line that can be plotted", metrics.display()),
            "a run writes one every `train.log_every_steps` steps",
        ));
    }
    Err(if folder.is_file() {
        Error::usage(
            format!("{shown} is not a run"),
            "several runs are plotted together, motion files one at a time; `kinegrad view` shows \
             several motions side by side",
        )
    } else if folder.join("config.toml").exists() || folder.join("checkpoints").exists() {
        Error::usage(
            format!("the run {shown} has no metrics.jsonl to plot"),
            "training writes it; imported and merged runs have none",
        )
    } else {
        Error::usage(
            format!("there is neither a motion file nor a run at {shown}"),
            "give a .npy file such as `kinegrad sample` writes, a .bvh file, or a folder such as \
             runs/quickstart",
        )
    })
}
