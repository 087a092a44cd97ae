//! C3D files: marker places frame by frame, binary.
//!
//! Format: The C3D File Format User Guide, Motion Lab Systems (<https://www.c3d.org>). All three
//! processor types and both storage forms are read; analog samples are skipped.

mod bytes;
mod parameters;
mod read;
#[cfg(test)]
pub(super) mod tests;

pub use bytes::Processor;

use crate::bare_name;

/// A C3D file: labels and points of all frames. Made by [`C3d::parse`].
#[derive(Clone, Debug, PartialEq)]
pub struct C3d {
    /// Name of the file, for messages.
    pub file: String,
    /// The processor whose number formats the file uses.
    pub processor: Processor,
    /// Labels of the points, with their prefix, at most one for each point.
    pub labels: Vec<String>,
    /// Frames per second.
    pub rate: f64,
    /// Length of a file unit (POINT:UNITS, by default millimetres).
    pub metres_per_unit: f64,
    /// Number of the first stored frame. Frame indices count from 0 at this frame.
    pub first_frame: u32,
    /// Number of points in a frame, at least 1.
    pub points_per_frame: usize,
    /// `[frames, points]` in file units; NaN where a point was not seen.
    points: Vec<[f32; 3]>,
}

impl C3d {
    /// Number of frames, at least 1.
    pub fn frames(&self) -> usize {
        self.points.len() / self.points_per_frame
    }

    /// Place of a point in frame `t`, in file units and axes; none where it is missing.
    ///
    /// # Panics
    /// Panics if there is no such frame or point.
    pub fn point(&self, t: usize, point: usize) -> Option<[f64; 3]> {
        assert!(point < self.points_per_frame, "there is no point {point}");
        let place = self.points[t * self.points_per_frame + point];
        (!place[0].is_nan()).then(|| place.map(f64::from))
    }

    /// Places of a point in all frames. A point at exactly 0, 0, 0 is missing: some programs write
    /// missing points so.
    ///
    /// # Panics
    /// Panics if `point` is not below the number of points per frame.
    pub fn track(&self, point: usize) -> Vec<Option<[f64; 3]>> {
        let track = (0..self.frames()).map(|t| self.point(t, point));
        let seen = track.map(|place| place.filter(|place| *place != [0.0; 3]));
        seen.collect()
    }

    /// Indices of the points called `name`: the points with exactly this label, otherwise those
    /// with this label behind a prefix (`SUBJECT:NAME`), otherwise those with this label in upper or
    /// lower case.
    pub fn find(&self, name: &str) -> Vec<usize> {
        let with = |fits: &dyn Fn(&str) -> bool| -> Vec<usize> {
            let labels = self.labels.iter().enumerate();
            labels.filter(|(_, l)| fits(l)).map(|(i, _)| i).collect()
        };
        match with(&|label| label == name) {
            exact if !exact.is_empty() => exact,
            _ => match with(&|label| bare_name(label) == name) {
                bare if !bare.is_empty() => bare,
                _ => with(&|label| bare_name(label).eq_ignore_ascii_case(name)),
            },
        }
    }
}
