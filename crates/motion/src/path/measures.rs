//! Measures of path following.

use serde::{Deserialize, Serialize};

use super::warp::facing;
use super::{Course, Polyline, headings_of, wrapped};
use crate::feet::{StepRule, steps};
use crate::humanml::{FeatureError, Joints, Skeleton};
use crate::metrics::{mean_jerk, skating_ratio};
use crate::moments::mean;

/// Path errors of a motion, and its quality.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct PathReport {
    /// Mean distance of the root from the nearest point of the path, metres.
    pub mean_distance: f64,
    /// Largest distance of the root from the path, metres.
    pub largest_distance: f64,
    /// Mean distance of the root from its position on the course, metres.
    pub mean_error: f64,
    /// Mean angle between body and path, degrees. This and all following measures need a body.
    pub heading_error: Option<f64>,
    /// Mean horizontal step of low and slow ankles and toes, metres.
    pub slide: Option<f64>,
    /// [`skating_ratio`] of the toes; none for a single frame.
    pub foot_skating: Option<f64>,
    /// [`mean_jerk`], metres per second cubed; none for fewer than four frames.
    pub jerk: Option<f64>,
}

impl PathReport {
    /// Measures a motion against a path and its course.
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`] for another skeleton or a course of another length.
    pub fn of(
        joints: &Joints,
        skeleton: &Skeleton,
        path: &Polyline,
        course: &Course,
    ) -> Result<Self, FeatureError> {
        joints.must_be_of(skeleton)?;
        FeatureError::unless_equal("frames", course.frames(), joints.frames())?;
        let track: Vec<[f64; 2]> = joints.track(0).iter().map(|[x, _, z]| [*x, *z]).collect();
        let headings = facing(joints, skeleton).into_iter();
        let headings = headings.zip(headings_of(&course.points));
        let angles = headings.map(|(body, path)| wrapped(body - path).abs().to_degrees());
        let (fps, feet) = (skeleton.description().fps, skeleton.contact_joints());
        let toes = [feet[1], feet[3]];
        Ok(Self {
            heading_error: Some(mean(angles)),
            slide: Some(slide(joints, &feet)),
            foot_skating: skating_ratio(joints, fps, &toes),
            jerk: mean_jerk(joints, fps),
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
        Self {
            mean_distance: mean(distances.iter().copied()),
            largest_distance: distances.iter().copied().fold(0.0, f64::max),
            mean_error: mean(errors),
            ..Self::default()
        }
    }
}

/// Mean horizontal step of `feet` that are slow and near the clip's lowest joint in height
/// (docs/sources.md, section 7, "Edge Considerations"). Zero without such a frame.
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
            PathReport::of(&joints, &skeleton, path, &course).unwrap()
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
        // A path to the left.
        let across = report(&ahead(0.0, true), 1.0);
        assert!(
            across.largest_distance > 2.0 && across.heading_error.unwrap() > 80.0,
            "{across:?}"
        );
        let short = Course::at_speed(&ahead(0.0, false), 59, None, 20.0);
        assert!(PathReport::of(&joints, &skeleton, &ahead(0.0, false), &short).is_err());
        assert_eq!(distance_from(&ahead(0.0, false), [0.0, -3.0]), 3.0);
    }
}
