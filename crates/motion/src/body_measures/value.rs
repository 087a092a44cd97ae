//! The values of the measures.

use super::statue::longest_statue;
use super::time_direction::time_direction;
use super::{BodyMeasure, BodyValue};
use crate::derivatives::jerk_of;
use crate::humanml::{FaceJoints, Joints, Skeleton};
use crate::metrics::{fastest_step, jerk_norms, lowest_heights, mean_jerk, sliding_ratio};
use crate::moments;
use crate::quantiles::{median, percentile};
use crate::vector::{dot, length, minus, plus};

/// A joint slower than this is still, metres per second.
const STILL_SPEED: f64 = 0.02;

/// Added to the speed of the limbs in [`BodyMeasure::Glide`], metres per second.
const GLIDE_OFFSET: f64 = 0.05;

/// Mean speed of the root on the ground from which on a body travels, metres per second.
const TRAVELLING: f64 = 0.5;

/// Height of the lowest joint over its usual lowest one above which a body is in flight, metres.
const FLIGHT: f64 = 0.1;

/// Percentile of the lowest joint's heights that is the usual one: bodies without toes stand higher.
const STANDING: f64 = 10.0;

/// Greatest usual height of the lowest joint, metres.
const HIGHEST_STANDING: f64 = 0.15;

impl BodyMeasure {
    /// Its value; `None` if the clip is too short, the skeleton has no legs, or the measure needs a
    /// skeleton that is not given. A root alone has speed and jerk.
    pub fn of(self, joints: &Joints, skeleton: Option<&Skeleton>, fps: f64) -> Option<BodyValue> {
        if joints.joints() == 1 && !self.is_of_a_root() {
            return None;
        }
        let frames = joints.frames();
        let steps = 0..frames - 1;
        let peak = |value, frame, joint| BodyValue {
            value,
            frame,
            joint,
        };
        let mean = |value: f64| peak(value, None, None);
        let step =
            |t: usize, joint: usize| minus(joints.frame(t + 1)[joint], joints.frame(t)[joint]);
        let joint_speed = |(t, joint): (usize, usize)| fps * length(step(t, joint));
        let root_speed = |t: usize| {
            let [x, _, z] = step(t, 0);
            fps * x.hypot(z)
        };
        let travelling_speed =
            || steps.clone().map(root_speed).sum::<f64>() / steps.len().max(1) as f64;
        let each = || {
            steps
                .clone()
                .flat_map(|t| (0..joints.joints()).map(move |j| (t, j)))
        };
        // The body's sides, in a frame.
        let across = |face: &FaceJoints, t: usize| {
            let at = |joint: usize| joints.frame(t)[joint];
            let hips = minus(at(face.left_hip), at(face.right_hip));
            plus(hips, minus(at(face.left_shoulder), at(face.right_shoulder)))
        };
        let turn_rate = |face: &FaceJoints, t: usize| {
            let (a, b) = (across(face, t), across(face, t + 1));
            let cosine = dot(a, b) / (length(a) * length(b)).max(f64::MIN_POSITIVE);
            fps * cosine.clamp(-1.0, 1.0).acos().to_degrees()
        };
        match self {
            Self::FastestRoot => {
                let ground = joints.track(0).into_iter().map(|[x, _, z]| [x, z]);
                let fastest = fastest_step(&ground.collect::<Vec<_>>(), fps)?;
                Some(peak(fastest.speed, Some(fastest.frame), Some(0)))
            }
            Self::MeanSpeed => {
                let speeds: Vec<f64> = each().map(joint_speed).collect();
                (!speeds.is_empty()).then(|| mean(moments::mean(speeds.into_iter())))
            }
            Self::Speed99 => {
                let speeds: Vec<f64> = each().map(joint_speed).collect();
                (!speeds.is_empty()).then(|| mean(percentile(speeds, 99.0)))
            }
            Self::FastestJoint => {
                let fastest = extreme(each().map(|at| (at, joint_speed(at))));
                fastest.map(|((t, joint), value)| peak(value, Some(t + 1), Some(joint)))
            }
            Self::Jerk99 => {
                let jerks = jerk_norms(joints, fps);
                (!jerks.is_empty()).then(|| mean(percentile(jerks, 99.0)))
            }
            Self::MeanJerk => mean_jerk(joints, fps).map(mean),
            Self::LargestJerk => {
                let jerks = (0..joints.joints()).flat_map(|joint| {
                    let jerks = jerk_of(&joints.track(joint), fps).into_iter().enumerate();
                    // A jump into a frame has its largest jerk two frames earlier.
                    jerks.map(move |(t, jerk)| ((t + 2, joint), length(jerk)))
                });
                let largest = extreme(jerks);
                largest.map(|((t, joint), value)| peak(value, Some(t), Some(joint)))
            }
            Self::LargestTurn => {
                let face = &skeleton?.description().face_joints;
                let largest = extreme(steps.map(|t| (t, turn_rate(face, t))));
                largest.map(|(t, value)| peak(value, Some(t + 1), None))
            }
            Self::TurnAcceleration => {
                let face = &skeleton?.description().face_joints;
                let rates: Vec<f64> = steps.map(|t| turn_rate(face, t)).collect();
                let changes = rates.windows(2).map(|pair| fps * (pair[1] - pair[0]).abs());
                let largest = extreme(changes.enumerate());
                largest.map(|(t, value)| peak(value, Some(t + 1), None))
            }
            Self::RootAcceleration => {
                let velocities: Vec<_> = steps.map(|t| step(t, 0)).collect();
                let changes = velocities.windows(2);
                let changes = changes.map(|pair| fps * fps * length(minus(pair[1], pair[0])));
                let largest = extreme(changes.enumerate());
                largest.map(|(t, value)| peak(value, Some(t + 1), Some(0)))
            }
            Self::StillShare => {
                let moves =
                    |t: usize| (0..joints.joints()).any(|j| joint_speed((t, j)) >= STILL_SPEED);
                let still = steps.clone().filter(|&t| !moves(t)).count();
                (frames > 1).then(|| mean(still as f64 / steps.len() as f64))
            }
            Self::Glide => {
                let around =
                    |(t, joint): (usize, usize)| fps * length(minus(step(t, joint), step(t, 0)));
                let limbs = each().map(around).sum::<f64>() / each().count().max(1) as f64;
                (frames > 1).then(|| mean(travelling_speed() / (limbs + GLIDE_OFFSET)))
            }
            Self::Statue => Some(mean(longest_statue(joints, skeleton?, fps))),
            Self::TimeDirection => {
                let [left, _, right, _] = skeleton?.contact_joints();
                let travels = travelling_speed() >= TRAVELLING;
                let value = travels.then(|| time_direction(joints, [left, right], fps));
                Some(mean(value.unwrap_or(0.0)))
            }
            Self::Skating => {
                let [_, left, _, right] = skeleton?.contact_joints();
                sliding_ratio(joints, fps, &[left, right]).map(mean)
            }
            Self::Lowest => {
                let depth = |(t, joint): (usize, usize)| -joints.frame(t)[joint][1];
                let all = (0..frames).flat_map(|t| (0..joints.joints()).map(move |j| (t, j)));
                let lowest = extreme(all.map(|at| (at, depth(at))));
                lowest.map(|((t, joint), depth)| peak(-depth, Some(t), Some(joint)))
            }
            Self::Floating => Some(mean(median(lowest_heights(joints)))),
            Self::LongestFlight => {
                let heights = lowest_heights(joints);
                let standing = percentile(heights.clone(), STANDING);
                let most = FLIGHT + standing.clamp(0.0, HIGHEST_STANDING);
                let flights = heights.split(|height| *height <= most);
                let longest = flights.map(<[f64]>::len).max().unwrap_or(0);
                Some(mean(longest as f64 / fps))
            }
            Self::RootHeight => {
                let leg = leg_length(joints, skeleton?)?;
                let heights = joints.track(0).iter().map(|place| place[1]).collect();
                (leg > f64::EPSILON).then(|| mean(median(heights) / leg))
            }
            Self::LegLength => leg_length(joints, skeleton?).map(mean),
        }
    }
}

/// The first of the largest values, with its place.
fn extreme<P>(values: impl Iterator<Item = (P, f64)>) -> Option<(P, f64)> {
    values.reduce(|best, other| if other.1 > best.1 { other } else { best })
}

/// Mean length of thigh and shank, metres.
fn leg_length(joints: &Joints, skeleton: &Skeleton) -> Option<f64> {
    let legs = skeleton.legs();
    let first = joints.frame(0);
    let of = |leg: &crate::feet::Leg| {
        let bone = |a: usize, b: usize| length(minus(first[a], first[b]));
        bone(leg.hip, leg.knee) + bone(leg.knee, leg.ankle)
    };
    (!legs.is_empty()).then(|| legs.iter().map(of).sum::<f64>() / legs.len() as f64)
}
