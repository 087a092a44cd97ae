//! Derivatives of a phrase, and the errors of its explicit channels.
//!
//! All derivatives are forward differences: the value of frame t comes from frames t and t + 1. The
//! last frame repeats the previous value (CC-MotionGen, section 2.3; docs/sources.md, section 1.1).

use std::ops::Range;

use crate::phrase::{ACCELERATION, ANGULAR_VELOCITY, FPS, PHASE, POSITION, STYLE, VELOCITY};
use crate::vector::{length, minus};
use crate::{CHANNELS, Error, Phrase, Quaternion};

/// Forward differences of `[frames, 3]` times `fps`, the last one repeated; 0 for a single frame.
pub fn forward_differences(values: &[[f64; 3]], fps: f64) -> Vec<[f64; 3]> {
    repeat_last(differences(values, fps), values.len())
}

/// Angular velocity, radians per second, world frame, `[frames, 3]`: the rotation vector of
/// `q[t+1] * conj(q[t])` times `fps`, the last one repeated. Signs of quaternions do not matter.
pub fn angular_velocity(quaternions: &[Quaternion], fps: f64) -> Vec<[f64; 3]> {
    let turns = quaternions.windows(2).map(|pair| {
        let turn = pair[1] * pair[0].conjugate();
        turn.to_rotation_vector().map(|v| v * fps)
    });
    repeat_last(turns.collect(), quaternions.len())
}

/// [`angular_velocity`] between the frames of a phrase, `[frames - 1, 3]`. NaN stays NaN.
pub fn angular_rates(motion: &Phrase) -> Vec<[f64; 3]> {
    let mut rates = angular_velocity(&motion.quaternions(), FPS);
    // The last value repeats the previous one.
    rates.pop();
    rates
}

/// Negates quaternions so that each lies in the hemisphere of the previous finite quaternion.
pub fn make_sign_continuous(quaternions: &mut [Quaternion]) {
    let mut previous: Option<Quaternion> = None;
    for quaternion in quaternions {
        *quaternion = quaternion.nearer_to(previous.unwrap_or(*quaternion));
        if quaternion.norm().is_finite() {
            previous = Some(*quaternion);
        }
    }
}

/// A phrase whose velocity, acceleration and angular velocity are derived from its pose.
///
/// `positions` are `[frames, 3]` in metres, `quaternions` of any norm and sign, `phase` 0 to 1,
/// `style` `[frames, 8]`. Derivatives use the single-precision values. The last velocity is
/// repeated, so the acceleration before the last frame is 0: slice off two more frames.
///
/// # Errors
/// [`Error::LengthMismatch`] for arrays of different lengths; [`Error::NotWholeFrames`] for empty
/// arrays.
pub fn derive(
    positions: &[[f64; 3]],
    quaternions: &[Quaternion],
    phase: &[f64],
    style: &[[f64; 8]],
) -> Result<Phrase, Error> {
    let frames = positions.len();
    let names = ["quaternions", "phase", "style"];
    let lengths = [quaternions.len(), phase.len(), style.len()];
    for (what, found) in names.into_iter().zip(lengths) {
        if found != frames {
            return Err(Error::LengthMismatch {
                what,
                expected: frames,
                found,
            });
        }
    }
    let mut motion = Phrase::new(vec![0.0; frames * CHANNELS])?;
    let mut units: Vec<Quaternion> = quaternions.iter().map(|q| q.normalised()).collect();
    make_sign_continuous(&mut units);
    for t in 0..frames {
        motion.set_vector(t, POSITION, positions[t]);
        motion.set_quaternion(t, units[t]);
        let frame = motion.frame_mut(t);
        frame[PHASE] = phase[t] as f32;
        for (channel, value) in frame[STYLE].iter_mut().zip(style[t]) {
            *channel = value as f32;
        }
    }
    rederive(&mut motion);
    Ok(motion)
}

/// Replaces velocity, acceleration and angular velocity by derivatives of the stored poses.
pub fn rederive(motion: &mut Phrase) {
    let velocity = forward_differences(&motion.vectors(POSITION), FPS);
    for (t, value) in velocity.into_iter().enumerate() {
        motion.set_vector(t, VELOCITY, value);
    }
    // The checks use the velocity rounded to single precision.
    let acceleration = forward_differences(&motion.vectors(VELOCITY), FPS);
    let turning = angular_velocity(&motion.quaternions(), FPS);
    for (t, (a, w)) in acceleration.into_iter().zip(turning).enumerate() {
        motion.set_vector(t, ACCELERATION, a);
        motion.set_vector(t, ANGULAR_VELOCITY, w);
    }
}

/// `v[t] - fps (p[t+1] - p[t])` in metres per second, `[frames - 1, 3]`.
pub fn velocity_errors(motion: &Phrase) -> Vec<[f64; 3]> {
    let derived = differences(&motion.vectors(POSITION), FPS);
    errors(motion, VELOCITY, derived)
}

/// `a[t] - fps (v[t+1] - v[t])` in metres per second squared, `[frames - 1, 3]`.
pub fn acceleration_errors(motion: &Phrase) -> Vec<[f64; 3]> {
    let derived = differences(&motion.vectors(VELOCITY), FPS);
    errors(motion, ACCELERATION, derived)
}

/// `w[t]` minus [`angular_rates`], radians per second, `[frames - 1, 3]`.
pub fn rotation_errors(motion: &Phrase) -> Vec<[f64; 3]> {
    errors(motion, ANGULAR_VELOCITY, angular_rates(motion))
}

/// `fps (a[t+1] - a[t])` in metres per second cubed, `[frames - 1, 3]`.
pub fn jerk(motion: &Phrase) -> Vec<[f64; 3]> {
    differences(&motion.vectors(ACCELERATION), FPS)
}

/// Mean norm of the [`jerk`], metres per second cubed; 0 for a single frame.
pub fn mean_jerk_norm(motion: &Phrase) -> f64 {
    mean_norm(&jerk(motion))
}

/// Mean Euclidean norm of vectors; 0 for none.
pub fn mean_norm(vectors: &[[f64; 3]]) -> f64 {
    let total: f64 = vectors.iter().map(|v| length(*v)).sum();
    total / vectors.len().max(1) as f64
}

/// Mean absolute component of vectors; 0 for none. The value is 1/3 to 1/sqrt(3) times the mean
/// norm.
pub fn mean_absolute_component(vectors: &[[f64; 3]]) -> f64 {
    let components = vectors.as_flattened().iter();
    let total: f64 = components.map(|component| component.abs()).sum();
    total / (3 * vectors.len()).max(1) as f64
}

fn errors(motion: &Phrase, explicit: Range<usize>, derived: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
    let stored = motion.vectors(explicit).into_iter();
    stored.zip(derived).map(|(a, b)| minus(a, b)).collect()
}

/// Jerk of positions `[frames, 3]` in metres: third differences times `fps^3`, `[frames - 3, 3]`.
pub(crate) fn jerk_of(positions: &[[f64; 3]], fps: f64) -> Vec<[f64; 3]> {
    let derive = |values: &[[f64; 3]]| differences(values, fps);
    derive(&derive(&derive(positions)))
}

/// Forward differences of vectors `[frames, 3]` times `fps`, `[frames - 1, 3]`.
pub(crate) fn differences(values: &[[f64; 3]], fps: f64) -> Vec<[f64; 3]> {
    let steps = values.windows(2).map(|pair| minus(pair[1], pair[0]));
    steps.map(|step| step.map(|part| part * fps)).collect()
}

fn repeat_last(mut values: Vec<[f64; 3]>, frames: usize) -> Vec<[f64; 3]> {
    let last = values.last().copied().unwrap_or([0.0; 3]);
    values.resize(frames, last);
    values
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::random_phrase::random_phrase;

    #[test]
    fn differences_look_forward_and_repeat_the_last() {
        let values = [[0.0, 1.0, 2.0], [1.0, 1.0, 0.0], [4.0, 1.0, 0.0]];
        let expected = [[2.0, 0.0, -4.0], [6.0, 0.0, 0.0], [6.0, 0.0, 0.0]];
        assert_eq!(forward_differences(&values, 2.0), expected);
        assert_eq!(forward_differences(&values[..1], 2.0), [[0.0; 3]]);
        assert_eq!(forward_differences(&[], 2.0), [[0.0; 3]; 0]);
    }

    #[test]
    fn angular_velocity_is_in_the_world_frame() {
        // A body lying on its side turns about the world's +y, not about its own axes.
        let side = Quaternion::from_rotation_vector([1.5, 0.3, 0.0]);
        let mut spin: Vec<_> = (0..4)
            .map(|t| Quaternion::from_yaw(0.1 * f64::from(t)) * side)
            .collect();
        spin[2] = spin[2].scale(-1.0);
        for turning in angular_velocity(&spin, 30.0) {
            assert!(
                length([turning[0], turning[1] - 3.0, turning[2]]) < 1e-12,
                "{turning:?}"
            );
        }
    }

    #[test]
    fn signs_become_continuous() {
        let q = Quaternion::from_yaw(0.3);
        let nan = Quaternion::new(f64::NAN, 0.0, 0.0, 0.0);
        let mut signs = [q.scale(-1.0), q, q.scale(-1.0), nan, q];
        make_sign_continuous(&mut signs);
        for index in [0, 1, 2, 4] {
            assert_eq!(signs[index], q.scale(-1.0), "{index}");
        }
    }

    #[test]
    fn derive_refuses_ragged_and_empty_input() {
        let one = ([[0.0; 3]], [Quaternion::IDENTITY], [0.0], [[0.0; 8]]);
        assert_eq!(derive(&one.0, &one.1, &one.2, &one.3).unwrap().frames(), 1);
        assert!(derive(&one.0, &[], &one.2, &one.3).is_err());
        assert!(derive(&one.0, &one.1, &[], &one.3).is_err());
        assert!(derive(&one.0, &one.1, &one.2, &[]).is_err());
        assert!(derive(&[], &[], &[], &[]).is_err());
    }

    #[test]
    fn means_of_vectors() {
        let vectors = [[3.0, -4.0, 0.0], [0.0, 0.0, 1.0]];
        assert_eq!(mean_norm(&vectors), 3.0);
        assert!((mean_absolute_component(&vectors) - 8.0 / 6.0).abs() < 1e-15);
        assert_eq!(mean_norm(&[]), 0.0);
        assert_eq!(mean_absolute_component(&[]), 0.0);
    }

    #[test]
    fn errors_and_jerk_are_measured() {
        let mut motion = random_phrase(3, 12);
        for t in 0..12 {
            let [x, y, z] = motion.vector(t, VELOCITY);
            motion.set_vector(t, VELOCITY, [x + 3.0, y - 4.0, z]);
            // Acceleration (0, 0, t) has a jerk of 30 m/s^3 along z.
            motion.set_vector(t, ACCELERATION, [0.0, 0.0, t as f64]);
        }
        assert!((mean_norm(&velocity_errors(&motion)) - 5.0).abs() < 1e-5);
        assert!((mean_absolute_component(&velocity_errors(&motion)) - 7.0 / 3.0).abs() < 1e-5);
        assert_eq!(mean_jerk_norm(&motion), 30.0);
        assert_eq!(mean_jerk_norm(&motion.slice(0..1)), 0.0);
    }

    proptest! {
        #[test]
        fn derived_phrases_are_coherent(seed: u64, frames in 1usize..50) {
            let motion = random_phrase(seed, frames);
            prop_assert!(mean_norm(&velocity_errors(&motion)) < 1e-6);
            prop_assert!(mean_norm(&acceleration_errors(&motion)) < 1e-5);
            for t in 1..frames {
                let turn = motion.quaternion(t) * motion.quaternion(t - 1).conjugate();
                let stored = motion.vector(t - 1, ANGULAR_VELOCITY);
                let moved = Quaternion::from_rotation_vector(stored.map(|w| w / FPS));
                prop_assert!(turn.dot(moved).abs() > 1.0 - 1e-6);
            }
            let mut again = motion.clone();
            rederive(&mut again);
            prop_assert_eq!(again, motion);
        }
    }
}
