//! The root of a marker set: pelvis markers and their orientation.

pub(crate) mod gaps;
mod root;
#[cfg(test)]
mod tests;

use kinegrad_motion::vector::minus;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::gaps::fill_gaps;
use self::root::Axes;
use crate::error::require;
use crate::{C3d, Error, UpAxis};

pub use root::MarkerRoot;

/// The markers that define the root. A group of several markers stands for the mean. The prefix of
/// a name, as in `SUBJECT:NAME`, is optional.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MarkerMap {
    /// Markers whose mean is the root's place.
    pub center: Vec<String>,
    /// Markers at the front of the body.
    pub front: Vec<String>,
    /// Markers at the back.
    pub back: Vec<String>,
    /// Markers at the body's left.
    pub left: Vec<String>,
    /// Markers at the body's right.
    pub right: Vec<String>,
    /// Axis of the file that points up.
    pub up: UpAxis,
    /// Longest gap of a marker, in capture frames, that is filled by a straight line. In longer
    /// gaps the root is not valid. The default is 8, a tenth of a second at 80 frames per second.
    pub max_gap_frames: usize,
    /// Removes the take's mean pitch of the forward axis from every frame, so that markers at
    /// different heights do not tilt the body.
    pub remove_mean_tilt: bool,
}

impl Default for MarkerMap {
    fn default() -> Self {
        let names = |names: &[&str]| names.iter().map(|name| name.to_string()).collect();
        Self {
            center: names(&["LFWT", "RFWT", "LBWT", "RBWT"]),
            front: names(&["LFWT", "RFWT"]),
            back: names(&["LBWT", "RBWT"]),
            left: names(&["LFWT", "LBWT"]),
            right: names(&["RFWT", "RBWT"]),
            up: UpAxis::Z,
            max_gap_frames: 8,
            remove_mean_tilt: false,
        }
    }
}

impl MarkerMap {
    /// The root of a take.
    ///
    /// # Errors
    /// [`Error::Setting`] if a group is empty, [`Error::Name`] for names that the file lacks or has
    /// several times, [`Error::NoPose`] if no frame has the root.
    pub fn root(&self, take: &C3d) -> Result<MarkerRoot, Error> {
        let mut gaps = Vec::new();
        let mut means = Vec::new();
        let groups = [
            ("center", &self.center),
            ("front", &self.front),
            ("back", &self.back),
            ("left", &self.left),
            ("right", &self.right),
        ];
        for (key, names) in groups {
            let allowed = "the name of at least one marker";
            require(!names.is_empty(), key, "an empty list", allowed)?;
            let mut tracks = Vec::new();
            for name in names {
                let point = find(take, key, name)?;
                let mut track = take.track(point);
                let found = fill_gaps(&mut track, self.max_gap_frames, &take.labels[point]);
                if found.missing_frames > 0 && !gaps.contains(&found) {
                    gaps.push(found);
                }
                tracks.push(track);
            }
            means.push(mean(&tracks));
        }
        let place = |group: usize, t: usize| {
            let metres = means[group][t]? * take.metres_per_unit;
            Some(self.up.to_y_up(metres.into()))
        };
        let axes = |t| {
            Some(Axes {
                center: place(0, t)?,
                forward: minus(place(1, t)?, place(2, t)?),
                left: minus(place(3, t)?, place(4, t)?),
            })
        };
        let frames = (0..take.frames()).map(axes).collect();
        let root = MarkerRoot::new(frames, take.rate, gaps, self.remove_mean_tilt);
        let lacks = "has all markers of the marker map in a usable place";
        root.ok_or_else(|| Error::NoPose {
            problem: format!("no frame of `{}` {lacks}", take.file),
            hint: "raise `max_gap_frames`, or choose markers that are seen; `front` must lie \
                   before `back` and `left` beside `right`",
        })
    }
}

fn find(take: &C3d, key: &str, name: &str) -> Result<usize, Error> {
    let (found, file) = (take.find(name), &take.file);
    let (problem, hint) = match found[..] {
        [point] => return Ok(point),
        [] => (
            format!("`{file}` has no marker `{name}`, which `{key}` of the marker map names"),
            format!("the markers of the file are: {}", take.labels.join(", ")),
        ),
        _ => {
            let labels: Vec<&str> = found.iter().map(|&i| &*take.labels[i]).collect();
            let labels = labels.join(", ");
            let several = "of the marker map may mean several markers of";
            (
                format!("`{name}` in `{key}` {several} `{file}`: {labels}"),
                "name the marker with its prefix, as `SUBJECT:NAME`".to_owned(),
            )
        }
    };
    Err(Error::Name { problem, hint })
}

/// The mean of the markers of a group in each frame, none where one is missing.
fn mean(tracks: &[Vec<Option<[f64; 3]>>]) -> Vec<Option<Vector3<f64>>> {
    let of_frame = |t: usize| {
        let places = tracks.iter().map(|track| track[t].map(Vector3::from));
        let sum: Option<Vector3<f64>> = places.sum();
        sum.map(|sum| sum / tracks.len() as f64)
    };
    (0..tracks[0].len()).map(of_frame).collect()
}
