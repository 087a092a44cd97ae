//! Plausibility checks of a phrase.
//!
//! [`Profile::Ccmotion`] makes the five checks of CC-MotionGen, section 10.1 (docs/sources.md,
//! section 1.13). Most of these checks cannot fail on bad motion (section 1.14, hazard 10). The
//! checks are means, the jerk bound exceeds all clamped motion, and a path may shake under smooth
//! channels. [`Profile::Strict`] checks every frame, the derivatives against the poses, and the
//! [measures](crate::MotionMeasure) of the poses against the training phrases.

pub(crate) mod body;
mod bounds;
mod capture;
mod ccmotion;
mod finding;
mod people;
mod report;
mod strict;

use serde::{Deserialize, Serialize};

pub(crate) use bounds::FACTOR;
pub use bounds::{Bounds, Margin};
pub use capture::{CapturedBody, check_capture};
pub use ccmotion::{SanityThresholds, check_thresholds};
pub use finding::BodyFinding;
pub use report::{Check, Report, Threshold, Value};

use crate::derivatives::mean_jerk_norm;
use crate::phrase::PHASE;
use crate::{Phrase, Statistics, channel_name};

/// Allowed multiple of the training motion's 95th percentile of the mean jerk.
const JERK_FACTOR: f64 = 3.0;

/// Set of checks.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Profile {
    /// Every frame, channels against poses, and poses against the training phrases, or against
    /// captured people where no training phrases are known.
    #[default]
    Strict,
    /// CC-MotionGen's five checks and thresholds, and a line `finite` where that fails.
    Ccmotion,
}

impl std::fmt::Display for Profile {
    /// The name in a config.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.serialize(f)
    }
}

/// Checks a phrase. `strict` compares with the motion of `statistics`, or with captured dancers if
/// these do not describe movement.
pub fn check(motion: &Phrase, profile: Profile, statistics: Option<&Statistics>) -> Report {
    match (profile, statistics) {
        (Profile::Ccmotion, _) => check_thresholds(motion, &SanityThresholds::default()),
        (Profile::Strict, Some(training)) if training.describes_movement() => {
            strict::check(motion, training)
        }
        (Profile::Strict, _) => strict::check(motion, &people::phrases()),
    }
}

/// Counts NaN and infinities.
fn finite(values: &[f32]) -> Check {
    let bad = values.iter().filter(|value| !value.is_finite()).count();
    let message = match bad {
        0 => "all values are finite".to_owned(),
        _ => format!("{bad} of {} values are not finite", values.len()),
    };
    Check::new("finite", bad as f64, Threshold::AtMost(0.0), message)
}

/// [`finite`] of a phrase, with the first position.
fn finite_phrase(motion: &Phrase) -> Check {
    let mut check = finite(motion.as_slice());
    if let Some((frame, channel)) = motion.first_non_finite() {
        let channel = channel_name(channel);
        check.message += &format!(", the first in frame {frame}, channel `{channel}`");
    }
    check
}

/// The phase of every frame.
fn phase(motion: &Phrase, allowed: [f64; 2]) -> Check {
    let [low, high] = range(motion.column(PHASE).into_iter());
    let message = format!("phase from {low:.4} to {high:.4}");
    let value = Value::Range([low, high]);
    Check::new("phase", value, Threshold::Within(allowed), message)
}

/// The mean jerk norm, metres per second cubed.
fn jerk(motion: &Phrase, allowed: Threshold) -> Check {
    let mean = mean_jerk_norm(motion);
    Check::new("jerk", mean, allowed, format!("mean jerk {mean:.1} m/s^3"))
}

/// Error of an explicit derivative; `message` contains `{error}`.
fn coherence(name: &'static str, error: f64, message: &str, most: f64) -> Check {
    let error = Value::Number(error);
    let message = message.replace("{error}", &error.to_string());
    Check::new(name, error, Threshold::AtMost(most), message)
}

/// Smallest and largest value; both NaN if a value is NaN.
fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
        // `f64::min` would ignore NaN.
        match value.is_nan() || low.is_nan() {
            true => [f64::NAN; 2],
            false => [low.min(value), high.max(value)],
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CHANNELS;
    use crate::random_phrase::random_phrase;

    #[test]
    fn one_bad_value_in_any_channel_fails_both_profiles() {
        let good = random_phrase(2, 6);
        let statistics = crate::phrase_statistics([&good]).unwrap();
        for profile in [Profile::Ccmotion, Profile::Strict] {
            assert!(check(&good, profile, Some(&statistics)).passed);
            for place in 0..6 * CHANNELS {
                for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                    let mut motion = good.clone();
                    motion.frame_mut(place / CHANNELS)[place % CHANNELS] = value;
                    let report = check(&motion, profile, Some(&statistics));
                    assert!(!report.passed, "{profile}: {value} at {place}");
                    assert!(!report.check("finite").unwrap().passed);
                }
            }
        }
    }

    #[test]
    fn nan_makes_the_measured_value_nan_and_the_check_fail() {
        let mut motion = random_phrase(2, 6);
        (0..CHANNELS).for_each(|channel| motion.frame_mut(3)[channel] = f32::NAN);
        let statistics = crate::phrase_statistics([&random_phrase(2, 6)]).unwrap();
        for profile in [Profile::Ccmotion, Profile::Strict] {
            let report = check(&motion, profile, Some(&statistics));
            assert!(
                report.checks.iter().all(|check| !check.passed),
                "{report:#?}"
            );
        }
    }

    #[test]
    fn the_shortest_phrases_are_checked() {
        let statistics = crate::phrase_statistics([&random_phrase(2, 40)]).unwrap();
        for frames in [1, 2] {
            let motion = random_phrase(2, frames);
            for profile in [Profile::Ccmotion, Profile::Strict] {
                let report = check(&motion, profile, Some(&statistics));
                assert!(report.passed, "{profile:?}, {frames}: {report:#?}");
            }
        }
    }
}
