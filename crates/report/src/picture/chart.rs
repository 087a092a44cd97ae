//! Drawing of a panel.

use std::error::Error;
use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::IntoTextStyle;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::axes::{bounds, can_be_drawn, equal_scale};
use super::heat::cells;
use super::legend::{KEYFRAME, OBSTACLE, THRESHOLD, colour, draw_head};
use super::panel::{Kind, Panel, Pose};

/// Margin around the plot and its axes, pixels.
const MARGIN: u32 = 8;

/// Height of the labels below the plot, pixels.
const X_LABELS: u32 = 34;

/// Width of the labels left of the plot in pixels, for numbers and for row names.
const Y_LABELS: u32 = 48;
const ROW_NAMES: u32 = 96;

/// Width of curves, pixels.
const STROKE: u32 = 2;

/// Width and height of the label of a pose, pixels.
const POSE_LABEL: (i32, i32) = (36, 11);

/// Colors of the first and the last pose.
const FIRST: [f64; 3] = [150.0, 190.0, 225.0];
const LAST: [f64; 3] = [10.0, 50.0, 110.0];

type Chart<'a, B> = ChartContext<'a, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

pub(super) fn draw_panel<B: DrawingBackend<ErrorType: 'static>>(
    panel: &Panel,
    area: &DrawingArea<B, Shift>,
) -> Result<(), Box<dyn Error>> {
    let area = &draw_head(panel, area)?;
    let panel = &panel.scaled();
    let left = match panel.kind {
        Kind::Strip { .. } => ROW_NAMES,
        _ => Y_LABELS,
    };
    let (width, height) = area.dim_in_pixel();
    let [width, height] = [(width, left), (height, X_LABELS)]
        .map(|(size, labels)| f64::from(size.saturating_sub(2 * MARGIN + labels).max(1)));
    let (x, y) = ranges(panel, width / height);
    let x = panel.across.clone().unwrap_or(x);
    let mut chart = ChartBuilder::on(area)
        .margin(MARGIN)
        .x_label_area_size(X_LABELS)
        .y_label_area_size(left)
        .build_cartesian_2d(x.clone(), y.clone())?;
    // Tick positions are sums of steps, so zero is inexact. A map has z downwards.
    let least = 1e-9 * (x.end - x.start).min(y.end - y.start);
    let near = |value: f64| if value.abs() < least { 0.0 } else { value };
    let downwards = |value: &f64| short(-near(*value));
    let upwards = |value: &f64| short(near(*value));
    let power = |value: &f64| magnitude(*value);
    let mut mesh = chart.configure_mesh();
    mesh.light_line_style(WHITE)
        .bold_line_style(BLACK.mix(0.1))
        .x_desc(panel.x_label)
        .x_label_formatter(&upwards)
        .x_labels(6)
        .y_labels(5);
    match panel.kind {
        Kind::Map(_) => mesh.y_label_formatter(&downwards),
        Kind::Strip { .. } => mesh.disable_y_mesh().y_labels(0),
        Kind::Lines(_) if panel.is_logarithmic => mesh.y_label_formatter(&power),
        _ => mesh.y_label_formatter(&upwards),
    };
    mesh.draw()?;
    match &panel.kind {
        Kind::Heat { rows, width } => {
            chart.draw_series(cells(rows, *width))?;
        }
        Kind::Strip { rows, .. } => draw_rows(&mut chart, area, rows)?,
        Kind::Poses(poses) => draw_poses(&mut chart, area, poses)?,
        Kind::Bars(bars) => {
            chart.draw_series(bars.iter().map(|(range, count)| {
                let corners = [(range.start, 0.0), (range.end, *count as f64)];
                Rectangle::new(corners, colour(0).mix(0.7).filled())
            }))?;
        }
        Kind::Lines(_) | Kind::Map(_) => {}
    }
    let lines = panel.thresholds.iter().filter(|line| y.contains(line));
    for &line in lines {
        let ends = [(x.start, line), (x.end, line)];
        chart.draw_series(DashedLineSeries::new(ends, 6, 4, THRESHOLD.stroke_width(1)))?;
    }
    for region in &panel.regions {
        chart.draw_series([Polygon::new(region.clone(), OBSTACLE.mix(0.25).filled())])?;
    }
    for (index, (_, points)) in panel.series().iter().enumerate() {
        let style = colour(index).stroke_width(STROKE);
        // A point that cannot be drawn interrupts the line.
        for line in points.split(|(x, y)| !(can_be_drawn(*x) && can_be_drawn(*y))) {
            match *line {
                // A line through one point is invisible.
                [point] => chart.draw_series([Circle::new(point, 3, style.filled())])?,
                _ => chart.draw_series(LineSeries::new(line.iter().copied(), style))?,
            };
        }
    }
    if let Kind::Map(_) = panel.kind {
        let start = panel.series().iter().find_map(|(_, points)| points.first());
        let start = start.filter(|(x, y)| can_be_drawn(*x) && can_be_drawn(*y));
        chart.draw_series(start.map(|&point| Circle::new(point, 4, BLACK.filled())))?;
        draw_points(&mut chart, area, &panel.points)?;
    }
    draw_marks(&chart, area, &panel.marks, &x)
}

/// Axis ranges of a plot with the aspect `ratio`, width to height.
fn ranges(panel: &Panel, ratio: f64) -> (Range<f64>, Range<f64>) {
    let across = || bounds(panel.places().map(|place| place.0));
    let up = || panel.up();
    match &panel.kind {
        Kind::Lines(_) => (across(), up()),
        Kind::Map(_) | Kind::Poses(_) => equal_scale(across(), up(), ratio),
        Kind::Heat { rows, width } => (0.0..width.max(1e-9), 0.0..rows.len().max(1) as f64),
        Kind::Strip { rows, width } => (0.0..width.max(1e-9), 0.0..rows.len().max(1) as f64),
        Kind::Bars(bars) => {
            let most = bars.iter().map(|(_, count)| *count).max().unwrap_or(1);
            let ends = bars.iter().flat_map(|(range, _)| [range.start, range.end]);
            (bounds(ends), 0.0..1.05 * most as f64)
        }
    }
}

/// The tick label of a decimal logarithm.
fn magnitude(logarithm: f64) -> String {
    let value = 10f64.powf(logarithm);
    let digits = 10f64.powi(1 - logarithm.floor().clamp(-300.0, 300.0) as i32);
    short((value * digits).round() / digits)
}

/// A tick label.
pub(super) fn short(value: f64) -> String {
    match value.abs() {
        size if size != 0.0 && !(1e-3..1e5).contains(&size) => format!("{value:.1e}"),
        // Tick positions are sums of steps and inexact.
        _ => match format!("{value:.4}")
            .trim_end_matches('0')
            .trim_end_matches('.')
        {
            "-0" => "0".into(),
            text => text.into(),
        },
    }
}

/// A bar for each range of a row, and the row name beside the plot.
fn draw_rows<B: DrawingBackend<ErrorType: 'static>>(
    chart: &mut Chart<'_, B>,
    area: &DrawingArea<B, Shift>,
    rows: &[(String, Vec<Range<f64>>)],
) -> Result<(), Box<dyn Error>> {
    for (row, (name, spans)) in rows.iter().enumerate() {
        let row = row as f64;
        chart.draw_series(spans.iter().map(|span| {
            let corners = [(span.start, row + 0.2), (span.end, row + 0.8)];
            Rectangle::new(corners, colour(0).mix(0.8).filled())
        }))?;
        let (x, y) = pixel(chart, area, (0.0, row + 0.5));
        let right = Pos::new(HPos::Right, VPos::Center);
        let style = ("sans-serif", 11).into_text_style(area).pos(right);
        area.draw_text(name, &style, (x - 8, y))?;
    }
    Ok(())
}

/// Bodies, darker over time, on a ground line.
fn draw_poses<B: DrawingBackend<ErrorType: 'static>>(
    chart: &mut Chart<'_, B>,
    area: &DrawingArea<B, Shift>,
    poses: &[Pose],
) -> Result<(), Box<dyn Error>> {
    let across = chart.x_range();
    let ground = vec![(across.start, 0.0), (across.end, 0.0)];
    chart.draw_series([PathElement::new(ground, BLACK.mix(0.4))])?;
    let last = poses.len().saturating_sub(1).max(1) as f64;
    let mut labels: Vec<(i32, i32)> = Vec::new();
    for (index, pose) in poses.iter().enumerate() {
        let late = index as f64 / last;
        let [r, g, b] = [0, 1, 2].map(|i| (FIRST[i] + late * (LAST[i] - FIRST[i])) as u8);
        let style = RGBColor(r, g, b).stroke_width(STROKE);
        let bones = pose.bones.iter();
        chart.draw_series(bones.map(|ends| PathElement::new(ends.to_vec(), style)))?;
        let joints = pose.joints.iter();
        chart.draw_series(joints.map(|place| Circle::new(*place, 2, style.filled())))?;
        let (x, mut y) = pixel(chart, area, pose.top);
        // Labels of poses at one place stand above one another.
        let (width, height) = POSE_LABEL;
        while labels
            .iter()
            .any(|at| (x - at.0).abs() < width && (y - at.1).abs() < height)
        {
            y -= 1;
        }
        labels.push((x, y));
        let above = Pos::new(HPos::Center, VPos::Bottom);
        let style = ("sans-serif", 10).into_text_style(area).pos(above);
        area.draw_text(&pose.label, &style, (x, y - 2))?;
    }
    Ok(())
}

/// Named dots.
fn draw_points<B: DrawingBackend<ErrorType: 'static>>(
    chart: &mut Chart<'_, B>,
    area: &DrawingArea<B, Shift>,
    points: &[(String, (f64, f64))],
) -> Result<(), Box<dyn Error>> {
    for (name, point) in points {
        chart.draw_series([Circle::new(*point, 4, KEYFRAME.filled())])?;
        let (x, y) = pixel(chart, area, *point);
        let style = ("sans-serif", 10).into_text_style(area).color(&KEYFRAME);
        area.draw_text(name, &style, (x + 6, y - 12))?;
    }
    Ok(())
}

/// Ticks above the plot.
fn draw_marks<B: DrawingBackend<ErrorType: 'static>>(
    chart: &Chart<'_, B>,
    area: &DrawingArea<B, Shift>,
    marks: &[f64],
    across: &Range<f64>,
) -> Result<(), Box<dyn Error>> {
    let top = chart.y_range().end;
    for &mark in marks.iter().filter(|mark| across.contains(mark)) {
        let (x, y) = pixel(chart, area, (mark, top));
        let ends = vec![(x, y - 6), (x, y - 1)];
        area.draw(&PathElement::new(ends, RED.mix(0.5)))?;
    }
    Ok(())
}

/// Pixel in `area` of a point of the plot.
fn pixel<B: DrawingBackend>(
    chart: &Chart<'_, B>,
    area: &DrawingArea<B, Shift>,
    place: (f64, f64),
) -> (i32, i32) {
    let (x, y) = chart.plotting_area().map_coordinate(&place);
    let (left, top) = area.get_base_pixel();
    (x - left, y - top)
}
