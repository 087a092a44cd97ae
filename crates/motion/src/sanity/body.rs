//! Checks of a body: bones, axes and the measures of its movement.

use super::{BodyFinding, Check, JERK_FACTOR, Profile, Report, Threshold, finite, people, range};
use crate::humanml::{Joints, Skeleton};
use crate::metrics::mean_jerk;
use crate::vector::{length, minus, unit};
use crate::{Representation, Statistics};

/// Allowed variation of a bone's length, relative to its mean.
const BONE_TOLERANCE: f64 = 0.05;
/// Allowed multiple of the training clips' root mean square speed.
const SPEED_FACTOR: f64 = 3.0;
/// A body whose axis has less of the height, and more than [`ALONG`] of another axis, stands along it.
const ACROSS: f64 = 0.5;
/// See [`ACROSS`].
const ALONG: f64 = 0.9;
/// Largest distance of the lowest joint from the floor, along the axis on which a body stands, metres.
const STANDS: f64 = 0.2;

/// Checks the joints of `rows`. `strict` compares the measures of movement with the motion of
/// `statistics`, or with captured people where these lack them; `ccmotion` does not measure movement.
pub(crate) fn check<R: Representation + ?Sized>(
    representation: &R,
    rows: &[f32],
    profile: Profile,
    statistics: Option<&Statistics>,
) -> Report {
    let finite = finite(rows);
    let joints = representation.joints(rows).filter(|_| finite.passed);
    let mut checks = vec![finite];
    let Some(joints) = &joints else {
        return Report::new(checks);
    };
    checks.extend(representation.channel_checks(rows));
    let (fps, skeleton) = (representation.fps(), representation.skeleton());
    if let Some(skeleton) = skeleton {
        checks.push(bone_length(joints, skeleton));
        checks.extend(up_axis(joints, skeleton));
    }
    if profile == Profile::Ccmotion {
        return Report::new(checks);
    }
    if let Some(rms_speed) = statistics.and_then(|training| training.rms_speed) {
        checks.push(speed(joints, fps, rms_speed));
    }
    let jerk_p95 = statistics.and_then(|training| training.jerk_p95);
    let jerk_p95 = jerk_p95.or(skeleton.map(|_| people::JERK_P95));
    checks.extend(jerk_p95.and_then(|jerk_p95| jerk(joints, fps, jerk_p95)));
    let names = skeleton.map(|skeleton| &skeleton.description().joint_names[..]);
    let findings = BodyFinding::all(joints, skeleton, fps, statistics);
    checks.extend(findings.iter().filter_map(|finding| finding.check(names)));
    Report::new(checks)
}

/// A check that fails where a body stands along another axis than y, or on its head.
pub(super) fn up_axis(joints: &Joints, skeleton: &Skeleton) -> Option<Check> {
    let [left, _, right, _] = skeleton.contact_joints();
    let face = skeleton.description().face_joints;
    let mut axis = [0.0; 3];
    for frame in (0..joints.frames()).map(|t| joints.frame(t)) {
        let middle = |a: usize, b: usize, i: usize| (frame[a][i] + frame[b][i]) / 2.0;
        let up = |i| middle(face.left_shoulder, face.right_shoulder, i) - middle(left, right, i);
        let up = unit([0, 1, 2].map(up));
        (0..3).for_each(|i| axis[i] += up[i] / joints.frames() as f64);
    }
    let lowest = |i: usize| {
        let heights = joints.as_slice().iter();
        range(heights.map(|place| axis[i].signum() * place[i]))[0]
    };
    let along = [0, 1, 2]
        .into_iter()
        .find(|&i| axis[i].abs() > ALONG && (i == 1 || lowest(i).abs() < STANDS));
    along.filter(|_| axis[1] < ACROSS).map(|i| {
        let sign = if axis[i] < 0.0 { "-" } else { "" };
        let name = ["x", "y", "z"][i];
        let message = format!("the body stands along {sign}{name}; y is up");
        Check::new("up_axis", axis[1], Threshold::Above(ACROSS), message)
    })
}

fn bone_length(joints: &Joints, skeleton: &Skeleton) -> Check {
    let frames = || (0..joints.frames()).map(|t| joints.frame(t));
    let variation = |[parent, child]: [usize; 2]| {
        let lengths = || frames().map(|frame| length(minus(frame[child], frame[parent])));
        let [shortest, longest] = range(lengths());
        let mean = lengths().sum::<f64>() / joints.frames() as f64;
        (longest - shortest) / mean.max(1e-6)
    };
    let bones = skeleton.chains().flatten();
    let largest = bones.map(variation).fold(0.0, f64::max);
    let percent = 100.0 * largest;
    let message = format!("largest change of a bone's length: {percent:.1} %");
    let allowed = Threshold::Below(BONE_TOLERANCE);
    Check::new("bone_length", largest, allowed, message)
}

fn speed(joints: &Joints, fps: f64, rms_speed: f64) -> Check {
    let steps = joints.frames().saturating_sub(1);
    let step = |t: usize| minus(joints.frame(t + 1)[0], joints.frame(t)[0]);
    let squares = (0..steps).map(|t| (fps * length(step(t))).powi(2));
    let rms = (squares.sum::<f64>() / steps.max(1) as f64).sqrt();
    let message = format!("root mean square of the root's speed: {rms:.2} m/s");
    let allowed = Threshold::AtMost(SPEED_FACTOR * rms_speed);
    Check::new("speed", rms, allowed, message)
}

pub(super) fn jerk(joints: &Joints, fps: f64, jerk_p95: f64) -> Option<Check> {
    let mean = mean_jerk(joints, fps)?;
    let message = format!("mean jerk of the joints: {mean:.1} m/s^3");
    let allowed = Threshold::AtMost(JERK_FACTOR * jerk_p95);
    Some(Check::new("jerk", mean, allowed, message))
}

#[cfg(test)]
mod tests;
