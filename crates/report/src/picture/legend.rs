//! Titles and legends, above the plot.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::IntoTextStyle;

use super::chart::short;
use super::panel::{Kind, Panel};

/// Height of the title's line, pixels.
const TITLE: i32 = 24;

/// Height of a line of names, pixels.
const LINE: i32 = 15;

/// Length of the stroke before a name, pixels.
const STROKE: i32 = 12;

/// Distance from the edges of the panel, pixels.
const MARGIN: i32 = 10;

/// Color of key frames and obstacles.
pub(super) const KEYFRAME: RGBColor = RGBColor(200, 90, 0);
pub(super) const OBSTACLE: RGBColor = RGBColor(170, 40, 40);

/// Color of thresholds.
pub(super) const THRESHOLD: RGBColor = RGBColor(200, 30, 30);

/// Colors of curves on white.
const COLOURS: [RGBColor; 8] = [
    RGBColor(47, 111, 237),
    RGBColor(228, 87, 46),
    RGBColor(23, 150, 91),
    RGBColor(142, 78, 198),
    RGBColor(201, 130, 10),
    RGBColor(13, 155, 181),
    RGBColor(214, 51, 108),
    RGBColor(107, 114, 128),
];

/// Color of a curve.
pub(super) fn colour(index: usize) -> RGBColor {
    COLOURS[index % COLOURS.len()]
}

/// Symbol of a legend entry.
#[derive(Clone, Copy)]
enum Look {
    Line(RGBAColor),
    Dot(RGBColor),
    Area(RGBColor),
}

/// Draws title and legend at the top of `area`; returns the rest.
pub(super) fn draw_head<B: DrawingBackend<ErrorType: 'static>>(
    panel: &Panel,
    area: &DrawingArea<B, Shift>,
) -> Result<DrawingArea<B, Shift>, Box<dyn std::error::Error>> {
    let font = |size: i32| ("sans-serif", size).into_text_style(area);
    let names = font(11);
    let wide = area.dim_in_pixel().0 as i32;
    let mut places = Vec::new();
    let (mut x, mut line) = (MARGIN, 0);
    let thresholds = thresholds(panel);
    let line_of_thresholds = Look::Line(THRESHOLD.to_rgba());
    let thresholds = thresholds.as_deref().map(|name| (line_of_thresholds, name));
    for (look, name) in entries(panel).into_iter().chain(thresholds) {
        let (width, _) = area.estimate_text_size(name, &names)?;
        let width = STROKE + 4 + width as i32 + 12;
        if x > MARGIN && x + width > wide - MARGIN {
            (x, line) = (MARGIN, line + 1);
        }
        places.push((x, TITLE + line * LINE, look, name));
        x += width;
    }
    let lines = if places.is_empty() { 0 } else { line + 1 };
    let (head, body) = area.split_vertically(TITLE + lines * LINE);
    head.draw_text(&panel.title, &font(14), (MARGIN, 6))?;
    for (x, y, look, name) in places {
        let middle = y + LINE / 2;
        match look {
            Look::Line(color) => {
                let ends = vec![(x, middle), (x + STROKE, middle)];
                head.draw(&PathElement::new(ends, color.stroke_width(2)))?;
            }
            Look::Dot(color) => {
                head.draw(&Circle::new((x + STROKE / 2, middle), 4, color.filled()))?;
            }
            Look::Area(color) => {
                let corners = [(x, middle - 4), (x + STROKE, middle + 4)];
                head.draw(&Rectangle::new(corners, color.mix(0.25).filled()))?;
            }
        }
        head.draw_text(name, &names, (x + STROKE + 4, y + 1))?;
    }
    Ok(body)
}

/// The legend's entry of the thresholds.
fn thresholds(panel: &Panel) -> Option<String> {
    let values: Vec<String> = panel.thresholds.iter().map(|value| short(*value)).collect();
    let name = match values.len() {
        0 => return None,
        1 => "threshold",
        _ => "thresholds",
    };
    Some(format!("{name} {}", values.join(", ")))
}

fn entries(panel: &Panel) -> Vec<(Look, &str)> {
    let is_map = matches!(panel.kind, Kind::Map(_));
    let series = panel.series();
    let mut entries = Vec::new();
    if series.len() > 1 || is_map {
        let lines = series.iter().enumerate();
        let of = |index| Look::Line(colour(index).to_rgba());
        entries.extend(lines.map(|(index, (name, _))| (of(index), name.as_str())));
    }
    if is_map && !series.is_empty() {
        entries.push((Look::Dot(BLACK), "start"));
    }
    if !panel.points.is_empty() {
        entries.push((Look::Dot(KEYFRAME), "key frames"));
    }
    if !panel.regions.is_empty() {
        entries.push((Look::Area(OBSTACLE), "obstacles"));
    }
    entries
}
