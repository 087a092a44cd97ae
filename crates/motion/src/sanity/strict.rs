//! Checks of every frame, with bounds taken from the training phrases.

use super::{Check, JERK_FACTOR, Report, Threshold, coherence, finite_phrase, jerk, phase, range};
use crate::kinematics::{acceleration_errors, mean_norm, velocity_errors};
use crate::{Motion, Statistics};

/// Largest deviation of a quaternion's norm from 1.
const NORM_TOLERANCE: f64 = 1e-3;

/// Share of the training phrases' root mean square at which an error of velocity or acceleration
/// counts as incoherent.
const COHERENCE_SHARE: f64 = 0.1;

/// Makes the checks of [`Profile::Strict`](super::Profile::Strict); none where the statistics do
/// not say how lively training motion is.
pub(super) fn check(motion: &Motion, training: &Statistics) -> Option<Report> {
    Some(Report::new(vec![
        finite_phrase(motion),
        quaternion_norm(motion),
        quaternion_sign(motion),
        phase(motion, [0.0, 1.0]),
        coherence(
            "velocity_coherence",
            mean_norm(&velocity_errors(motion)),
            "mean velocity error {error} m/s",
            COHERENCE_SHARE * training.rms_speed?,
        ),
        coherence(
            "accel_coherence",
            mean_norm(&acceleration_errors(motion)),
            "mean acceleration error {error} m/s^2",
            COHERENCE_SHARE * training.rms_acceleration?,
        ),
        jerk(motion, Threshold::AtMost(JERK_FACTOR * training.jerk_p95?)),
    ]))
}

fn quaternion_norm(motion: &Motion) -> Check {
    let deviations = (0..motion.frames()).map(|t| (motion.quaternion(t).norm() - 1.0).abs());
    let [_, largest] = range(deviations);
    Check::new(
        "quaternion_norm",
        largest,
        Threshold::Below(NORM_TOLERANCE),
        format!("largest deviation of a quaternion's norm from 1: {largest:.2e}"),
    )
}

fn quaternion_sign(motion: &Motion) -> Check {
    let neighbours = 1..motion.frames();
    let [smallest, _] = if neighbours.is_empty() {
        [1.0; 2] // A single frame has no neighbour to disagree with.
    } else {
        range(neighbours.map(|t| motion.quaternion(t - 1).dot(motion.quaternion(t))))
    };
    Check::new(
        "quaternion_sign",
        smallest,
        Threshold::Above(0.0),
        format!("smallest product of neighbouring quaternions: {smallest:.4}"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phrase::PHASE;
    use crate::phrase::{ACCELERATION, VELOCITY};
    use crate::wandering::wandering;

    fn training() -> Statistics {
        let phrases: Vec<Motion> = (0..20).map(|seed| wandering(seed, 60)).collect();
        crate::phrase_statistics(&phrases).unwrap()
    }

    /// Changes one frame of a good phrase, then names the checks that fail.
    fn failing(change: impl Fn(&mut Motion)) -> Vec<&'static str> {
        let mut motion = wandering(7, 60);
        change(&mut motion);
        let report = check(&motion, &training()).unwrap();
        report
            .checks
            .iter()
            .filter(|check| !check.passed)
            .map(|check| check.name)
            .collect()
    }

    fn add_everywhere(motion: &mut Motion, channels: std::ops::Range<usize>, offset: [f64; 3]) {
        for t in 0..motion.frames() {
            let value = motion.vector(t, channels.clone());
            motion.set_vector(
                t,
                channels.clone(),
                [0, 1, 2].map(|axis| value[axis] + offset[axis]),
            );
        }
    }

    #[test]
    fn coherent_phrases_pass() {
        for seed in 0..20 {
            let report = check(&wandering(seed, 60), &training()).unwrap();
            assert!(report.passed, "{report:#?}");
            assert_eq!(report.checks.len(), 7);
        }
    }

    #[test]
    fn a_single_frame_of_wrong_norm_or_sign_fails() {
        let scale =
            |factor: f64| failing(move |m| m.set_quaternion(30, m.quaternion(30).scale(factor)));
        assert_eq!(scale(1.002), ["quaternion_norm"]);
        assert_eq!(scale(0.998), ["quaternion_norm"]);
        assert!(scale(1.0005).is_empty());
        assert_eq!(scale(-1.0), ["quaternion_sign"]);
    }

    #[test]
    fn phase_outside_the_bar_fails() {
        assert_eq!(failing(|m| m.frame_mut(59)[PHASE] = 1.001), ["phase"]);
        assert_eq!(failing(|m| m.frame_mut(0)[PHASE] = -0.001), ["phase"]);
    }

    #[test]
    fn errors_beyond_a_tenth_of_the_training_scale_fail() {
        let statistics = training();
        // By its Euclidean norm, 0.6 / 0.8 of the offset along two axes.
        let offset = |share: f64, scale: f64| [0.6 * share * scale, 0.0, -0.8 * share * scale];
        let (speed, rate) = (
            statistics.rms_speed.unwrap(),
            statistics.rms_acceleration.unwrap(),
        );
        let velocity = |share| failing(|m| add_everywhere(m, VELOCITY, offset(share, speed)));
        assert!(velocity(0.099).is_empty());
        assert_eq!(velocity(0.101), ["velocity_coherence"]);
        let acceleration =
            |share| failing(|m| add_everywhere(m, ACCELERATION, offset(share, rate)));
        assert!(acceleration(0.099).is_empty());
        assert_eq!(acceleration(0.101), ["accel_coherence"]);
    }

    #[test]
    fn trembling_fails() {
        let zigzag = |times: f64| {
            let size = times * training().jerk_p95.unwrap() / 30.0;
            failing(move |m| {
                (0..60)
                    .for_each(|t| m.set_vector(t, ACCELERATION, [0.0, size * (t % 2) as f64, 0.0]))
            })
        };
        assert!(zigzag(3.01).contains(&"jerk"));
        assert!(!zigzag(2.99).contains(&"jerk"));
    }
}
