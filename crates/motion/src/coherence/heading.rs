//! The headings nearest to orientations and to the angular velocity about the vertical:
//!
//! ```text
//! min_h  sum_t w_t |h_t - exp(i psi_t)|^2 / s_h^2 + |h_{t+1} - exp(i d_t) h_t|^2 / s_w^2
//! ```
//!
//! over complex numbers of any size. `psi_t` is the heading of frame t, the
//! [twist](Quaternion::twist) about the vertical. `d_t` is the change of heading by the angular
//! velocity. The arguments of `h` unwrap the `psi_t` by full turns. The result is the same fit of
//! the unwrapped angles, which cannot flip where a complex number passes through zero.
//!
//! A network that is uncertain about an orientation predicts a mean of many orientations. The mean
//! has a correct tilt but an arbitrary heading. The weights `w_t` are the squared confidences, so
//! angular velocities dominate in uncertain frames. The fit keeps the tilt.

use super::{OrientationFit, weight};
use crate::circular::wrapped;
use crate::phrase::{ANGULAR_VELOCITY, FPS};
use crate::{Phrase, Quaternion};

/// Smallest weight of a frame.
const LEAST_WEIGHT: f64 = 1e-4;

/// Confidence of headings, 0 to 1, `[frames]`: the norms of quaternions, which are small in means
/// of orientations.
pub fn heading_confidence(motion: &Phrase) -> Vec<f64> {
    let quaternions = motion.quaternions().into_iter();
    quaternions.map(|q| q.norm().min(1.0)).collect()
}

/// Squared cosine of half the tilt of 120 degrees. Beyond that tilt the rotation decreases to 0.
pub const UPRIGHT: f64 = 0.25;

/// Rotates the orientations of a phrase about the vertical to the fitted headings, except in
/// `known` frames. `confidence` is 0 to 1. Quaternions become unit quaternions. The angular
/// velocity is rotated with the body, and its vertical component follows the headings. `std` are
/// the training deviations of the channels, `[25]`.
pub fn fit_heading(motion: &mut Phrase, std: &[f64], known: &[bool], confidence: &[f64]) {
    let frames = motion.frames();
    assert_eq!(known.len(), frames, "known frames");
    assert_eq!(confidence.len(), frames, "confidence of each frame");
    let quaternions = motion.quaternions().into_iter();
    let units: Vec<Quaternion> = quaternions.map(Quaternion::normalised).collect();
    let weights = known.iter().zip(confidence);
    let weights = weights.map(|(&known, confidence)| match known {
        true => weight(known),
        false => confidence.powi(2).clamp(LEAST_WEIGHT, 1.0),
    });
    let vertical = ANGULAR_VELOCITY.start + 1;
    let fit = OrientationFit::of_headings(weights.collect(), std[vertical]);

    let headings: Vec<f64> = units.iter().map(|unit| unit.twist()).collect();
    let steps = units.iter().enumerate().map(|(t, unit)| {
        let step = motion.vector(t, ANGULAR_VELOCITY).map(|rate| rate / FPS);
        let next = Quaternion::from_rotation_vector(step) * *unit;
        wrapped(next.twist() - headings[t])
    });
    let steps: Vec<f64> = steps.collect();
    let mut along = vec![0.0; frames];
    for t in 1..frames {
        along[t] = along[t - 1] + steps[t - 1];
    }
    let rest = headings.iter().zip(&along);
    let rest: Vec<f64> = rest.map(|(heading, along)| heading - along).collect();
    let [sines, cosines] = [f64::sin, f64::cos].map(|part| {
        let mut parts: Vec<f64> = rest.iter().map(|&angle| part(angle)).collect();
        fit.fit(&mut parts);
        parts
    });
    let mut fitted = Vec::with_capacity(frames);
    let mut before = 0.0;
    for (t, angle) in rest.into_iter().enumerate() {
        before += wrapped(sines[t].atan2(cosines[t]) - before);
        fitted.push(before + wrapped(angle - before));
    }
    fit.fit(&mut fitted);
    // The heading and the tilt axis of an upside-down body are undefined.
    let upright_share = units.iter().map(|unit| {
        let upright = unit.w.powi(2) + unit.y.powi(2);
        (upright / UPRIGHT).min(1.0)
    });
    let upright_share: Vec<f64> = upright_share.collect();
    let turn = |t: usize| match known[t] {
        true => 0.0,
        false => upright_share[t] * wrapped(along[t] + fitted[t] - headings[t]),
    };
    let turns: Vec<f64> = (0..frames).map(turn).collect();
    for t in (0..frames).filter(|&t| !known[t]) {
        let turn = Quaternion::from_yaw(turns[t]);
        motion.set_quaternion(t, turn * units[t]);
        let mut rate = turn.rotate(motion.vector(t, ANGULAR_VELOCITY));
        if t + 1 < frames {
            let step = headings[t + 1] + turns[t + 1] - headings[t] - turns[t];
            rate[1] += upright_share[t] * wrapped(step - steps[t]) * FPS;
        }
        motion.set_vector(t, ANGULAR_VELOCITY, rate);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::length;

    /// A body that turns about the vertical and leans back and forth by at most 20 degrees.
    fn turning(frames: usize) -> Phrase {
        let mut motion = crate::random_phrase::random_phrase(4, frames);
        for t in 0..frames {
            let lean = 0.35 * (0.2 * t as f64).sin();
            let turn = Quaternion::from_yaw(1.2 * (0.05 * t as f64).sin() + 0.02 * t as f64);
            let leaning = Quaternion::from_rotation_vector([lean, 0.0, 0.5 * lean]);
            motion.set_quaternion(t, turn * leaning);
        }
        crate::postprocess::derive_angular_velocity(&mut motion);
        motion
    }

    fn apart(a: &Phrase, b: &Phrase) -> f64 {
        let apart = |t| (a.quaternion(t) * b.quaternion(t).conjugate()).to_rotation_vector();
        (0..a.frames())
            .map(|t| length(apart(t)))
            .fold(0.0, f64::max)
    }

    /// The cosine of the tilt.
    fn upright(motion: &Phrase, t: usize) -> f64 {
        motion.quaternion(t).normalised().rotate([0.0, 1.0, 0.0])[1]
    }

    #[test]
    fn headings_that_agree_stay() {
        for frames in [1, 2, 3, 150] {
            let original = turning(frames);
            let mut fitted = original.clone();
            fit_heading(
                &mut fitted,
                &[1.5; 25],
                &vec![false; frames],
                &vec![1.0; frames],
            );
            assert!(apart(&original, &fitted) < 1e-3, "{frames}");
        }
    }

    #[test]
    fn angular_velocities_dominate_over_mean_headings() {
        let original = turning(200);
        let mut lost = original.clone();
        for t in 60..100 {
            let elsewhere = Quaternion::from_yaw(2.0 + 0.9 * (t % 5) as f64);
            lost.set_quaternion(t, elsewhere * original.quaternion(t));
        }
        let fitted = |lost_ones: f64| {
            let sure = (0..200).map(|t| {
                if (60..100).contains(&t) {
                    lost_ones
                } else {
                    1.0
                }
            });
            let mut motion = lost.clone();
            fit_heading(
                &mut motion,
                &[1.5; 25],
                &[false; 200],
                &sure.collect::<Vec<_>>(),
            );
            motion
        };
        let weighted = fitted(0.03);
        assert!(
            apart(&original, &weighted) < 0.15,
            "{}",
            apart(&original, &weighted)
        );
        for t in 0..200 {
            assert!(
                (upright(&weighted, t) - upright(&original, t)).abs() < 1e-5,
                "{t}"
            );
        }
        assert!(apart(&original, &fitted(1.0)) > 1.0);
    }

    #[test]
    fn frames_without_information_keep_the_fit_finite() {
        let mut motion = turning(90);
        for t in 0..90 {
            motion.set_quaternion(t, Quaternion::new(0.0, 0.0, 0.0, 0.0));
        }
        fit_heading(&mut motion, &[1.0; 25], &[false; 90], &[0.0; 90]);
        assert_eq!(motion.first_non_finite(), None);
        assert!((motion.quaternion(45).norm() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn known_frames_stay_and_the_others_turn_towards_them() {
        let original = turning(60);
        let mut motion = original.clone();
        for t in 20..60 {
            let turned = Quaternion::from_yaw(0.5) * original.quaternion(t);
            motion.set_quaternion(t, turned.scale(-1.0));
        }
        let known: Vec<bool> = (0..60).map(|t| t < 20).collect();
        fit_heading(&mut motion, &[1.5; 25], &known, &[0.8; 60]);
        for t in 0..20 {
            assert_eq!(motion.frame(t), original.frame(t), "{t}");
        }
        let step =
            (motion.quaternion(20) * original.quaternion(20).conjugate()).to_rotation_vector();
        assert!(length(step) < 0.1, "{step:?}");
    }

    #[test]
    fn bodies_that_pitch_beyond_the_vertical_keep_their_heading() {
        // The noise has a deviation of 0.02 rad and reaches 0.07 rad.
        for (peak, allowed) in [
            (80.0f64, 0.15),
            (95.0, 0.15),
            (140.0, 0.15),
            (165.0, 0.3),
            (180.0, 0.3),
        ] {
            let mut motion = crate::random_phrase::random_phrase(4, 150);
            let noise = kinegrad_random::Key::new(3, kinegrad_random::Purpose::Noise).normals(900);
            for t in 0..150 {
                let pitch = peak.to_radians() * (0.021 * t as f64).sin().abs();
                let bent = Quaternion::from_rotation_vector([pitch, 0.0, 0.0]);
                motion.set_quaternion(t, Quaternion::from_yaw(0.4) * bent);
            }
            crate::postprocess::derive_angular_velocity(&mut motion);
            let original = motion.clone();
            for (t, noise) in noise.chunks(6).enumerate() {
                let noise: Vec<f64> = noise.iter().map(|&value| f64::from(value)).collect();
                let shaken = Quaternion::from_rotation_vector([0, 1, 2].map(|i| 0.02 * noise[i]));
                motion.set_quaternion(t, shaken * motion.quaternion(t));
                let rate = motion.vector(t, ANGULAR_VELOCITY);
                let rate = [0, 1, 2].map(|i| rate[i] + 0.12 * noise[3 + i]);
                motion.set_vector(t, ANGULAR_VELOCITY, rate);
            }
            fit_heading(&mut motion, &[1.0; 25], &[false; 150], &[1.0; 150]);
            assert!(
                apart(&original, &motion) < allowed,
                "{peak}: {}",
                apart(&original, &motion)
            );
        }
    }

    #[test]
    fn a_slowly_turning_body_with_low_confidence_keeps_its_heading() {
        let mut motion = turning(300);
        for t in 0..300 {
            motion.set_quaternion(t, Quaternion::from_yaw(0.7));
            motion.set_vector(t, ANGULAR_VELOCITY, [0.0; 3]);
        }
        let original = motion.clone();
        for std in [1.0, 1e-3, 1e-6] {
            fit_heading(&mut motion, &[std; 25], &[false; 300], &[0.0; 300]);
            assert!(apart(&original, &motion) < 1e-4, "{std}");
        }
    }
}
