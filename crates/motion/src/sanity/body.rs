//! Checks of a body: bone lengths, feet, floor and jerk.

use super::{Check, JERK_FACTOR, Profile, Report, Threshold, finite, range};
use crate::humanml::{Joints, Skeleton};
use crate::metrics::{mean_jerk, sliding_ratio};
use crate::vector::{length, minus};
use crate::{Error, Representation, Statistics};

/// Allowed variation of a bone's length, relative to its mean.
const BONE_TOLERANCE: f64 = 0.05;
/// Allowed depth of a joint below the floor, metres.
const FLOOR_TOLERANCE: f64 = 0.05;
/// Allowed share of the steps in which a foot slides.
const SKATING_SHARE: f64 = 0.5;
/// Allowed multiple of the training clips' root mean square speed.
const SPEED_FACTOR: f64 = 3.0;

/// Checks the joints of `rows`; `strict` also compares with training motion.
pub(crate) fn check<R: Representation + ?Sized>(
    representation: &R,
    rows: &[f32],
    profile: Profile,
    statistics: Option<&Statistics>,
) -> Result<Report, Error> {
    let mut checks = vec![finite(rows)];
    let training = match profile {
        Profile::Ccmotion => None,
        Profile::Strict => Some(statistics.ok_or(Error::StatisticsNeeded)?),
    };
    let joints = representation.joints(rows);
    let Some(joints) = &joints else {
        return Ok(Report::new(checks));
    };
    let fps = representation.fps();
    if let Some(skeleton) = representation.skeleton() {
        checks.extend([bone_length(joints, skeleton), floor(joints)]);
        checks.extend(skating(joints, skeleton, fps));
    }
    if let Some(training) = training {
        if let Some(rms_speed) = training.rms_speed {
            checks.push(speed(joints, fps, rms_speed));
        }
        let jerk_p95 = training.jerk_p95.ok_or(Error::StatisticsNeeded)?;
        checks.extend(jerk(joints, fps, jerk_p95));
    }
    Ok(Report::new(checks))
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

fn skating(joints: &Joints, skeleton: &Skeleton, fps: f64) -> Option<Check> {
    let ratio = sliding_ratio(joints, fps, &skeleton.contact_joints())?;
    let message = format!("a foot slides in {:.0} % of the steps", 100.0 * ratio);
    let allowed = Threshold::AtMost(SKATING_SHARE);
    Some(Check::new("skating", ratio, allowed, message))
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

fn jerk(joints: &Joints, fps: f64, jerk_p95: f64) -> Option<Check> {
    let mean = mean_jerk(joints, fps)?;
    let message = format!("mean jerk of the joints: {mean:.1} m/s^3");
    let allowed = Threshold::AtMost(JERK_FACTOR * jerk_p95);
    Some(Check::new("jerk", mean, allowed, message))
}

fn floor(joints: &Joints) -> Check {
    let heights = joints.as_slice().iter().map(|place| place[1]);
    let [lowest, _] = range(heights);
    let message = format!("lowest joint at {lowest:.3} m");
    let allowed = Threshold::Above(-FLOOR_TOLERANCE);
    Check::new("floor", lowest, allowed, message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::humanml::test_clip;
    use crate::representation::{JointPositions, statistics_of};

    fn representation() -> JointPositions {
        JointPositions {
            skeleton: Skeleton::humanml3d(),
        }
    }

    /// The failing checks after `change` of the joints of a good clip, `[frames, 22, 3]`.
    fn failing(change: impl Fn(usize, usize, &mut [f32; 3])) -> Vec<&'static str> {
        let representation = representation();
        let mut good = test_clip(&representation.skeleton, 40).to_f32();
        // At this height no swinging foot reaches the floor.
        good.iter_mut()
            .skip(1)
            .step_by(3)
            .for_each(|height| *height += 0.5);
        let statistics = statistics_of(&representation, [&good[..]]);
        let training = Statistics {
            rms_speed: Some(1.0),
            ..statistics.expect("a clip")
        };
        let mut rows = good;
        let (places, _) = rows.as_chunks_mut::<3>();
        for (index, place) in places.iter_mut().enumerate() {
            change(index / 22, index % 22, place);
        }
        let report = representation.check(&rows, Profile::Strict, Some(&training));
        let failed = report.expect("a report").checks.into_iter();
        failed
            .filter(|check| !check.passed)
            .map(|check| check.name)
            .collect()
    }

    #[test]
    fn each_check_has_a_motion_that_fails_it() {
        assert!(failing(|_, _, _| ()).is_empty());
        assert_eq!(
            failing(|t, j, p| if (t, j) == (7, 3) {
                p[1] = f32::NAN
            }),
            ["finite"]
        );
        let stretched = failing(|t, j, p| {
            if j == 20 {
                p[0] += 0.004 * t as f32
            }
        });
        assert_eq!(stretched, ["bone_length"]);
        // Feet below the floor are on the ground too and slide.
        assert_eq!(failing(|_, _, p| p[1] -= 3.0), ["floor", "skating"]);
        assert_eq!(failing(|t, _, p| p[0] += 0.3 * t as f32), ["speed"]);
        let trembling = failing(|t, _, p| p[1] += 0.05 * (t % 2) as f32);
        assert_eq!(trembling, ["jerk"]);
    }

    #[test]
    fn feet_that_slide_along_the_floor_fail() {
        let [.., foot] = Skeleton::humanml3d().contact_joints();
        let sliding = failing(|t, j, p| {
            if j == foot {
                *p = [0.1 * t as f32, 0.01, 0.0]
            }
        });
        assert!(sliding.contains(&"skating"), "{sliding:?}");
    }
}
