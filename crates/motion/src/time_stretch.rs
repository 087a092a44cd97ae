//! A phrase played faster or slower.

use crate::circular::step;
use crate::derivatives::{make_sign_continuous, rederive};
use crate::phrase::{PHASE, POSITION, STYLE};
use crate::{CHANNELS, Phrase, Quaternion};

/// Number of frames of `frames` frames played at `speed`.
pub fn frames_at_speed(frames: usize, speed: f64) -> usize {
    // Rounding must not drop a last frame at an exact time.
    ((frames.saturating_sub(1)) as f64 / speed + 1e-9).floor() as usize + 1
}

/// The phrase played at `speed`: frame `t` is frame `speed * t` of the original.
///
/// Positions and quaternions follow cubic splines, so accelerations stay smooth. Derivatives are
/// computed from positions and quaternions. The phase is interpolated by shortest steps, the style
/// linearly.
///
/// # Panics
/// Panics unless `speed` is finite and above zero.
#[must_use]
pub fn at_speed(motion: &Phrase, speed: f64) -> Phrase {
    assert!(speed.is_finite() && speed > 0.0, "a speed: {speed}");
    let frames = frames_at_speed(motion.frames(), speed);
    let times: Vec<f64> = (0..frames).map(|t| speed * t as f64).collect();
    let mut played = Phrase::new(vec![0.0; frames * CHANNELS]).expect("at least one frame");

    for channel in POSITION {
        let values = spline(&motion.column(channel), &times);
        for (t, value) in values.into_iter().enumerate() {
            played.frame_mut(t)[channel] = value as f32;
        }
    }
    let mut quaternions = motion.quaternions();
    make_sign_continuous(&mut quaternions);
    let parts = [0, 1, 2, 3].map(|part| {
        let values: Vec<f64> = quaternions.iter().map(|q| q.parts()[part]).collect();
        spline(&values, &times)
    });
    for (t, &time) in times.iter().enumerate() {
        let turned = Quaternion::from([0, 1, 2, 3].map(|part| parts[part][t]));
        played.set_quaternion(t, turned.scale(1.0 / turned.norm().max(f64::MIN_POSITIVE)));
        let (from, to, fraction) = between(motion.frames(), time);
        let (from, to) = (motion.frame(from), motion.frame(to));
        let phase = f64::from(from[PHASE]);
        let phase = phase + fraction * step(phase, f64::from(to[PHASE]));
        let frame = played.frame_mut(t);
        frame[PHASE] = phase.rem_euclid(1.0) as f32;
        for channel in STYLE {
            let (a, b) = (f64::from(from[channel]), f64::from(to[channel]));
            frame[channel] = (a + fraction * (b - a)) as f32;
        }
    }
    rederive(&mut played);
    played
}

/// The two frames around a time in frames, and the fraction between these frames.
pub fn between(frames: usize, time: f64) -> (usize, usize, f64) {
    let from = (time.max(0.0) as usize).min(frames - 1);
    let to = (from + 1).min(frames - 1);
    (from, to, (time - from as f64).clamp(0.0, 1.0))
}

/// The cubic spline through `values` at 0, 1, 2, ..., evaluated at `times` in that range. The
/// second derivative is constant over the first and the last step.
///
/// # Panics
/// Panics if there are no values.
pub fn spline(values: &[f64], times: &[f64]) -> Vec<f64> {
    let curvature = curvature(values);
    let at = |&time: &f64| {
        let (from, to, b) = between(values.len(), time);
        let a = 1.0 - b;
        let bend = (a.powi(3) - a) * curvature[from] + (b.powi(3) - b) * curvature[to];
        a * values[from] + b * values[to] + bend / 6.0
    };
    times.iter().map(at).collect()
}

/// Second derivatives at the knots: `m[i-1] + 4 m[i] + m[i+1] = 6 (y[i-1] - 2 y[i] + y[i+1])`.
fn curvature(values: &[f64]) -> Vec<f64> {
    let inner = values.len().saturating_sub(2);
    if inner == 0 {
        return vec![0.0; values.len()];
    }
    let knots = values.windows(3);
    let mut rest: Vec<f64> = knots.map(|y| 6.0 * (y[0] - 2.0 * y[1] + y[2])).collect();
    // The first and the last unknown equal the neighboring unknowns.
    let at_ends = |i: usize| f64::from(u8::from(i == 0)) + f64::from(u8::from(i + 1 == inner));
    let mut factor = vec![0.0; inner];
    for i in 0..inner {
        let mut pivot = 4.0 + at_ends(i);
        if i > 0 {
            pivot -= factor[i - 1];
            rest[i] -= rest[i - 1];
        }
        factor[i] = 1.0 / pivot;
        rest[i] /= pivot;
    }
    for i in (0..inner - 1).rev() {
        rest[i] -= factor[i] * rest[i + 1];
    }
    rest.insert(0, rest[0]);
    rest.push(rest[inner]);
    rest
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::phrase::{ACCELERATION, ANGULAR_VELOCITY};
    use crate::random_phrase::random_phrase;

    #[test]
    fn a_spline_follows_parabolas_and_waves() {
        let parabola: Vec<f64> = (0..9).map(|t| f64::from(t * t) - 3.0).collect();
        let times = [0.0, 0.25, 3.5, 7.75, 8.0];
        for (value, time) in spline(&parabola, &times).into_iter().zip(times) {
            assert!((value - (time * time - 3.0)).abs() < 1e-12);
        }
        let wave: Vec<f64> = (0..60).map(|t| (TAU * f64::from(t) / 15.0).sin()).collect();
        let times: Vec<f64> = (0..50)
            .map(|t| 4.0 + f64::from(t))
            .map(|t| t + 0.3)
            .collect();
        for (value, time) in spline(&wave, &times).into_iter().zip(&times) {
            assert!((value - (TAU * time / 15.0).sin()).abs() < 1e-3);
        }
        for few in [&[2.0][..], &[2.0, 4.0], &[2.0, 4.0, 6.0]] {
            let last = (few.len() - 1) as f64;
            let expected = [2.0, 2.0 + last];
            for (a, b) in spline(few, &[0.0, last / 2.0]).into_iter().zip(expected) {
                assert!((a - b).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn lengths_run_from_the_first_frame_as_far_as_the_last() {
        for (frames, speed, expected) in [
            (1, 2.0, 1),
            (10, 1.0, 10),
            (10, 2.0, 5),
            (10, 0.5, 19),
            (11, 1.25, 9),
            (120, 1.2, 100),
        ] {
            assert_eq!(frames_at_speed(frames, speed), expected, "{frames} {speed}");
            assert_eq!(
                at_speed(&random_phrase(1, frames), speed).frames(),
                expected
            );
        }
    }

    #[test]
    fn the_same_path_takes_another_time() {
        for speed in [0.8, 1.25] {
            let original = random_phrase(5, 60);
            let played = at_speed(&original, speed);
            let mut checked = 0;
            for t in 2..played.frames() - 3 {
                let (from, _, fraction) = between(60, speed * t as f64);
                // Original frames at exact times do not change.
                if fraction < 1e-9 {
                    let (a, b) = (original.quaternion(from), played.quaternion(t));
                    assert!((a.dot(b).abs() - 1.0).abs() < 1e-6);
                    let (a, b) = (original.vector(from, POSITION), played.vector(t, POSITION));
                    assert!((0..3).all(|i| (a[i] - b[i]).abs() < 1e-5), "{a:?} {b:?}");
                    checked += 1;
                }
            }
            assert!(checked > 5, "{checked}");
        }
    }

    #[test]
    fn accelerations_stay_those_of_a_smooth_path() {
        // The path is a circle of one metre; a turn takes 60 frames.
        let mut circle = Phrase::new(vec![0.0; 90 * CHANNELS]).unwrap();
        for t in 0..90 {
            let angle = TAU * t as f64 / 60.0;
            circle.set_vector(t, POSITION, [angle.sin(), 1.0, angle.cos()]);
            circle.set_quaternion(t, Quaternion::from_yaw(angle));
            circle.frame_mut(t)[PHASE] = (t as f32 / 20.0).fract();
        }
        let played = at_speed(&circle, 1.2);
        let expected = (TAU / 2.0 * 1.2).powi(2);
        for t in 2..played.frames() - 4 {
            let [x, _, z] = played.vector(t, ACCELERATION);
            assert!(
                (x.hypot(z) / expected - 1.0).abs() < 0.01,
                "{t} {}",
                x.hypot(z)
            );
            let turned = played.vector(t, ANGULAR_VELOCITY)[1];
            assert!((turned / (TAU / 2.0 * 1.2) - 1.0).abs() < 1e-3, "{turned}");
            let phase = f64::from(played.frame(t)[PHASE]);
            assert!(crate::circular::distance(phase, 1.2 * t as f64 / 20.0) < 1e-5);
        }
    }
}
