//! Checks of a captured body at the frame rate of its file.

use super::{BodyFinding, Report, body, people};
use crate::humanml::{Joints, Skeleton};
use crate::{BodyMeasure, BodyValue, Statistics};

/// A body of any skeleton, captured at any frame rate.
#[derive(Clone, Debug)]
pub struct CapturedBody<'a> {
    /// Joint positions, metres, +y up.
    pub joints: &'a Joints,
    /// Their frames per second.
    pub fps: f64,
    /// The same motion at about 20 frames per second, the rate of the reference motion.
    pub resampled: &'a Joints,
    /// Frames per second of `resampled`.
    pub resampled_fps: f64,
    /// Names of the joints.
    pub joint_names: &'a [String],
    /// The skeleton, if the joints are its joints.
    pub skeleton: Option<&'a Skeleton>,
    /// Largest turn of the body, degrees per second, measured otherwise than by a skeleton.
    pub largest_turn: Option<BodyValue>,
}

/// Checks a captured body as [`Profile::Strict`](super::Profile::Strict). Extremes of single frames
/// are measured at the file's rate, everything else at the rate of the reference motion. Without a
/// skeleton, only the measures that need none are checked.
pub fn check_capture(captured: &CapturedBody<'_>, statistics: Option<&Statistics>) -> Report {
    let CapturedBody {
        joints,
        fps,
        resampled,
        resampled_fps,
        joint_names,
        skeleton,
        largest_turn,
    } = *captured;
    let jerk_p95 = statistics.and_then(|training| training.jerk_p95);
    let jerk_p95 = jerk_p95.unwrap_or(people::JERK_P95);
    let mut checks = Vec::new();
    checks.extend(skeleton.and_then(|skeleton| body::up_axis(joints, skeleton)));
    checks.extend(body::jerk(resampled, resampled_fps, jerk_p95));
    let people = people::bodies();
    for finding in BodyFinding::all(resampled, skeleton, resampled_fps, statistics) {
        let value = match finding.measure {
            BodyMeasure::FastestRoot
            | BodyMeasure::FastestJoint
            | BodyMeasure::LargestTurn
            | BodyMeasure::Lowest => finding.measure.of(joints, skeleton, fps),
            _ => Some(BodyValue {
                frame: (finding.value.frame)
                    .map(|frame| (frame as f64 / resampled_fps * fps).round() as usize),
                ..finding.value
            }),
        };
        let finding = value.map(|value| BodyFinding { value, ..finding });
        checks.extend(finding.and_then(|finding| finding.check(Some(joint_names))));
    }
    let turn = largest_turn.map(|value| BodyFinding {
        measure: BodyMeasure::LargestTurn,
        value,
        reference: people.get(BodyMeasure::LargestTurn.name()).copied(),
    });
    checks.extend(turn.and_then(|turn| turn.check(Some(joint_names))));
    Report::new(checks)
}
