//! Panels: the contents of charts.

use std::ops::Range;

use super::axes::{bounds, can_be_drawn, extremes};

/// A named curve.
pub type Series = (String, Vec<(f64, f64)>);

/// A body at a time, in side view.
#[derive(Clone, Debug)]
pub(super) struct Pose {
    pub label: String,
    /// Position of the label, above the body.
    pub top: (f64, f64),
    /// Both ends of each bone, meters.
    pub bones: Vec<[(f64, f64); 2]>,
    /// Joints without bones, meters.
    pub joints: Vec<(f64, f64)>,
}

/// A chart.
#[derive(Clone, Debug)]
pub struct Panel {
    pub(super) title: String,
    pub(super) x_label: &'static str,
    pub(super) kind: Kind,
    /// Positions of ticks above the plot.
    pub(super) marks: Vec<f64>,
    /// Values with a horizontal line.
    pub(super) thresholds: Vec<f64>,
    /// True if the y axis is logarithmic.
    pub(super) is_logarithmic: bool,
    /// Range of the x axis; by default, the range of the data with a margin.
    pub(super) across: Option<Range<f64>>,
    /// Named points (x, -z) of a map.
    pub(super) points: Vec<(String, (f64, f64))>,
    /// Corners (x, -z) of the regions of a map.
    pub(super) regions: Vec<Vec<(f64, f64)>>,
    /// True if the panel fills a row.
    pub(super) is_wide: bool,
}

#[derive(Clone, Debug)]
pub(super) enum Kind {
    Lines(Vec<Series>),
    /// Top view with equal scales and a mark at the start.
    Map(Vec<Series>),
    /// Bodies in side view, with equal scales.
    Poses(Vec<Pose>),
    /// Rows of values from bottom to top; the last column ends at `width`.
    Heat {
        rows: Vec<Vec<f64>>,
        width: f64,
    },
    /// Named rows of time ranges, which end at `width`.
    Strip {
        rows: Vec<(String, Vec<Range<f64>>)>,
        width: f64,
    },
    /// Counts of values by range.
    Bars(Vec<(Range<f64>, usize)>),
}

impl Panel {
    /// Curves over `x_label`.
    pub fn lines(title: impl Into<String>, x_label: &'static str, series: Vec<Series>) -> Self {
        Self::of(title, x_label, Kind::Lines(series))
    }

    /// Values over time at `fps` values per second.
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

    /// Paths of points (x, z) on the floor, in meters. Top view with equal scales: x to the right,
    /// z downward.
    pub fn map(title: impl Into<String>, series: Vec<Series>) -> Self {
        let downwards = |(name, points): Series| {
            let points = points.into_iter().map(|(x, z)| (x, -z));
            (name, points.collect())
        };
        let series = series.into_iter().map(downwards).collect();
        Self::of(title, "m", Kind::Map(series))
    }

    /// Rows of values over time, darker for larger values; the last column ends at `width` seconds.
    pub fn heat(title: impl Into<String>, rows: Vec<Vec<f64>>, width: f64) -> Self {
        Self::of(title, "s", Kind::Heat { rows, width })
    }

    /// The times at which named flags (at `fps` values per second) are true, from top to bottom.
    pub fn strip<'a>(
        title: impl Into<String>,
        fps: f64,
        tracks: impl IntoIterator<Item = (&'a str, &'a [bool])>,
    ) -> Self {
        let mut width = 0.0f64;
        let rows = tracks.into_iter().map(|(name, frames)| {
            width = width.max(frames.len() as f64 / fps);
            (name.to_string(), spans(frames, fps))
        });
        let mut rows: Vec<_> = rows.collect();
        rows.reverse();
        Self::of(title, "s", Kind::Strip { rows, width })
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

    /// Adds ticks above the plot.
    #[must_use]
    pub fn with_marks(mut self, marks: &[f64]) -> Self {
        self.marks = marks.to_vec();
        self
    }

    /// Adds a horizontal line at each threshold of curves. The axis reaches thresholds near the curves;
    /// the legend names all.
    #[must_use]
    pub fn with_thresholds(mut self, thresholds: &[f64]) -> Self {
        self.thresholds = thresholds.to_vec();
        self
    }

    /// Draws curves on a logarithmic y axis; values of 0 or below interrupt the curve.
    #[must_use]
    pub fn on_logarithmic_axis(mut self) -> Self {
        self.is_logarithmic = true;
        self
    }

    /// The panel with the logarithms of the values, if its axis is logarithmic.
    pub(super) fn scaled(&self) -> Self {
        let mut scaled = self.clone();
        if let (true, Kind::Lines(series)) = (self.is_logarithmic, &mut scaled.kind) {
            let points = series.iter_mut().flat_map(|(_, points)| points);
            points.for_each(|(_, y)| *y = logarithm(*y));
            let thresholds = scaled.thresholds.iter_mut();
            thresholds.for_each(|threshold| *threshold = logarithm(*threshold));
        }
        scaled
    }

    /// The range of the y axis of curves: the values, and thresholds that are at most as far from
    /// them as they reach.
    pub(super) fn up(&self) -> Range<f64> {
        let values = || self.places().map(|place| place.1);
        let (low, high) = extremes(values());
        let reach = (high - low).max(0.1 * high.abs().max(low.abs()));
        let near = |line: &f64| (low - reach..=high + reach).contains(line);
        let near = self.thresholds.iter().copied().filter(near);
        bounds(values().chain(near))
    }

    /// Sets the range of the x axis, so that panels line up.
    #[must_use]
    pub fn spanning(mut self, across: Range<f64>) -> Self {
        self.across = Some(across);
        self
    }

    pub(super) fn of(title: impl Into<String>, x_label: &'static str, kind: Kind) -> Self {
        Self {
            title: title.into(),
            x_label,
            kind,
            marks: Vec::new(),
            thresholds: Vec::new(),
            is_logarithmic: false,
            across: None,
            points: Vec::new(),
            regions: Vec::new(),
            is_wide: false,
        }
    }

    /// The title.
    pub fn title(&self) -> &str {
        &self.title
    }

    /// The curves of lines or of a map.
    pub fn series(&self) -> &[Series] {
        match &self.kind {
            Kind::Lines(series) | Kind::Map(series) => series,
            _ => &[],
        }
    }

    /// All points that can be drawn.
    pub(super) fn places(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        let series = self.series().iter().flat_map(|(_, points)| points.clone());
        let named = self.points.iter().map(|(_, point)| *point);
        let regions = self.regions.iter().flatten().copied();
        let poses = match &self.kind {
            Kind::Poses(poses) => poses.as_slice(),
            _ => &[],
        };
        let poses = poses.iter().flat_map(|pose| {
            let ends = pose.bones.iter().flatten().copied();
            ends.chain(pose.joints.iter().copied()).chain([pose.top])
        });
        let all = series.chain(named).chain(regions).chain(poses);
        all.filter(|(x, y)| can_be_drawn(*x) && can_be_drawn(*y))
    }
}

/// The decimal logarithm; NaN for values of 0 or below.
fn logarithm(value: f64) -> f64 {
    match value > 0.0 {
        true => value.log10(),
        false => f64::NAN,
    }
}

/// The time ranges in which the frames are true.
fn spans(frames: &[bool], fps: f64) -> Vec<Range<f64>> {
    let mut spans: Vec<Range<f64>> = Vec::new();
    let mut before = false;
    for (t, &is_true) in frames.iter().enumerate() {
        let (from, to) = (t as f64 / fps, (t + 1) as f64 / fps);
        match spans.last_mut() {
            Some(last) if is_true && before => last.end = to,
            _ if is_true => spans.push(from..to),
            _ => {}
        }
        before = is_true;
    }
    spans
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(values: &[f64]) -> Panel {
        let points = values.iter().enumerate();
        let points = points.map(|(t, value)| (t as f64, *value)).collect();
        Panel::lines("", "s", vec![("a".into(), points)])
    }

    #[test]
    fn the_axis_reaches_thresholds_that_are_near() {
        let near = panel(&[0.98, 1.0]).with_thresholds(&[0.95, 1.05]).up();
        assert!(near.start < 0.95 && near.end > 1.05, "{near:?}");
        let far = panel(&[1.0, 900.0]).with_thresholds(&[50_000.0]).up();
        assert!(far.end < 1000.0, "{far:?}");
    }

    #[test]
    fn a_logarithmic_axis_shows_orders_of_magnitude() {
        let scaled = panel(&[100.0, 0.01, 0.0, -1.0]).on_logarithmic_axis();
        let scaled = scaled.with_thresholds(&[1000.0]).scaled();
        let (_, points) = &scaled.series()[0];
        assert_eq!((points[0].1, points[1].1), (2.0, -2.0));
        assert!(points[2].1.is_nan() && points[3].1.is_nan());
        assert_eq!(scaled.thresholds, [3.0]);
    }

    #[test]
    fn a_span_lasts_to_the_end_of_its_last_frame() {
        let frames = [true, true, false, true, false, false, true];
        assert_eq!(spans(&frames, 2.0), [0.0..1.0, 1.5..2.0, 3.0..3.5]);
        assert_eq!(spans(&[false; 3], 2.0), []);
    }
}
