//! What a chart shows.

use std::ops::Range;

use super::axes::{can_be_drawn, extremes};

/// A named curve.
pub type Series = (String, Vec<(f64, f64)>);

/// A body at one moment, seen from the side.
#[derive(Clone, Debug)]
pub struct Pose {
    /// The moment.
    pub label: String,
    /// Where the label stands, above the body.
    pub top: (f64, f64),
    /// Both ends of each bone, metres.
    pub bones: Vec<[(f64, f64); 2]>,
    /// Joints that no bone leads to or from, metres.
    pub joints: Vec<(f64, f64)>,
}

/// One chart.
pub struct Panel {
    pub(super) title: String,
    pub(super) x_label: &'static str,
    pub(super) kind: Kind,
    /// Ticks above the plot at these places.
    pub(super) marks: Vec<f64>,
    /// What lies between the left and the right edge; by default a little more than there is.
    pub(super) across: Option<Range<f64>>,
    /// Named points of a map.
    pub(super) points: Vec<(String, (f64, f64))>,
    /// Corners of the regions of a map.
    pub(super) regions: Vec<Vec<(f64, f64)>>,
    /// Whether it takes a row of panels for itself.
    pub(super) is_wide: bool,
}

pub(super) enum Kind {
    Lines(Vec<Series>),
    /// One metre is as long to the right as downwards, and a mark stands at the start.
    Map(Vec<Series>),
    /// Bodies from the side; one metre is as long to the right as upwards.
    Poses(Vec<Pose>),
    /// Rows of values, the first at the bottom; the last column ends at `width`.
    Heat {
        rows: Vec<Vec<f64>>,
        width: f64,
    },
    /// Named rows with the times, from and to, at which something holds; they end at `width`.
    Strip {
        rows: Vec<(String, Vec<Range<f64>>)>,
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

    /// Paths on the floor from above, of points (x, z) in metres: x to the right and z, towards the
    /// viewer, downwards. Both axes have the same scale.
    pub fn map(title: impl Into<String>, series: Vec<Series>) -> Self {
        let downwards = |(name, points): Series| {
            let points = points.into_iter().map(|(x, z)| (x, -z));
            (name, points.collect())
        };
        let series = series.into_iter().map(downwards).collect();
        Self::of(title, "m", Kind::Map(series))
    }

    /// Bodies from the side. Both axes have the same scale.
    pub fn poses(title: impl Into<String>, poses: Vec<Pose>) -> Self {
        Self::of(title, "m", Kind::Poses(poses))
    }

    /// Rows of values over time, darker where they are larger; the last column ends at `seconds`.
    pub fn heat(title: impl Into<String>, rows: Vec<Vec<f64>>, seconds: f64) -> Self {
        let width = seconds;
        Self::of(title, "s", Kind::Heat { rows, width })
    }

    /// When each of the named things holds, of values at so many a second; the first is at the top.
    pub fn strip<'a>(
        title: impl Into<String>,
        fps: f64,
        tracks: impl IntoIterator<Item = (&'a str, &'a [bool])>,
    ) -> Self {
        let mut width = 0.0f64;
        let mut rows: Vec<_> = tracks
            .into_iter()
            .map(|(name, frames)| {
                width = width.max(frames.len() as f64 / fps);
                (name.to_string(), spans(frames, fps))
            })
            .collect();
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

    /// The same with ticks above the plot.
    #[must_use]
    pub fn with_marks(mut self, marks: &[f64]) -> Self {
        self.marks = marks.to_vec();
        self
    }

    /// A map with named points (x, z), such as key frames.
    #[must_use]
    pub fn with_points(mut self, points: impl IntoIterator<Item = (String, (f64, f64))>) -> Self {
        let points = points.into_iter().map(|(name, (x, z))| (name, (x, -z)));
        self.points.extend(points);
        self
    }

    /// A map with a region between these corners (x, z), such as an obstacle.
    #[must_use]
    pub fn with_region(mut self, corners: impl IntoIterator<Item = (f64, f64)>) -> Self {
        let corners = corners.into_iter().map(|(x, z)| (x, -z));
        self.regions.push(corners.collect());
        self
    }

    /// The same from edge to edge: panels below each other line up.
    #[must_use]
    pub fn spanning(mut self, across: Range<f64>) -> Self {
        self.across = Some(across);
        self
    }

    /// The same over all columns of a picture.
    #[must_use]
    pub fn wide(mut self) -> Self {
        self.is_wide = true;
        self
    }

    fn of(title: impl Into<String>, x_label: &'static str, kind: Kind) -> Self {
        Self {
            title: title.into(),
            x_label,
            kind,
            marks: Vec::new(),
            across: None,
            points: Vec::new(),
            regions: Vec::new(),
            is_wide: false,
        }
    }

    pub(super) fn series(&self) -> &[Series] {
        match &self.kind {
            Kind::Lines(series) | Kind::Map(series) => series,
            _ => &[],
        }
    }

    /// Everything that has a place in the plot and can be drawn.
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
        series
            .chain(named)
            .chain(regions)
            .chain(poses)
            .filter(|(x, y)| can_be_drawn(*x) && can_be_drawn(*y))
    }
}

/// The times, from and to, at which the frames are true.
fn spans(frames: &[bool], fps: f64) -> Vec<Range<f64>> {
    let mut spans: Vec<Range<f64>> = Vec::new();
    let mut before = false;
    for (t, &holds) in frames.iter().enumerate() {
        let (from, to) = (t as f64 / fps, (t + 1) as f64 / fps);
        match spans.last_mut() {
            Some(last) if holds && before => last.end = to,
            _ if holds => spans.push(from..to),
            _ => {}
        }
        before = holds;
    }
    spans
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_strip_holds_from_the_first_frame_to_the_end_of_the_last() {
        let frames = [true, true, false, true, false, false, true];
        assert_eq!(spans(&frames, 2.0), [0.0..1.0, 1.5..2.0, 3.0..3.5]);
        assert_eq!(spans(&[false; 3], 2.0), []);
    }
}
