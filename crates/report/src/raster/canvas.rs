//! Pictures, and paths on them.

use ab_glyph::{Font, OutlineCurve};
use tiny_skia::{
    FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, StrokeDash, Transform,
};

use crate::drawing::{Color, View};
use crate::font;

/// A picture in memory.
#[derive(Clone, Debug, Eq, PartialEq)]
pub(crate) struct Image {
    pub width: u32,
    pub height: u32,
    /// Red, green and blue of each pixel, row by row from the top, `[height, width, 3]`.
    pub rgb: Vec<u8>,
}

impl Image {
    /// A picture of one color.
    pub(crate) fn filled(width: u32, height: u32, color: [u8; 3]) -> Self {
        let rgb = color.repeat(width as usize * height as usize);
        Self { width, height, rgb }
    }

    /// The picture as a PNG file.
    pub fn png(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width, self.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let writer = encoder.write_header();
        let written = writer.and_then(|mut writer| writer.write_image_data(&self.rgb));
        written.expect("written to memory");
        bytes
    }

    /// Copies a canvas to `[x, y]`, as far as it lies within.
    pub(super) fn paste(&mut self, part: &Canvas, [x, y]: [u32; 2]) {
        let columns = part.0.width().min(self.width.saturating_sub(x)) as usize;
        let rows = part.0.height().min(self.height.saturating_sub(y)) as usize;
        let lines = part.0.pixels().chunks_exact(part.0.width() as usize);
        for (line, pixels) in lines.take(rows).enumerate() {
            let to = 3 * ((y as usize + line) * self.width as usize + x as usize);
            let row = self.rgb[to..to + 3 * columns].chunks_exact_mut(3);
            for (value, pixel) in row.zip(pixels) {
                value.copy_from_slice(&[pixel.red(), pixel.green(), pixel.blue()]);
            }
        }
    }
}

/// How a path is drawn: its color with an opacity.
#[derive(Clone, Copy)]
pub(super) struct Ink(pub Color, pub f64);

impl From<Color> for Ink {
    fn from(color: Color) -> Self {
        Self(color, 1.0)
    }
}

/// Ends and corners of lines.
#[derive(Clone, Copy)]
pub(super) enum Ends {
    Butt,
    /// Butt ends and round corners.
    Bent,
    Round,
}

/// An opaque picture that paths are drawn on.
#[derive(Clone)]
pub(super) struct Canvas(Pixmap);

impl Canvas {
    /// A picture of one color.
    pub fn filled([width, height]: [u32; 2], color: Color) -> Self {
        let mut pixmap = Pixmap::new(width, height).expect("a pane has pixels");
        let [r, g, b] = color.0;
        pixmap.fill(tiny_skia::Color::from_rgba8(r, g, b, 255));
        Self(pixmap)
    }

    /// Fills a path.
    pub fn fill(&mut self, path: Option<&Path>, ink: impl Into<Ink>) {
        if let Some(path) = path {
            let (rule, place) = (FillRule::Winding, Transform::identity());
            self.0
                .fill_path(path, &paint(ink.into()), rule, place, None);
        }
    }

    /// Draws a path as a line of `width` pixels.
    pub fn stroke(&mut self, path: Option<&Path>, width: f64, ends: Ends, ink: impl Into<Ink>) {
        self.dashed(path, width, ends, None, ink);
    }

    /// Draws a path as a line of `width` pixels with `dash`, lengths of line and gap in pixels.
    pub fn dashed(
        &mut self,
        path: Option<&Path>,
        width: f64,
        ends: Ends,
        dash: Option<[f64; 2]>,
        ink: impl Into<Ink>,
    ) {
        let Some(path) = path else { return };
        let dash = dash.map(|dash| dash.map(|part| part as f32).to_vec());
        let stroke = Stroke {
            width: width as f32,
            line_cap: match ends {
                Ends::Round => LineCap::Round,
                Ends::Butt | Ends::Bent => LineCap::Butt,
            },
            line_join: match ends {
                Ends::Butt => LineJoin::Miter,
                Ends::Bent | Ends::Round => LineJoin::Round,
            },
            dash: dash.and_then(|dash| StrokeDash::new(dash, 0.0)),
            ..Stroke::default()
        };
        let place = Transform::identity();
        self.0
            .stroke_path(path, &paint(ink.into()), &stroke, place, None);
    }

    /// Writes a line of text with its left end and baseline at `at`, at most `most` pixels wide.
    pub fn text(&mut self, text: &str, at: [f64; 2], size: f64, most: f64, color: Color) {
        let line = font::fitting(text, size as f32, most as f32);
        let mut builder = PathBuilder::new();
        for (glyph, start) in font::line(&line, size as f32) {
            let Some(outline) = font::font().outline(glyph) else {
                continue;
            };
            let scale = font::pixels_per_unit(size as f32);
            let place = |point: ab_glyph::Point| {
                let x = at[0] as f32 + start + scale * point.x;
                (x, at[1] as f32 - scale * point.y)
            };
            let mut end = None;
            for curve in outline.curves {
                let (from, to) = match curve {
                    OutlineCurve::Line(a, b) => (place(a), place(b)),
                    OutlineCurve::Quad(a, _, b) => (place(a), place(b)),
                    OutlineCurve::Cubic(a, _, _, b) => (place(a), place(b)),
                };
                if end != Some(from) {
                    builder.move_to(from.0, from.1);
                }
                match curve {
                    OutlineCurve::Line(..) => builder.line_to(to.0, to.1),
                    OutlineCurve::Quad(_, by, _) => {
                        let by = place(by);
                        builder.quad_to(by.0, by.1, to.0, to.1);
                    }
                    OutlineCurve::Cubic(_, by, then, _) => {
                        let (by, then) = (place(by), place(then));
                        builder.cubic_to(by.0, by.1, then.0, then.1, to.0, to.1);
                    }
                }
                end = Some(to);
            }
        }
        self.fill(builder.finish().as_ref(), color);
    }
}

fn paint(Ink(color, opacity): Ink) -> Paint<'static> {
    let mut paint = Paint::default();
    let [r, g, b] = color.0;
    paint.set_color_rgba8(r, g, b, (255.0 * opacity).round() as u8);
    paint.anti_alias = true;
    paint
}

/// A circle in pixels.
pub(super) fn circle([x, y]: [f64; 2], radius: f64) -> Option<Path> {
    PathBuilder::from_circle(x as f32, y as f32, radius as f32)
}

/// An upright rectangle in pixels.
pub(super) fn rectangle([x, y]: [f64; 2], [width, height]: [f64; 2]) -> Option<Path> {
    let corner = tiny_skia::Rect::from_xywh(x as f32, y as f32, width as f32, height as f32);
    corner.map(PathBuilder::from_rect)
}

/// A line between two pixels.
pub(super) fn segment([from, to]: [[f64; 2]; 2]) -> Option<Path> {
    let mut builder = PathBuilder::new();
    builder.move_to(from[0] as f32, from[1] as f32);
    builder.line_to(to[0] as f32, to[1] as f32);
    builder.finish()
}

/// Lines in space, each cut at the near plane, as one path.
pub(super) fn lines<L: IntoIterator<Item = [f64; 3]>>(
    view: &View,
    lines: impl IntoIterator<Item = L>,
) -> Option<Path> {
    let mut builder = PathBuilder::new();
    for line in lines {
        let mut before: Option<[f64; 3]> = None;
        let mut is_down = false;
        for point in line {
            let now = view.seen(point);
            if let Some(before) = before {
                let shown = [before, now].map(|place| view.shows(place));
                if shown.contains(&true) {
                    let from = if shown[0] {
                        before
                    } else {
                        view.clipped(before, now)
                    };
                    let to = if shown[1] {
                        now
                    } else {
                        view.clipped(before, now)
                    };
                    let [from, to] =
                        [from, to].map(|place| view.on_screen(place).map(|v| v as f32));
                    if !is_down {
                        builder.move_to(from[0], from[1]);
                    }
                    builder.line_to(to[0], to[1]);
                    is_down = shown[1];
                }
            }
            before = Some(now);
        }
    }
    builder.finish()
}

/// The part of a polygon before the near plane.
pub(super) fn area(view: &View, points: impl IntoIterator<Item = [f64; 3]>) -> Option<Path> {
    let places: Vec<[f64; 3]> = points.into_iter().map(|point| view.seen(point)).collect();
    let mut builder = PathBuilder::new();
    let mut add = |place: [f64; 3]| {
        let [x, y] = view.on_screen(place).map(|value| value as f32);
        match builder.is_empty() {
            true => builder.move_to(x, y),
            false => builder.line_to(x, y),
        }
    };
    for (index, &now) in places.iter().enumerate() {
        let before = places[(index + places.len() - 1) % places.len()];
        if view.shows(before) != view.shows(now) {
            add(view.clipped(before, now));
        }
        if view.shows(now) {
            add(now);
        }
    }
    builder.close();
    builder.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::{BLACK, WHITE};

    /// Total coverage in pixels.
    fn ink(canvas: &Canvas) -> f64 {
        let pixels = canvas.0.pixels().iter();
        pixels
            .map(|pixel| 1.0 - f64::from(pixel.red()) / 255.0)
            .sum()
    }

    #[test]
    fn lines_end_before_the_camera() {
        let view = View::new([0.0, 1.0, 0.0], 5.0, [200, 200]);
        let target = [0.0, 1.0, 0.0];
        let behind = view.eye_to(target).map(|value| -2.0 * value);
        assert!(!view.shows(view.seen(behind)));
        let path = lines(&view, [[target, behind]]).expect("a part is before the camera");
        assert!(path.bounds().width().is_finite());
        assert!(lines(&view, [[behind, behind]]).is_none());
        let mut canvas = Canvas::filled([200, 200], WHITE);
        canvas.fill(
            area(&view, [target, [1.0, 1.0, 0.0], behind]).as_ref(),
            BLACK,
        );
        assert!(ink(&canvas) > 100.0);
    }

    #[test]
    fn a_path_is_covered_once() {
        let mut canvas = Canvas::filled([100, 100], WHITE);
        let mut builder = PathBuilder::new();
        for end in [80.0, 20.0, 80.0] {
            builder.move_to(50.0, 50.0);
            builder.line_to(end, 50.0);
        }
        canvas.stroke(builder.finish().as_ref(), 10.0, Ends::Butt, Ink(BLACK, 0.5));
        assert!((ink(&canvas) - 300.0).abs() < 3.0, "{}", ink(&canvas));
    }

    #[test]
    fn a_long_name_ends_in_dots() {
        let width = |text: &str, most: f64| {
            let mut canvas = Canvas::filled([200, 30], WHITE);
            canvas.text(text, [5.0, 20.0], 12.0, most, BLACK);
            let inked = |x: &u32| (0..30).any(|y| canvas.0.pixel(*x, y).unwrap().red() < 200);
            (0..200).rev().find(inked).unwrap_or(0)
        };
        assert!(width("name", 190.0) < 40);
        let long = width("a very long name that is wider than its pane", 100.0);
        assert!((90..=105).contains(&long), "{long}");
    }
}
