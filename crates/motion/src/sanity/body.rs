//! Checks of a body: bones that keep their lengths, feet on the floor, and how jerky it moves.

use super::{Check, Profile, Report, Threshold, Value, range};
use crate::humanml::Joints;
use crate::metrics::JointTracks;
use crate::{Error, Statistics};

/// How much a bone's length may vary, over its mean.
const BONE_TOLERANCE: f64 = 0.05;
/// How far below the floor a joint may be, metres.
const FLOOR_TOLERANCE: f64 = 0.05;
/// Share of the steps in which a foot may slide.
const SKATING_SHARE: f64 = 0.5;
/// How many times the training clips' root mean square the root's speed may be.
const SPEED_FACTOR: f64 = 3.0;
/// How many times the training clips' 95th percentile the mean jerk may be.
const JERK_FACTOR: f64 = 3.0;

/// A body whose joints are checked.
pub(crate) struct Body<'a> {
    /// Parent and child.
    pub bones: &'a [[usize; 2]],
    /// The joints of the feet.
    pub feet: &'a [usize],
    pub fps: f64,
}

impl Body<'_> {
    /// Checks `joints`, which `rows` stand for; none where a value is not finite. The profile
    /// `strict` compares with training clips, too.
    ///
    /// # Errors
    /// [`Error::StatisticsNeeded`] if the profile is strict and there are none, or they do not say
    /// how lively training motion is.
    pub fn check(
        &self,
        rows: &[f32],
        joints: Option<&Joints>,
        profile: Profile,
        statistics: Option<&Statistics>,
    ) -> Result<Report, Error> {
        let mut checks = vec![finite(rows)];
        let training = match profile {
            Profile::Document => None,
            Profile::Strict => {
                let measured = |training: &Statistics| training.rms_speed.zip(training.jerk_p95);
                Some(
                    statistics
                        .and_then(measured)
                        .ok_or(Error::StatisticsNeeded)?,
                )
            }
        };
        if let Some(joints) = joints {
            checks.extend([self.bone_length(joints), floor(joints)]);
            checks.extend(self.skating(joints));
            if let Some((rms_speed, jerk_p95)) = training {
                checks.push(self.speed(joints, rms_speed));
                checks.extend(self.jerk(joints, jerk_p95));
            }
        }
        Ok(Report::new(checks))
    }

    fn tracks<'j>(&self, joints: &'j Joints) -> JointTracks<'j> {
        JointTracks::new(joints.as_slice(), joints.joints(), self.fps)
    }

    fn bone_length(&self, joints: &Joints) -> Check {
        let variation = |&[parent, child]: &[usize; 2]| {
            let lengths: Vec<f64> = (0..joints.frames())
                .map(|t| {
                    let (a, b) = (joints.frame(t)[parent], joints.frame(t)[child]);
                    crate::rotation::length([0, 1, 2].map(|axis| b[axis] - a[axis]))
                })
                .collect();
            let [shortest, longest] = range(lengths.iter().copied());
            let mean = lengths.iter().sum::<f64>() / lengths.len() as f64;
            (longest - shortest) / mean.max(1e-6)
        };
        let largest = self.bones.iter().map(variation).fold(0.0, f64::max);
        Check::new(
            "bone_length",
            Value::Number(largest),
            Threshold::Below(BONE_TOLERANCE),
            format!(
                "largest change of a bone's length: {:.1} %",
                100.0 * largest
            ),
        )
    }

    fn skating(&self, joints: &Joints) -> Option<Check> {
        let ratio = self.tracks(joints).skating_ratio(self.feet)?;
        Some(Check::new(
            "skating",
            Value::Number(ratio),
            Threshold::AtMost(SKATING_SHARE),
            format!("a foot slides in {:.0} % of the steps", 100.0 * ratio),
        ))
    }

    fn speed(&self, joints: &Joints, rms_speed: f64) -> Check {
        let root = |t: usize| joints.frame(t)[0];
        let steps = joints.frames().saturating_sub(1);
        let speed = |t: usize| {
            let (a, b) = (root(t), root(t + 1));
            self.fps * crate::rotation::length([0, 1, 2].map(|axis| b[axis] - a[axis]))
        };
        let squares = (0..steps).map(|t| speed(t).powi(2)).sum::<f64>();
        let rms = (squares / steps.max(1) as f64).sqrt();
        Check::new(
            "speed",
            Value::Number(rms),
            Threshold::AtMost(SPEED_FACTOR * rms_speed),
            format!("root mean square of the root's speed {rms:.2} m/s"),
        )
    }

    fn jerk(&self, joints: &Joints, jerk_p95: f64) -> Option<Check> {
        let mean = self.tracks(joints).mean_jerk()?;
        Some(Check::new(
            "jerk",
            Value::Number(mean),
            Threshold::AtMost(JERK_FACTOR * jerk_p95),
            format!("mean jerk of the joints {mean:.1} m/s^3"),
        ))
    }
}

fn finite(rows: &[f32]) -> Check {
    let bad = rows.iter().filter(|value| !value.is_finite()).count();
    Check::new(
        "finite",
        Value::Number(bad as f64),
        Threshold::AtMost(0.0),
        match bad {
            0 => "all values are finite".to_owned(),
            _ => format!("{bad} of {} values are not finite", rows.len()),
        },
    )
}

fn floor(joints: &Joints) -> Check {
    let heights = joints.as_slice().iter().map(|place| place[1]);
    let [lowest, _] = range(heights);
    Check::new(
        "floor",
        Value::Number(lowest),
        Threshold::Above(-FLOOR_TOLERANCE),
        format!("lowest joint at {lowest:.3} m"),
    )
}
