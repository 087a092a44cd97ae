//! Charts in a grid, as SVG or PNG by the file's ending.

use std::error::Error;
use std::ops::Range;
use std::path::{Path, PathBuf};

use miette::Diagnostic;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};

/// Most cells of a heat map along each axis: what a panel has pixels for.
const HEAT_CELLS: (usize, usize) = (480, 64);

/// Why there is no picture.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum PictureError {
    /// A file name that ends as no picture's does.
    #[error("`{}`: ending `{ending}` found", path.display())]
    #[diagnostic(help("pictures are .svg or .png"))]
    Ending {
        /// The file.
        path: PathBuf,
        /// Its ending.
        ending: String,
    },
    /// It cannot be drawn or written.
    #[error("cannot draw {}: {reason}", path.display())]
    #[diagnostic(help("check that its folder exists and can be written"))]
    Drawing {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        reason: String,
    },
}

/// A named curve.
pub type Series = (String, Vec<(f64, f64)>);

/// One chart.
pub struct Panel {
    title: String,
    x_label: &'static str,
    kind: Kind,
    /// Upright lines at these places.
    marks: Vec<f64>,
    /// What lies between the left and the right edge; by default a little more than there is.
    across: Option<Range<f64>>,
}

enum Kind {
    Lines(Vec<Series>),
    /// One metre is as long to the right as upwards, and a mark stands at the start.
    Map(Vec<Series>),
    /// Rows of values, the first at the bottom; the last column ends at `width`.
    Heat {
        rows: Vec<Vec<f64>>,
        width: f64,
    },
    /// How many values lie in each range.
    Bars(Vec<(Range<f64>, usize)>),
}

impl Panel {
    /// Curves over `x_label`.
    pub fn lines(title: impl Into<String>, x_label: &'static str, series: Vec<Series>) -> Self {
        Self::of(title, x_label, Kind::Lines(series))
    }

    /// Values at so many a second, over time.
    pub fn over_time<'a>(
        title: impl Into<String>,
        fps: f64,
        tracks: impl IntoIterator<Item = (&'a str, Vec<f64>)>,
    ) -> Self {
        let series = tracks.into_iter().map(|(name, values)| {
            let values = values.into_iter().enumerate();
            let points = values.map(|(t, value)| (t as f64 / fps, value));
            (name.to_string(), points.collect())
        });
        Self::lines(title, "s", series.collect())
    }

    /// A path on the floor.
    pub fn map(title: impl Into<String>, x_label: &'static str, series: Vec<Series>) -> Self {
        Self::of(title, x_label, Kind::Map(series))
    }

    /// Rows of values over time, darker where they are larger; the last column ends at `seconds`.
    pub fn heat(title: impl Into<String>, rows: Vec<Vec<f64>>, seconds: f64) -> Self {
        let width = seconds;
        Self::of(title, "s", Kind::Heat { rows, width })
    }

    /// A histogram of at most `bins` bars.
    pub fn histogram(
        title: impl Into<String>,
        x_label: &'static str,
        values: &[f64],
        bins: usize,
    ) -> Self {
        let values = || values.iter().copied().filter(|&value| can_be_drawn(value));
        let (low, high) = extremes(values());
        let width = ((high - low) / bins as f64).max(1e-9 * high.abs().max(1.0));
        let mut counts = vec![0; bins];
        for value in values() {
            let bin = ((value - low) / width) as usize;
            counts[bin.min(bins - 1)] += 1;
        }
        let bars = counts.into_iter().enumerate().map(|(bin, count)| {
            let from = low + bin as f64 * width;
            (from..from + width, count)
        });
        let bars = bars.filter(|(range, _)| range.start.is_finite());
        Self::of(title, x_label, Kind::Bars(bars.collect()))
    }

    /// The same with upright lines.
    #[must_use]
    pub fn with_marks(mut self, marks: &[f64]) -> Self {
        self.marks = marks.to_vec();
        self
    }

    /// The same from edge to edge: panels below each other line up.
    #[must_use]
    pub fn spanning(mut self, across: Range<f64>) -> Self {
        self.across = Some(across);
        self
    }

    fn of(title: impl Into<String>, x_label: &'static str, kind: Kind) -> Self {
        Self {
            title: title.into(),
            x_label,
            kind,
            marks: Vec::new(),
            across: None,
        }
    }

    fn series(&self) -> &[Series] {
        match &self.kind {
            Kind::Lines(series) | Kind::Map(series) => series,
            Kind::Heat { .. } | Kind::Bars(_) => &[],
        }
    }
}

/// Rejects an ending that no picture has.
///
/// # Errors
/// [`PictureError::Ending`].
pub fn check_ending(out: &Path) -> Result<(), PictureError> {
    let ending = out.extension().unwrap_or_default().to_string_lossy();
    if ["svg", "png"]
        .iter()
        .any(|known| ending.eq_ignore_ascii_case(known))
    {
        return Ok(());
    }
    Err(PictureError::Ending {
        path: out.to_path_buf(),
        ending: ending.to_ascii_lowercase(),
    })
}

/// Draws the panels into `out`, `columns` side by side, each of `size` pixels.
///
/// # Errors
/// [`PictureError`].
pub fn draw(
    panels: &[Panel],
    columns: usize,
    size: (u32, u32),
    out: &Path,
) -> Result<(), PictureError> {
    check_ending(out)?;
    let columns = columns.min(panels.len()).max(1);
    let grid = (panels.len().div_ceil(columns), columns);
    let size = (size.0 * grid.1 as u32, size.1 * grid.0 as u32);
    // With its own font a picture is the same on every machine; registering it again is harmless.
    let font = epaint_default_fonts::UBUNTU_LIGHT;
    let registered = register_font("sans-serif", FontStyle::Normal, font);
    debug_assert!(registered.is_ok(), "the built-in font is one");
    let is_svg = out
        .extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("svg"));
    let drawn = if is_svg {
        svg(panels, grid, size)
    } else {
        png(panels, grid, size)
    };
    let written = drawn.and_then(|bytes| Ok(std::fs::write(out, bytes)?));
    written.map_err(|error| PictureError::Drawing {
        path: out.to_path_buf(),
        reason: error.to_string(),
    })
}

fn svg(
    panels: &[Panel],
    grid: (usize, usize),
    size: (u32, u32),
) -> Result<Vec<u8>, Box<dyn Error>> {
    let mut text = String::new();
    let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
    draw_all(panels, grid, &root, 2)?;
    drop(root);
    Ok(text.into_bytes())
}

fn png(
    panels: &[Panel],
    grid: (usize, usize),
    size: (u32, u32),
) -> Result<Vec<u8>, Box<dyn Error>> {
    let (width, height) = size;
    let mut pixels = vec![0; 3 * width as usize * height as usize];
    let root = BitMapBackend::with_buffer(&mut pixels, size).into_drawing_area();
    // Wider strokes of a bitmap have spikes where a curve turns back.
    draw_all(panels, grid, &root, 1)?;
    drop(root);
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&pixels)?;
    writer.finish()?;
    Ok(bytes)
}

fn draw_all<B>(
    panels: &[Panel],
    grid: (usize, usize),
    root: &DrawingArea<B, Shift>,
    stroke: u32,
) -> Result<(), Box<dyn Error>>
where
    B: DrawingBackend,
    B::ErrorType: 'static,
{
    root.fill(&WHITE)?;
    for (panel, area) in panels.iter().zip(root.split_evenly(grid)) {
        draw_panel(panel, &area, stroke)?;
    }
    root.present()?;
    Ok(())
}

fn draw_panel<B>(
    panel: &Panel,
    area: &DrawingArea<B, Shift>,
    stroke: u32,
) -> Result<(), Box<dyn Error>>
where
    B: DrawingBackend,
    B::ErrorType: 'static,
{
    let is_map = matches!(panel.kind, Kind::Map(_));
    let points = || {
        let all = panel.series().iter().flat_map(|(_, points)| points);
        all.filter(|(x, y)| can_be_drawn(*x) && can_be_drawn(*y))
    };
    let (x, y) = match &panel.kind {
        Kind::Lines(_) => (bounds(points().map(|p| p.0)), bounds(points().map(|p| p.1))),
        Kind::Map(_) => {
            let (width, height) = area.dim_in_pixel();
            let ratio = f64::from(width) / f64::from(height);
            equal_scale(
                bounds(points().map(|p| p.0)),
                bounds(points().map(|p| p.1)),
                ratio,
            )
        }
        Kind::Heat { rows, width } => (0.0..width.max(1e-9), 0.0..rows.len().max(1) as f64),
        Kind::Bars(bars) => {
            let most = bars.iter().map(|(_, count)| *count).max().unwrap_or(1);
            let ends = bars.iter().flat_map(|(range, _)| [range.start, range.end]);
            (bounds(ends), 0.0..1.05 * most as f64)
        }
    };
    let x = panel.across.clone().unwrap_or(x);
    let height = y.clone();
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .caption(&panel.title, ("sans-serif", 14))
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
    match &panel.kind {
        Kind::Heat { rows, width } => {
            chart.draw_series(cells(rows, *width))?;
        }
        Kind::Bars(bars) => {
            chart.draw_series(bars.iter().map(|(range, count)| {
                let corners = [(range.start, 0.0), (range.end, *count as f64)];
                Rectangle::new(corners, Palette99::pick(0).mix(0.7).filled())
            }))?;
        }
        Kind::Lines(_) | Kind::Map(_) => {}
    }
    for (index, (name, points)) in panel.series().iter().enumerate() {
        let style = Palette99::pick(index).stroke_width(stroke);
        let key = Palette99::pick(index).stroke_width(2);
        let finite = points
            .iter()
            .copied()
            .filter(|(x, y)| can_be_drawn(*x) && can_be_drawn(*y));
        chart
            .draw_series(LineSeries::new(finite, style))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 12, y)], key));
    }
    chart.draw_series(panel.marks.iter().map(|&x| {
        let line = vec![(x, height.start), (x, height.end)];
        PathElement::new(line, RED.mix(0.35))
    }))?;
    if is_map {
        let start = points().next().copied();
        let mark = start.map(|point| Circle::new(point, 4, BLACK.filled()));
        chart
            .draw_series(mark)?
            .label("start")
            .legend(|(x, y)| Circle::new((x + 6, y), 4, BLACK.filled()));
    }
    if panel.series().len() > 1 || is_map {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.7))
            .label_font(("sans-serif", 10))
            .draw()?;
    }
    Ok(())
}

/// A heat map's rectangles, cells taken together where there are more than can be seen.
fn cells(rows: &[Vec<f64>], width: f64) -> impl Iterator<Item = Rectangle<(f64, f64)>> + '_ {
    let columns = rows.first().map_or(0, Vec::len);
    let values = || rows.iter().flatten().copied().filter(|&v| can_be_drawn(v));
    let (low, high) = extremes(values());
    let scale = 1.0 / (high - low).max(1e-9);
    let (across, up) = (columns.min(HEAT_CELLS.0), rows.len().min(HEAT_CELLS.1));
    let span = move |index: usize, parts: usize, whole: usize| {
        let from = index * whole / parts;
        from..((index + 1) * whole / parts).max(from + 1)
    };
    let cell = move |(j, i): (usize, usize)| {
        let (row_span, column_span) = (span(j, up, rows.len()), span(i, across, columns));
        let mean = rows[row_span.clone()]
            .iter()
            .flat_map(|row| &row[column_span.clone()])
            .sum::<f64>()
            / (row_span.len() * column_span.len()) as f64;
        let shade = 255.0 * (1.0 - ((mean - low) * scale).clamp(0.0, 1.0));
        let seconds = |column: usize| column as f64 / columns as f64 * width;
        let corners = [
            (seconds(column_span.start), row_span.start as f64),
            (seconds(column_span.end), row_span.end as f64),
        ];
        let gray = shade as u8;
        Rectangle::new(corners, RGBColor(gray, gray, gray).filled())
    };
    (0..up)
        .flat_map(move |j| (0..across).map(move |i| (j, i)))
        .map(cell)
}

/// Whether a value has a place on an axis, whose ticks are counted in steps of the scale: beyond
/// this that never ends.
fn can_be_drawn(value: f64) -> bool {
    value.abs() <= 1e30
}

/// The lowest and the highest of the values.
fn extremes(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let none = (f64::INFINITY, f64::NEG_INFINITY);
    values.fold(none, |(low, high), value| (low.min(value), high.max(value)))
}

/// The range of the values with a small margin; never empty.
fn bounds(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = extremes(values);
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
