//! CC-MotionGen's five checks, as they stand.

use super::{Check, Report, Threshold, Value, finite_phrase, jerk, phase};
use crate::Motion;
use crate::kinematics::{acceleration_errors, mean_absolute_component, velocity_errors};

/// Thresholds of [`Profile::Document`](super::Profile::Document) (CC-MotionGen, section 10.1;
/// docs/sources.md, section 1.13).
#[derive(Clone, Debug, PartialEq)]
pub struct SanityThresholds {
    /// Smallest mean quaternion norm.
    pub quaternion_norm_min: f64,
    /// Largest mean quaternion norm.
    pub quaternion_norm_max: f64,
    /// Smallest phase.
    pub phase_min: f64,
    /// Largest phase.
    pub phase_max: f64,
    /// Bound of the mean jerk norm, metres per second cubed.
    pub max_jerk: f64,
    /// Bound of the mean absolute component of the velocity error, metres per second.
    pub max_velocity_error: f64,
    /// Bound of the mean absolute component of the acceleration error, metres per second squared.
    pub max_acceleration_error: f64,
}

impl Default for SanityThresholds {
    fn default() -> Self {
        Self {
            quaternion_norm_min: 0.95,
            quaternion_norm_max: 1.05,
            phase_min: 0.0,
            phase_max: 1.0,
            max_jerk: 50_000.0,
            max_velocity_error: 5.0,
            max_acceleration_error: 100.0,
        }
    }
}

impl SanityThresholds {
    /// Makes the five checks with these thresholds, and the line `finite` where it fails.
    pub fn check(&self, motion: &Motion) -> Report {
        let mut checks = vec![
            self.quaternion(motion),
            phase(motion, [self.phase_min, self.phase_max]),
            jerk(motion, Threshold::Below(self.max_jerk)),
            coherence(
                "velocity_coherence",
                "velocity",
                "m/s",
                &velocity_errors(motion),
                self.max_velocity_error,
            ),
            coherence(
                "accel_coherence",
                "acceleration",
                "m/s^2",
                &acceleration_errors(motion),
                self.max_acceleration_error,
            ),
        ];
        // The five do not look at style and angular velocity.
        let finite = finite_phrase(motion);
        if !finite.passed {
            checks.push(finite);
        }
        Report::new(checks)
    }

    fn quaternion(&self, motion: &Motion) -> Check {
        let frames = motion.frames();
        let mean = (0..frames)
            .map(|t| motion.quaternion(t).norm())
            .sum::<f64>()
            / frames as f64;
        let threshold = Threshold::Within([self.quaternion_norm_min, self.quaternion_norm_max]);
        Check::new(
            "quaternion",
            mean,
            threshold,
            format!("mean quaternion norm {mean:.4}"),
        )
    }
}

/// The mean absolute component of the `errors` of what a channel says, called `what`.
fn coherence(name: &'static str, what: &str, unit: &str, errors: &[[f64; 3]], below: f64) -> Check {
    let error = Value::Number(mean_absolute_component(errors));
    let message = format!("mean component of the {what} error {error} {unit}");
    Check::new(name, error, Threshold::Below(below), message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phrase::PHASE;
    use crate::phrase::{ACCELERATION, VELOCITY};
    use crate::wandering::wandering;

    /// Changes every frame of a good phrase, then names the checks that fail.
    fn failing(change: impl Fn(&mut Motion, usize)) -> Vec<&'static str> {
        let mut motion = wandering(7, 20);
        (0..20).for_each(|t| change(&mut motion, t));
        let report = SanityThresholds::default().check(&motion);
        report
            .checks
            .iter()
            .filter(|check| !check.passed)
            .map(|check| check.name)
            .collect()
    }

    fn add(motion: &mut Motion, t: usize, channels: std::ops::Range<usize>, offset: f64) {
        let moved = motion
            .vector(t, channels.clone())
            .map(|value| value + offset);
        motion.set_vector(t, channels, moved);
    }

    #[test]
    fn a_good_phrase_passes_five_checks() {
        let report = SanityThresholds::default().check(&wandering(7, 20));
        let names: Vec<_> = report.checks.iter().map(|check| check.name).collect();
        let document = [
            "quaternion",
            "phase",
            "jerk",
            "velocity_coherence",
            "accel_coherence",
        ];
        assert_eq!(names, document);
        assert!(report.passed);
    }

    #[test]
    fn each_check_fails_where_it_should() {
        assert!(failing(|_, _| ()).is_empty());
        let scale = |m: &mut Motion, t, factor| m.set_quaternion(t, m.quaternion(t).scale(factor));
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
        let zigzag = |m: &mut Motion, t: usize| add(m, t, ACCELERATION, [0.0, 1000.0][t % 2]);
        assert_eq!(failing(zigzag), ["jerk", "accel_coherence"]);
    }
}
