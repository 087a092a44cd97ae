//! `kinegrad plot`

use std::error::Error;
use std::ops::Range;
use std::path::Path;
use std::process::ExitCode;

use kinegrad_data::read_motion;
use kinegrad_motion::kinematics::jerk;
use kinegrad_motion::phrase::{
    ACCELERATION, ANGULAR_VELOCITY, PHASE, POSITION, QUATERNION, STYLE, VELOCITY,
};
use kinegrad_motion::rotation::length;
use kinegrad_motion::{FPS, Motion};
use kinegrad_train::telemetry::{Record, read_metrics};
use plotters::coord::Shift;
use plotters::prelude::*;

use crate::args::PlotArguments;
use crate::failure::{Failure, UsageError};

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// A named curve.
type Series = (String, Vec<(f64, f64)>);

/// Draws a motion file or a run.
pub fn run(arguments: PlotArguments) -> Result<ExitCode, Failure> {
    let PlotArguments { input, out } = arguments;
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
    draw(&panels, &out).map_err(|error| {
        let message = format!("cannot draw {}: {error}", out.display());
        UsageError::new(message, "check that its folder exists and can be written")
    })?;
    println!("{}", out.display());
    Ok(ExitCode::SUCCESS)
}

/// One chart.
struct Panel {
    title: &'static str,
    x_label: &'static str,
    series: Vec<Series>,
    /// One metre is as long to the right as upwards, and a mark stands at the start.
    is_map: bool,
}

impl Panel {
    fn over_time(title: &'static str, series: Vec<Series>) -> Self {
        Self {
            title,
            x_label: "s",
            series,
            is_map: false,
        }
    }
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
        Panel {
            title: "path from above (m; x right, z down)",
            x_label: "m",
            series: vec![("path".into(), path)],
            is_map: true,
        },
        Panel::over_time("position (m)", channels(POSITION, &xyz)),
        Panel::over_time("velocity (m/s)", channels(VELOCITY, &xyz)),
        Panel::over_time("acceleration (m/s²)", channels(ACCELERATION, &xyz)),
        Panel::over_time("quaternion", channels(QUATERNION, &["w", "x", "y", "z"])),
        Panel::over_time("angular velocity (rad/s)", channels(ANGULAR_VELOCITY, &xyz)),
        Panel::over_time("phase", channels(PHASE..PHASE + 1, &["phase"])),
        Panel::over_time(
            "style",
            channels(STYLE, &["0", "1", "2", "3", "4", "5", "6", "7"]),
        ),
        Panel::over_time("quaternion norm", vec![norm]),
        Panel::over_time("jerk (m/s³)", vec![("|jerk|".into(), jerk)]),
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
    let panel = |title, series| Panel {
        title,
        x_label: "step",
        series,
        is_map: false,
    };
    vec![
        panel("loss", losses),
        panel("gradient norm", vec![curve("grad_norm")]),
        panel("learning rate", vec![curve("lr")]),
    ]
}

fn draw(panels: &[Panel], out: &Path) -> Result<(), Box<dyn Error>> {
    let columns = 2.min(panels.len());
    let rows = panels.len().div_ceil(columns);
    let size = (520 * columns as u32, 250 * rows as u32);
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE)?;
        for (panel, area) in panels.iter().zip(root.split_evenly((rows, columns))) {
            draw_panel(panel, &area)?;
        }
        root.present()?;
    }
    std::fs::write(out, svg)?;
    Ok(())
}

fn draw_panel(panel: &Panel, area: &Area<'_>) -> Result<(), Box<dyn Error>> {
    let points = || {
        let all = panel.series.iter().flat_map(|(_, points)| points);
        all.filter(|(x, y)| x.is_finite() && y.is_finite())
    };
    let mut x = bounds(points().map(|p| p.0));
    let mut y = bounds(points().map(|p| p.1));
    if panel.is_map {
        let (width, height) = area.dim_in_pixel();
        (x, y) = equal_scale(x, y, f64::from(width) / f64::from(height));
    }
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .caption(panel.title, ("sans-serif", 14))
        .x_label_area_size(26)
        .y_label_area_size(48)
        .build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(BLACK.mix(0.1))
        .x_desc(panel.x_label)
        .x_labels(6)
        .y_labels(5)
        .draw()?;
    for (index, (name, points)) in panel.series.iter().enumerate() {
        let style = Palette99::pick(index).stroke_width(2);
        let key = Palette99::pick(index).stroke_width(2);
        let finite = points
            .iter()
            .copied()
            .filter(|(x, y)| x.is_finite() && y.is_finite());
        chart
            .draw_series(LineSeries::new(finite, style))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 12, y)], key));
    }
    if panel.is_map {
        let start = points().next().copied();
        let mark = start.map(|point| Circle::new(point, 4, BLACK.filled()));
        chart
            .draw_series(mark)?
            .label("start")
            .legend(|(x, y)| Circle::new((x + 6, y), 4, BLACK.filled()));
    }
    if panel.series.len() > 1 || panel.is_map {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.7))
            .label_font(("sans-serif", 10))
            .draw()?;
    }
    Ok(())
}

/// The range of the values with a small margin; never empty.
fn bounds(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
        (l.min(v), h.max(v))
    });
    if low > high {
        return 0.0..1.0;
    }
    // Rounding noise around a constant is not worth filling the panel with.
    let margin = (0.05 * (high - low)).max(1e-3 * high.abs().max(low.abs()).max(1e-6));
    low - margin..high + margin
}

/// Widens one of the ranges so that both have the scale of a `ratio` wide to high area.
fn equal_scale(x: Range<f64>, y: Range<f64>, ratio: f64) -> (Range<f64>, Range<f64>) {
    let (width, height) = (x.end - x.start, y.end - y.start);
    let widen = |range: Range<f64>, to: f64| {
        let middle = (range.start + range.end) / 2.0;
        middle - to / 2.0..middle + to / 2.0
    };
    if width / height < ratio {
        (widen(x, height * ratio), y)
    } else {
        (x, widen(y, width / ratio))
    }
}
