//! `kinegrad plot`

use std::process::ExitCode;

use kinegrad_data::read_array;
use kinegrad_motion::Representation;
use kinegrad_report::{Panel, Series, check_ending};
use kinegrad_train::Error;
use kinegrad_train::systems::Systems;
use kinegrad_train::telemetry::{Record, read_metrics};

use crate::args::PlotArguments;
use crate::output::{draw, unusable};

/// Plots a motion file or a run.
pub fn run(systems: Systems<'_>, arguments: PlotArguments) -> Result<ExitCode, Error> {
    let PlotArguments { input, out } = arguments;
    check_ending(&out).map_err(unusable)?;
    let panels = if input.join("metrics.jsonl").exists() {
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
        let array = read_array(&input)?;
        let representation = systems.representation_of(&input, &array.shape, &array.values)?;
        motion_panels(&*representation, &array.values)
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

/// The path of the root seen from above, and what the representation says is worth drawing.
fn motion_panels(representation: &dyn Representation, rows: &[f32]) -> Vec<Panel> {
    let path = representation.joints(rows).map(|joints| {
        // With +z, towards the viewer, downwards.
        let root = (0..joints.frames()).map(|t| joints.frame(t)[0]);
        let above = root.map(|[x, _, z]| (x, -z)).collect();
        let series = vec![("path".to_string(), above)];
        Panel::map("path from above (m; x right, z down)", "m", series)
    });
    let fps = representation.fps();
    let curves = representation.curves(rows).into_iter().map(|curves| {
        let series = curves.series.iter();
        let tracks = series.map(|(name, values)| (name.as_str(), values.clone()));
        Panel::over_time(curves.title.clone(), fps, tracks)
    });
    path.into_iter().chain(curves).collect()
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
