//! CC-MotionGen's five checks.

use kinegrad_settings::{InvalidSetting, in_range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Check, Report, Threshold, coherence, finite_phrase, jerk, phase};
use crate::derivatives::{acceleration_errors, mean_absolute_component, velocity_errors};
use crate::moments::mean;
use crate::{Phrase, Quaternion};

/// The bounds of the five checks (CC-MotionGen, section 10.1).
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct SanityThresholds {
    /// Smallest mean quaternion norm.
    pub quaternion_norm_min: f64,
    /// Largest mean quaternion norm.
    pub quaternion_norm_max: f64,
    /// Smallest phase, bars.
    pub phase_min: f64,
    /// Largest phase, bars.
    pub phase_max: f64,
    /// Bound of the mean jerk norm, metres per second cubed.
    pub max_jerk: f64,
    /// Largest mean absolute velocity error per component, metres per second.
    pub max_velocity_error: f64,
    /// Largest mean absolute acceleration error per component, metres per second squared.
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
    /// The bounds of a check by name, on single values; none for another check.
    pub fn of_check(&self, check: &str) -> Vec<f64> {
        match check {
            "quaternion" => vec![self.quaternion_norm_min, self.quaternion_norm_max],
            "phase" => vec![self.phase_min, self.phase_max],
            "jerk" => vec![self.max_jerk],
            _ => Vec::new(),
        }
    }

    /// # Errors
    /// Errors for negative bounds, and for a smallest value above the largest.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        in_range("quaternion_norm_max", self.quaternion_norm_max, 0.0..)?;
        let norms = 0.0..=self.quaternion_norm_max;
        in_range("quaternion_norm_min", self.quaternion_norm_min, norms)?;
        in_range("phase_max", self.phase_max, ..)?;
        in_range("phase_min", self.phase_min, ..=self.phase_max)?;
        in_range("max_jerk", self.max_jerk, 0.0..)?;
        in_range("max_velocity_error", self.max_velocity_error, 0.0..)?;
        let error = self.max_acceleration_error;
        in_range("max_acceleration_error", error, 0.0..)
    }
}

/// Makes the five checks of [`Profile::Ccmotion`](super::Profile::Ccmotion) (CC-MotionGen, section
/// 10.1; docs/sources.md, section 1.13) with these bounds, and adds a failed check `finite`.
pub fn check_thresholds(motion: &Phrase, thresholds: &SanityThresholds) -> Report {
    let bounds = thresholds;
    let mut checks = vec![
        quaternion(
            motion,
            [bounds.quaternion_norm_min, bounds.quaternion_norm_max],
        ),
        phase(motion, [bounds.phase_min, bounds.phase_max]),
        jerk(motion, Threshold::Below(bounds.max_jerk)),
        coherence(
            "velocity_coherence",
            mean_absolute_component(&velocity_errors(motion)),
            "mean component of the velocity error {error} m/s",
            bounds.max_velocity_error,
        ),
        coherence(
            "accel_coherence",
            mean_absolute_component(&acceleration_errors(motion)),
            "mean component of the acceleration error {error} m/s^2",
            bounds.max_acceleration_error,
        ),
    ];
    // The five checks ignore style and angular velocity.
    let finite = finite_phrase(motion);
    if !finite.passed {
        checks.push(finite);
    }
    Report::new(checks)
}

fn quaternion(motion: &Phrase, allowed: [f64; 2]) -> Check {
    let mean = mean(motion.quaternions().into_iter().map(Quaternion::norm));
    let message = format!("mean quaternion norm {mean:.4}");
    Check::new("quaternion", mean, Threshold::Within(allowed), message)
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
        let report = check_thresholds(&motion, &SanityThresholds::default());
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
        let report = check_thresholds(&random_phrase(7, 20), &SanityThresholds::default());
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

    #[test]
    fn each_bound_acts() {
        let motion = random_phrase(7, 20);
        let own = SanityThresholds::default();
        let failing = |thresholds: SanityThresholds| {
            let report = check_thresholds(&motion, &thresholds);
            let failed = report.checks.iter().filter(|check| !check.passed);
            failed.map(|check| check.name).collect::<Vec<_>>()
        };
        assert!(failing(own).is_empty());
        type Change = fn(&mut SanityThresholds);
        let changed: [(&str, Change); 7] = [
            ("quaternion", |own| own.quaternion_norm_min = 1.01),
            ("quaternion", |own| own.quaternion_norm_max = 0.99),
            ("phase", |own| own.phase_min = 0.9),
            ("phase", |own| own.phase_max = 0.1),
            ("jerk", |own| own.max_jerk = 1e-3),
            ("velocity_coherence", |own| own.max_velocity_error = 1e-9),
            ("accel_coherence", |own| own.max_acceleration_error = 1e-9),
        ];
        for (name, change) in changed {
            let mut thresholds = own;
            change(&mut thresholds);
            assert_eq!(failing(thresholds), [name]);
        }
        assert!(own.validate().is_ok());
        let reversed = SanityThresholds {
            phase_min: 2.0,
            ..own
        };
        assert_eq!(reversed.validate().unwrap_err().key, "phase_min");
    }
}
