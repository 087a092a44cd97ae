//! Metrics of rollouts.

use kinegrad_motion::humanml::{FeatureLayout, Joints, Skeleton};
use kinegrad_motion::metrics::{FeatureMoments, frechet_distance, mean_jerk, skating_ratio};
use kinegrad_motion::vector::length;
use kinegrad_train::evaluation::{Better, Metrics, Number};
use serde::Serialize;

use super::windows::rows;

/// Means over motions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct RolloutReport {
    pub motions: usize,
    pub jerk: Option<f64>,
    /// Mean jerk in the last quarter of each motion.
    pub jerk_at_end: Option<f64>,
    /// Share of the frame steps in which a toe slides, as published.
    pub foot_skating: Option<f64>,
    /// Largest change of a bone's length since the history's last frame, relative to that length.
    pub bone_change: Option<f64>,
    /// Lowest height of any joint above the floor, over all frames, meters.
    pub lowest_joint: Option<f64>,
    /// Difference of the root's mean height between the last and the first quarter, meters.
    pub height_drift: Option<f64>,
    pub speed: Option<f64>,
    /// Mean turning speed of the heading, degrees per second.
    pub turn_rate: Option<f64>,
    /// Fréchet distance between the mean joint positions relative to the root in samples and in
    /// real motion.
    pub frechet_distance: Option<f64>,
}

impl RolloutReport {
    /// Number of frames of the shortest motion.
    pub const SHORTEST: usize = 16;

    /// The report of motions with at least [`SHORTEST`](Self::SHORTEST) frames, compared with
    /// `real` motions. Pairs of initial [bone lengths](bone_lengths) and motion.
    pub fn compute(
        skeleton: &Skeleton,
        motions: &[(Vec<f64>, Joints)],
        real: &[(Vec<f64>, Joints)],
    ) -> Self {
        let fps = skeleton.description().fps;
        let feet = skeleton.contact_joints();
        let each = |of: &dyn Fn(&[f64], &Joints) -> Option<f64>| {
            let values = motions
                .iter()
                .filter_map(|(bones, joints)| of(bones, joints));
            mean(values.collect())
        };
        let moments = |motions: &[(Vec<f64>, Joints)]| {
            let of = |(_, joints): &(Vec<f64>, Joints)| mean_places(skeleton, joints);
            FeatureMoments::compute(&motions.iter().filter_map(of).collect::<Vec<_>>())
        };
        Self {
            motions: motions.len(),
            jerk: each(&|_, joints| mean_jerk(joints, fps)),
            jerk_at_end: each(&|_, joints| mean_jerk(&quarter(joints, 3), fps)),
            // The toes are the second of each pair of contacts.
            foot_skating: each(&|_, joints| skating_ratio(joints, fps, &[feet[1], feet[3]])),
            bone_change: each(&|bones, joints| {
                let lengths = (0..joints.frames()).map(|t| bone_lengths(skeleton, joints.frame(t)));
                let changes = lengths.flat_map(|lengths| {
                    let change = |(now, then): (f64, &f64)| (now / then - 1.0).abs();
                    lengths.into_iter().zip(bones).map(change)
                });
                changes.reduce(f64::max)
            }),
            lowest_joint: each(&|_, joints| {
                let heights = joints.as_slice().iter().map(|position| position[1]);
                heights.reduce(f64::min)
            }),
            height_drift: each(&|_, joints| {
                let height = |part: usize| {
                    let part = quarter(joints, part);
                    mean((0..part.frames()).map(|t| part.frame(t)[0][1]).collect())
                };
                height(3).zip(height(0)).map(|(last, first)| last - first)
            }),
            speed: each(&|_, joints| speed(skeleton, joints)),
            turn_rate: each(&|_, joints| {
                let turns = turns(skeleton, joints)?.into_iter();
                mean(turns.map(f64::abs).collect())
            }),
            frechet_distance: match std::ptr::eq(motions, real) {
                // Real motion has no distance from itself.
                true => None,
                false => moments(motions)
                    .zip(moments(real))
                    .map(|(a, b)| frechet_distance(&a, &b)),
            },
        }
    }
}

impl Metrics for RolloutReport {
    fn rows(&self) -> Vec<Number> {
        let main = [
            ("jerk", Better::NearReal),
            ("foot skating", Better::NearReal),
            ("bone change", Better::Lower),
            ("speed", Better::NearReal),
            ("turn rate", Better::NearReal),
            ("Fréchet distance", Better::Lower),
        ];
        let rows = Number::list([
            ("jerk", self.jerk, ", m/s³"),
            ("jerk at end", self.jerk_at_end, ", m/s³"),
            ("foot skating", self.foot_skating, ""),
            ("bone change", self.bone_change, ""),
            ("lowest joint", self.lowest_joint, ", m"),
            ("height drift", self.height_drift, ", m"),
            ("speed", self.speed, ", m/s"),
            ("turn rate", self.turn_rate, ", degrees/s"),
            ("Fréchet distance", self.frechet_distance, ""),
        ]);
        Number::mark(rows, &main)
    }
}

/// Differences between motions and their references.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct TextReport {
    /// Mean difference of the root's mean speeds, meters per second.
    pub speed_error: Option<f64>,
    /// Mean difference of the mean turns to the left, degrees per second.
    pub turn_error: Option<f64>,
}

impl TextReport {
    /// The report of pairs of a motion and a reference of equal length.
    pub fn compute(skeleton: &Skeleton, pairs: &[(Joints, Joints)]) -> Self {
        let apart = |of: &dyn Fn(&Joints) -> Option<f64>| {
            let both = pairs.iter().filter_map(|(a, b)| of(a).zip(of(b)));
            mean(both.map(|(a, b)| (a - b).abs()).collect())
        };
        Self {
            speed_error: apart(&|joints| speed(skeleton, joints)),
            turn_error: apart(&|joints| mean(turns(skeleton, joints)?)),
        }
    }

    /// The errors of rollouts with the clips' own texts and with other clips' texts.
    pub fn rows(own: &Self, other: &Self) -> Vec<Number> {
        Number::list([
            ("speed error", own.speed_error, ", m/s"),
            ("speed error, other texts", other.speed_error, ", m/s"),
            ("turn error", own.turn_error, ", degrees/s"),
            ("turn error, other texts", other.turn_error, ", degrees/s"),
        ])
    }
}

/// Distances of the joints (except the root) from their parents in one frame, meters.
pub(super) fn bone_lengths(skeleton: &Skeleton, frame: &[[f64; 3]]) -> Vec<f64> {
    let offsets = skeleton.offsets_of_frame(frame).into_iter().skip(1);
    offsets.map(length).collect()
}

fn mean(values: Vec<f64>) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Quarter `number` of a motion, counted from 0.
fn quarter(joints: &Joints, number: usize) -> Joints {
    let frames = joints.frames();
    let places = (number * frames / 4..(number + 1) * frames / 4).flat_map(|t| joints.frame(t));
    Joints::new(places.copied().collect(), joints.joints()).expect("whole frames")
}

/// Mean over time of each joint's position relative to the root.
fn mean_places(skeleton: &Skeleton, joints: &Joints) -> Option<Vec<f64>> {
    let rows = rows(skeleton, joints).ok()?;
    let layout = skeleton.layout();
    let of = |channel: usize| {
        let values = rows.iter().map(|row| f64::from(row[channel]));
        values.sum::<f64>() / rows.len() as f64
    };
    Some(layout.positions().map(of).collect())
}

/// Mean speed of the root over the ground, meters per second.
fn speed(skeleton: &Skeleton, joints: &Joints) -> Option<f64> {
    let fps = skeleton.description().fps;
    let step = |pair: &[[f64; 3]]| fps * (pair[1][0] - pair[0][0]).hypot(pair[1][2] - pair[0][2]);
    mean(joints.track(0).windows(2).map(step).collect())
}

/// Turning speed of the heading from frame to frame, degrees per second, positive to the left.
fn turns(skeleton: &Skeleton, joints: &Joints) -> Option<Vec<f64>> {
    let rows = rows(skeleton, joints).ok()?;
    let turn = FeatureLayout::ROOT.start;
    let fps = skeleton.description().fps;
    // The channel is the arcsine of the quaternion's y component: half of the turn.
    let turns = rows
        .iter()
        .map(|row| (2.0 * f64::from(row[turn])).to_degrees() * fps);
    Some(turns.collect())
}

#[cfg(test)]
mod tests {
    use kinegrad_data::humanml::walk;
    use kinegrad_motion::Quaternion;

    use super::*;

    fn walked() -> Joints {
        walk(5, 60, 1).features.joints()
    }

    fn changed(joints: &Joints, change: impl Fn([f64; 3]) -> [f64; 3]) -> Joints {
        let places = joints.as_slice().iter().map(|&place| change(place));
        Joints::new(places.collect(), joints.joints()).expect("whole frames")
    }

    #[test]
    fn where_a_motion_stands_and_faces_changes_nothing() {
        let skeleton = Skeleton::humanml3d();
        let joints = walked();
        let turn = Quaternion::from_yaw(2.0);
        let moved = changed(&joints, |place| {
            let [x, y, z] = turn.rotate(place);
            [x + 3.0, y, z - 1.0]
        });
        let report = |joints: &Joints| {
            let bones = bone_lengths(&skeleton, joints.frame(0));
            RolloutReport::compute(&skeleton, &[(bones, joints.clone())], &[])
        };
        let (here, there) = (report(&joints), report(&moved));
        for (a, b) in here.rows().into_iter().zip(there.rows()) {
            let (name, a, b) = (a.name, a.value, b.value);
            let apart = a.zip(b).map_or(0.0, |(a, b)| (a - b).abs());
            assert!(
                apart < 1e-3 * a.unwrap_or(0.0).abs() + 1e-6,
                "{name}: {a:?} {b:?}"
            );
        }
        assert!(here.speed > Some(0.3) && here.turn_rate > Some(0.0));
    }

    #[test]
    fn what_does_something_else_is_seen() {
        let skeleton = Skeleton::humanml3d();
        let walks = [walked(), walk(11, 60, 1).features.joints()];
        let report =
            |a: &Joints, b: &Joints| TextReport::compute(&skeleton, &[(a.clone(), b.clone())]);
        let same = report(&walks[0], &walks[0]);
        assert_eq!((same.speed_error, same.turn_error), (Some(0.0), Some(0.0)));
        // A walk scaled by two has twice the speed; a mirrored walk has the opposite curvature.
        let wide = changed(&walks[0], |[x, y, z]| [2.0 * x, y, 2.0 * z]);
        assert!(report(&walks[0], &wide).speed_error > Some(0.3));
        let other = report(&walks[0], &walks[1]);
        assert!(
            other.speed_error > Some(0.0) && other.turn_error > Some(1.0),
            "{other:?}"
        );
        let none = TextReport::compute(&skeleton, &[]);
        assert_eq!(none, TextReport::default());
    }

    #[test]
    fn what_falls_apart_is_seen() {
        let skeleton = Skeleton::humanml3d();
        let joints = walked();
        let bones = bone_lengths(&skeleton, joints.frame(0));
        let report = |joints: Joints| {
            let bones = bones.clone();
            RolloutReport::compute(&skeleton, &[(bones, joints)], &[])
        };
        let good = report(joints.clone());
        assert!(good.bone_change < Some(1e-3), "{:?}", good.bone_change);
        let grown = report(changed(&joints, |place| place.map(|value| 1.1 * value)));
        assert!((grown.bone_change.expect("bones") - 0.1).abs() < 1e-3);
        let sunk = report(changed(&joints, |[x, y, z]| [x, y - 0.2, z]));
        let lower = good.lowest_joint.zip(sunk.lowest_joint).map(|(a, b)| a - b);
        assert!((lower.expect("heights") - 0.2).abs() < 1e-9);
        assert!(grown.jerk > good.jerk && grown.speed > good.speed);
    }
}
