//! Measures of path following.

use serde::{Deserialize, Serialize};

use super::warp::facing;
use super::{Course, Polyline, headings_of, wrapped};
use crate::feet::{StepRule, steps};
use crate::humanml::{FeatureError, Joints, Skeleton};
use crate::metrics::BodyQuality;
use crate::moments::mean;

/// Path errors of a motion, and its quality.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(default)]
pub struct PathReport {
    /// Distance that the root travels along the path, metres.
    pub travelled: f64,
    /// Distance that the course covers, metres.
    pub asked: f64,
    /// Mean distance of the root from the nearest point of the path, metres.
    pub mean_distance: f64,
    /// Largest distance of the root from the path, metres.
    pub largest_distance: f64,
    /// Mean distance of the root from its position on the course, metres.
    pub mean_error: f64,
    /// The largest one.
    pub largest_error: f64,
    /// Mean angle between body and path, degrees; this and the following need a body.
    pub heading_error: Option<f64>,
    /// Mean horizontal step of low and slow ankles and toes, metres.
    pub slide: Option<f64>,
    /// How the body stands and moves.
    #[serde(flatten)]
    pub body: BodyQuality,
}

impl PathReport {
    /// Measures a motion above a `floor` of that height against a path and its course.
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`] for another skeleton or a course of another length.
    pub fn of(
        joints: &Joints,
        skeleton: &Skeleton,
        path: &Polyline,
        course: &Course,
        floor: f64,
    ) -> Result<Self, FeatureError> {
        joints.must_be_of(skeleton)?;
        FeatureError::unless_equal("frames", course.frames(), joints.frames())?;
        let track: Vec<[f64; 2]> = joints.track(0).iter().map(|[x, _, z]| [*x, *z]).collect();
        let headings = facing(joints, skeleton).into_iter();
        let headings = headings.zip(headings_of(&course.points));
        let angles = headings.map(|(body, path)| wrapped(body - path).abs().to_degrees());
        Ok(Self {
            heading_error: Some(mean(angles)),
            slide: Some(slide(joints, &skeleton.contact_joints())),
            body: BodyQuality::of(joints, skeleton, floor),
            ..Self::of_root(&track, path, course)
        })
    }

    /// Measures a root without a body at `track`, one position per frame of the course.
    ///
    /// # Panics
    /// Panics without a frame.
    pub fn of_root(track: &[[f64; 2]], path: &Polyline, course: &Course) -> Self {
        let distances = track.iter().map(|root| distance_from(path, *root));
        let distances: Vec<f64> = distances.collect();
        let errors = track.iter().zip(&course.points);
        let errors = errors.map(|(root, target)| super::between(*root, *target));
        let errors: Vec<f64> = errors.collect();
        Self {
            travelled: travelled(path, track),
            asked: course.metres.last().copied().unwrap_or(0.0),
            mean_distance: mean(distances.iter().copied()),
            largest_distance: distances.iter().copied().fold(0.0, f64::max),
            mean_error: mean(errors.iter().copied()),
            largest_error: errors.iter().copied().fold(0.0, f64::max),
            ..Self::default()
        }
    }
}

/// Metres along a path that a root covers, which begins at the path's start. In each frame the root
/// has come to the nearest point ahead, at most twice its step away; a step back does not count.
pub fn travelled(path: &Polyline, track: &[[f64; 2]]) -> f64 {
    const TRIALS: usize = 32;
    track.windows(2).fold(0.0, |metres, pair| {
        let ahead = 2.0 * super::between(pair[0], pair[1]) / TRIALS as f64;
        let trials = (0..=TRIALS).map(|n| metres + n as f64 * ahead);
        let distance = |metres: f64| super::between(path.at_metres(metres).point, pair[1]);
        let nearer = |a: &f64, b: &f64| distance(*a).total_cmp(&distance(*b));
        trials.min_by(nearer).unwrap_or(metres).min(path.length())
    })
}

/// Mean horizontal step of `feet` in frames in which they are low and slow, above the lowest joint
/// of the clip (docs/sources.md, section 7, "Edge Considerations"). Zero without such a frame.
pub fn slide(joints: &Joints, feet: &[usize]) -> f64 {
    let heights = joints.as_slice().iter().map(|place| place[1]);
    let floor = heights.fold(f64::INFINITY, f64::min);
    let (mut metres, mut frames) = (0.0, 0.0);
    for &foot in feet {
        let track = joints.track(foot);
        let stands = StepRule::LOW_AND_SLOW.contacts(&track, floor);
        let steps = steps(&track).into_iter().zip(stands);
        for ([x, _, z], _) in steps.filter(|(_, stands)| *stands) {
            metres += x.hypot(z);
            frames += 1.0;
        }
    }
    if frames > 0.0 { metres / frames } else { 0.0 }
}

/// Distance of a position from the nearest point of a path, metres.
pub fn distance_from(path: &Polyline, [x, z]: [f64; 2]) -> f64 {
    let segment = |pair: &[[f64; 2]]| {
        let ([ax, az], [bx, bz]) = (pair[0], pair[1]);
        let (dx, dz) = (bx - ax, bz - az);
        let squared = dx * dx + dz * dz;
        let part = match squared > 0.0 {
            true => (((x - ax) * dx + (z - az) * dz) / squared).clamp(0.0, 1.0),
            false => 0.0,
        };
        (ax + part * dx - x).hypot(az + part * dz - z)
    };
    let distances = path.points().windows(2).map(segment);
    distances.fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::humanml::walk::{Course as Walk, joints as walk};

    #[test]
    fn a_motion_beside_its_path_is_as_far_as_it_is() {
        let skeleton = Skeleton::humanml3d();
        let straight = Walk {
            speed: Box::new(|_| 1.0),
            turning: Box::new(|_| 0.0),
        };
        let places = walk(&straight, &skeleton, 60);
        let start = places[0];
        let from_origin = places
            .iter()
            .map(|[x, y, z]| [x - start[0], *y, z - start[2]]);
        let joints = Joints::new(from_origin.collect(), 22).unwrap();
        let ahead = |x: f64, turned: bool| {
            let end = if turned { [x + 4.0, 0.0] } else { [x, 4.0] };
            Polyline::new(vec![[x, 0.0], end]).unwrap()
        };
        let report = |path: &Polyline, speed| {
            let course = Course::at_speed(path, 60, Some(speed), 20.0);
            PathReport::of(&joints, &skeleton, path, &course, 0.0).unwrap()
        };
        let on = report(&ahead(0.0, false), 1.0);
        assert!(on.mean_distance < 0.05 && on.mean_error < 0.1, "{on:?}");
        assert!(on.heading_error.unwrap() < 8.0, "{on:?}");
        let beside = report(&ahead(0.3, false), 1.0);
        assert!((beside.mean_distance - 0.3).abs() < 0.05, "{beside:?}");
        // The root is elsewhere on the path.
        let late = report(&ahead(0.0, false), 0.5);
        assert!(
            late.mean_distance < 0.05 && late.mean_error > 0.5,
            "{late:?}"
        );
        // It walks 2.95 of 4 m; the nearest point of the path does not show that it is slow.
        assert!((on.travelled - 2.95).abs() < 0.1 && (on.asked - 2.95).abs() < 1e-9);
        assert!(
            (late.travelled - 2.95).abs() < 0.1 && late.largest_error > 1.3,
            "{late:?}"
        );
        assert_eq!(on.body.floating, Some(0.0));
        // A path to the left.
        let across = report(&ahead(0.0, true), 1.0);
        assert!(
            across.largest_distance > 2.0 && across.heading_error.unwrap() > 80.0,
            "{across:?}"
        );
        let short = Course::at_speed(&ahead(0.0, false), 59, None, 20.0);
        assert!(PathReport::of(&joints, &skeleton, &ahead(0.0, false), &short, 0.0).is_err());
        assert_eq!(distance_from(&ahead(0.0, false), [0.0, -3.0]), 3.0);
        // Twice around a square that is asked for once, and back and forth at its start.
        let square = Polyline::new(vec![
            [0.0, 0.0],
            [0.0, 1.0],
            [1.0, 1.0],
            [1.0, 0.0],
            [0.0, 0.0],
        ]);
        let square = square.unwrap();
        let around: Vec<[f64; 2]> = (0..=80)
            .map(|n| square.at(f64::from(n % 40) / 40.0).point)
            .collect();
        assert!((travelled(&square, &around) - 4.0).abs() < 0.1);
        let idle: Vec<[f64; 2]> = (0..80).map(|n| [0.0, 0.02 * f64::from(n % 2)]).collect();
        assert!(travelled(&square, &idle) < 0.05);
    }
}
