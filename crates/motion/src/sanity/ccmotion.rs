//! CC-MotionGen's five checks.

use super::{Check, Report, Threshold, coherence, finite_phrase, jerk, phase};
use crate::derivatives::{acceleration_errors, mean_absolute_component, velocity_errors};
use crate::moments::mean;
use crate::{Phrase, Quaternion};

/// Smallest and largest mean quaternion norm.
const QUATERNION_NORM: [f64; 2] = [0.95, 1.05];

/// Bound of the mean jerk norm, metres per second cubed.
const MAX_JERK: f64 = 50_000.0;

/// Upper bound of the mean absolute velocity error per component, metres per second.
const MAX_VELOCITY_ERROR: f64 = 5.0;

/// Upper bound of the mean absolute acceleration error per component, metres per second squared.
const MAX_ACCELERATION_ERROR: f64 = 100.0;

/// Makes the five checks of [`Profile::Ccmotion`](super::Profile::Ccmotion) (CC-MotionGen, section
/// 10.1; docs/sources.md, section 1.13), and adds a failed check `finite`.
pub(super) fn check(motion: &Phrase) -> Report {
    let mut checks = vec![
        quaternion(motion),
        phase(motion, [0.0, 1.0]),
        jerk(motion, Threshold::Below(MAX_JERK)),
        coherence(
            "velocity_coherence",
            mean_absolute_component(&velocity_errors(motion)),
            "mean component of the velocity error {error} m/s",
            MAX_VELOCITY_ERROR,
        ),
        coherence(
            "accel_coherence",
            mean_absolute_component(&acceleration_errors(motion)),
            "mean component of the acceleration error {error} m/s^2",
            MAX_ACCELERATION_ERROR,
        ),
    ];
    // The five checks ignore style and angular velocity.
    let finite = finite_phrase(motion);
    if !finite.passed {
        checks.push(finite);
    }
    Report::new(checks)
}

fn quaternion(motion: &Phrase) -> Check {
    let mean = mean(motion.quaternions().into_iter().map(Quaternion::norm));
    let message = format!("mean quaternion norm {mean:.4}");
    let threshold = Threshold::Within(QUATERNION_NORM);
    Check::new("quaternion", mean, threshold, message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phrase::PHASE;
    use crate::phrase::{ACCELERATION, VELOCITY};
    use crate::random_phrase::random_phrase;

    /// Changes every frame of a good phrase, then names the checks that fail.
    fn failing(change: impl Fn(&mut Phrase, usize)) -> Vec<&'static str> {
        let mut motion = random_phrase(7, 20);
        (0..20).for_each(|t| change(&mut motion, t));
        let report = check(&motion);
        report
            .checks
            .iter()
            .filter(|check| !check.passed)
            .map(|check| check.name)
            .collect()
    }

    fn add(motion: &mut Phrase, t: usize, channels: std::ops::Range<usize>, offset: f64) {
        let moved = motion
            .vector(t, channels.clone())
            .map(|value| value + offset);
        motion.set_vector(t, channels, moved);
    }

    #[test]
    fn a_good_phrase_passes_five_checks() {
        let report = check(&random_phrase(7, 20));
        let names: Vec<_> = report.checks.iter().map(|check| check.name).collect();
        let published = [
            "quaternion",
            "phase",
            "jerk",
            "velocity_coherence",
            "accel_coherence",
        ];
        assert_eq!(names, published);
        assert!(report.passed);
    }

    #[test]
    fn each_check_fails_where_it_should() {
        assert!(failing(|_, _| ()).is_empty());
        let scale = |m: &mut Phrase, t, factor| m.set_quaternion(t, m.quaternion(t).scale(factor));
        assert_eq!(failing(|m, t| scale(m, t, 1.06)), ["quaternion"]);
        assert_eq!(failing(|m, t| scale(m, t, 0.94)), ["quaternion"]);
        assert_eq!(failing(|m, t| m.frame_mut(t)[PHASE] += 0.9), ["phase"]);
        assert_eq!(failing(|m, t| m.frame_mut(t)[PHASE] -= 0.1), ["phase"]);
        assert_eq!(
            failing(|m, t| add(m, t, VELOCITY, 5.1)),
            ["velocity_coherence"]
        );
        assert!(failing(|m, t| add(m, t, VELOCITY, 4.9)).is_empty());
        assert_eq!(
            failing(|m, t| add(m, t, ACCELERATION, 101.0)),
            ["accel_coherence"]
        );
        assert!(failing(|m, t| add(m, t, ACCELERATION, 99.0)).is_empty());
        let zigzag = |m: &mut Phrase, t: usize| add(m, t, ACCELERATION, [0.0, 1000.0][t % 2]);
        assert_eq!(failing(zigzag), ["jerk", "accel_coherence"]);
    }
}
