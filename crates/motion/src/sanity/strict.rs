//! Checks of every frame, with bounds from the training phrases.

use std::ops::Range;

use super::{Check, JERK_FACTOR, Report, Threshold, coherence, finite_phrase, jerk, phase, range};
use crate::derivatives::{acceleration_errors, mean_norm, rotation_errors, velocity_errors};
use crate::motion_measures::phase_steps;
use crate::{FPS, MotionMeasure, Phrase, Statistics};

/// Allowed deviation of a quaternion's norm from 1.
const NORM_TOLERANCE: f64 = 1e-3;

/// Allowed error of velocity and acceleration, relative to the training phrases' root mean square.
const COHERENCE_SHARE: f64 = 0.1;

/// Number of windows that begin within one window length.
const WINDOWS_A_LENGTH: usize = 8;

/// Shortest window with all measures, frames.
const SHORTEST_WINDOW: usize = 31;

/// Allowed mean error of the angular velocity, radians per second.
const MAX_ROTATION_ERROR: f64 = 0.1;

/// Allowed backward step of the phase, bars.
const PHASE_TOLERANCE: f64 = 0.01;

/// Makes the checks of [`Profile::Strict`](super::Profile::Strict).
///
/// Means are checked in windows of the training phrases' length, an eighth apart, and the worst is
/// reported: a minute of dancing does not compensate five seconds of standing. Short phrases lack
/// some measures and have wider bounds.
pub(super) fn check(motion: &Phrase, training: &Statistics) -> Report {
    let mut checks = vec![
        finite_phrase(motion),
        quaternion_norm(motion),
        quaternion_sign(motion),
        phase(motion, [0.0, 1.0]),
    ];
    checks.extend(phase_direction(motion));
    let windows = windows(motion.frames(), training);
    let mut measured = means(&motion.slice(windows[0].clone()), training);
    if windows.len() > 1 {
        name_window(&mut measured, &windows[0]);
        for window in &windows[1..] {
            let mut others = means(&motion.slice(window.clone()), training);
            name_window(&mut others, window);
            let pairs = measured.into_iter().zip(others);
            measured = pairs.map(|(one, other)| one.worse(other)).collect();
        }
    }
    checks.extend(measured);
    Report::new(checks)
}

/// Windows of the training phrases' mean length, at least a second, that cover `frames` frames.
fn windows(frames: usize, training: &Statistics) -> Vec<Range<usize>> {
    let length = (training.frames / training.items.max(1)).max(SHORTEST_WINDOW);
    if frames <= length + length / WINDOWS_A_LENGTH {
        return std::iter::once(0..frames).collect();
    }
    let gaps = (WINDOWS_A_LENGTH * (frames - length)).div_ceil(length);
    let starts = (0..=gaps).map(|window| window * (frames - length) / gaps);
    starts.map(|start| start..start + length).collect()
}

/// Adds the window to the messages of its checks.
fn name_window(checks: &mut [Check], window: &Range<usize>) {
    let [from, to] = [window.start, window.end].map(|frame| frame as f64 / FPS);
    for check in checks {
        check.message += &format!(" in seconds {from:.1} to {to:.1}");
    }
}

/// Checks of means and of movement.
fn means(motion: &Phrase, training: &Statistics) -> Vec<Check> {
    let [speed, acceleration, jerk_p95] = [
        training.rms_speed,
        training.rms_acceleration,
        training.jerk_p95,
    ]
    .map(Option::unwrap_or_default);
    let mut checks = vec![
        coherence(
            "velocity_coherence",
            mean_norm(&velocity_errors(motion)),
            "mean velocity error {error} m/s",
            COHERENCE_SHARE * speed,
        ),
        coherence(
            "accel_coherence",
            mean_norm(&acceleration_errors(motion)),
            "mean acceleration error {error} m/s^2",
            COHERENCE_SHARE * acceleration,
        ),
        coherence(
            "rotation_coherence",
            mean_norm(&rotation_errors(motion)),
            "mean error of the angular velocity {error} rad/s",
            MAX_ROTATION_ERROR,
        ),
        jerk(motion, Threshold::AtMost(JERK_FACTOR * jerk_p95)),
    ];
    let measures = MotionMeasure::ALL.into_iter();
    checks.extend(measures.filter_map(|measure| movement(measure, motion, training)));
    checks
}

/// The check of a measure against its 1st and 99th percentile in training motion; `None` for
/// unchecked measures.
fn movement(measure: MotionMeasure, motion: &Phrase, training: &Statistics) -> Option<Check> {
    let &movement = training.movement.get(measure.name())?;
    // A part of a phrase may be less or more lively than the phrase.
    let length = training.frames as f64 / training.items.max(1) as f64;
    let shorter = (length / motion.frames() as f64).max(1.0);
    let threshold = measure.bounds().threshold(movement, shorter)?;
    let value = measure.of(motion)?;
    let message = format!("{} {value:.3} {}", measure.title(), measure.unit());
    Some(Check::new(measure.name(), value, threshold, message))
}

/// The smallest step of the phase; `None` for a single frame.
fn phase_direction(motion: &Phrase) -> Option<Check> {
    let steps = phase_steps(motion);
    (!steps.is_empty()).then(|| {
        let [smallest, _] = range(steps.into_iter());
        let message = format!("smallest advance of the phase from frame to frame: {smallest:.4}");
        let allowed = Threshold::Above(-PHASE_TOLERANCE);
        Check::new("phase_direction", smallest, allowed, message)
    })
}

fn quaternion_norm(motion: &Phrase) -> Check {
    let quaternions = motion.quaternions().into_iter();
    let [_, largest] = range(quaternions.map(|q| (q.norm() - 1.0).abs()));
    let message = format!("largest deviation of a quaternion's norm from 1: {largest:.2e}");
    let allowed = Threshold::Below(NORM_TOLERANCE);
    Check::new("quaternion_norm", largest, allowed, message)
}

fn quaternion_sign(motion: &Phrase) -> Check {
    let quaternions = motion.quaternions();
    let [smallest, _] = match quaternions.len() {
        1 => [1.0; 2], // A single frame has no neighbour to disagree with.
        _ => range(quaternions.windows(2).map(|pair| pair[0].dot(pair[1]))),
    };
    let message = format!("smallest product of neighbouring quaternions: {smallest:.4}");
    let allowed = Threshold::Above(0.0);
    Check::new("quaternion_sign", smallest, allowed, message)
}

#[cfg(test)]
mod tests;
