//! The orientations nearest to contradicting quaternions `Q` and angular velocities `W`:
//!
//! ```text
//! min_q  sum_t |q_t - Q_t|^2 / s_q^2 + |q_{t+1} - exp(W_t / fps) q_t|^2 / s_w^2
//! ```
//!
//! over quaternions of any norm. `r_t` is the integral of the angular velocities, and `q_t = r_t
//! u_t`. The second term is then `|u_{t+1} - u_t|^2`, so each component of `u` solves a tridiagonal
//! system.

use super::weight;
use crate::banded::{BAND, Cholesky};
use crate::derivatives::make_sign_continuous;
use crate::phrase::{ANGULAR_VELOCITY, FPS};
use crate::{Phrase, Quaternion};

/// The scale `s_q`: the root mean square of a component of unit quaternions.
const QUATERNION_SCALE: f64 = 0.5;

/// The scale of headings: the root mean square of a component of unit complex numbers.
const HEADING_SCALE: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Smallest scale of a step, for numerical precision.
const LEAST_STEP: f64 = 1e-6;

/// Smallest scale of a heading step; long stretches may have little weight.
const LEAST_TURN: f64 = 1e-3;

/// The fit of one component of `u`.
#[derive(Clone, Debug)]
pub struct OrientationFit {
    /// Weight of each frame.
    weights: Vec<f64>,
    factor: Cholesky<BAND>,
}

impl OrientationFit {
    /// The fit with a weight for each frame and training deviations of the angular velocity, rad/s.
    ///
    /// # Panics
    /// Panics unless the deviations are positive.
    pub fn new(weights: Vec<f64>, rates: &[f64]) -> Self {
        // A small rotation adds half its rotation vector to a quaternion.
        let step_scale = rates.iter().sum::<f64>() / rates.len() as f64 / (2.0 * FPS);
        Self::weighted(weights, [QUATERNION_SCALE, step_scale])
    }

    /// The fit of headings; `rate` is the deviation of the vertical angular velocity.
    ///
    /// # Panics
    /// Panics unless the deviation is positive.
    pub fn of_headings(weights: Vec<f64>, rate: f64) -> Self {
        assert!(rate > 0.0, "deviation of the angular velocity");
        Self::weighted(weights, [HEADING_SCALE, (rate / FPS).max(LEAST_TURN)])
    }

    fn weighted(weights: Vec<f64>, [scale, step_scale]: [f64; 2]) -> Self {
        assert!(step_scale > 0.0, "deviations of the angular velocity");
        let stiffness = (scale / step_scale.max(LEAST_STEP)).powi(2);
        let mut normal = vec![[0.0; BAND]; weights.len()];
        for (t, weight) in weights.iter().enumerate() {
            normal[t][0] += weight;
            if t > 0 {
                normal[t][0] += stiffness;
                normal[t][1] = -stiffness;
                normal[t - 1][0] += stiffness;
            }
        }
        Self {
            weights,
            factor: Cholesky::new(normal),
        }
    }

    /// Frames of the fit.
    pub fn frames(&self) -> usize {
        self.weights.len()
    }

    /// Fits one component in place, `[frames]`. With equal weights the fit is its own adjoint.
    pub fn fit(&self, component: &mut [f64]) {
        for (value, weight) in component.iter_mut().zip(&self.weights) {
            *value *= weight;
        }
        self.factor.solve(component);
    }
}

/// Replaces the quaternions of a phrase by fitted unit quaternions with continuous sign, except in
/// `known` frames. `std` are the training deviations of the channels, `[25]`.
pub fn fit_orientation(motion: &mut Phrase, std: &[f64], known: &[bool]) {
    let frames = motion.frames();
    assert_eq!(known.len(), frames, "known frames");
    let weights = known.iter().map(|&known| weight(known)).collect();
    let fit = OrientationFit::new(weights, &std[ANGULAR_VELOCITY]);
    let mut turned = Vec::with_capacity(frames);
    let mut rotation = Quaternion::IDENTITY;
    for t in 0..frames {
        turned.push(rotation);
        let step = motion.vector(t, ANGULAR_VELOCITY).map(|rate| rate / FPS);
        rotation = (Quaternion::from_rotation_vector(step) * rotation).normalised();
    }
    let rest = turned.iter().enumerate();
    let rest = rest.map(|(t, turned)| turned.conjugate() * motion.quaternion(t).normalised());
    let mut rest: Vec<Quaternion> = rest.collect();
    make_sign_continuous(&mut rest);

    let parts = [0, 1, 2, 3].map(|part| {
        let mut fitted: Vec<f64> = rest.iter().map(|rest| rest.parts()[part]).collect();
        fit.fit(&mut fitted);
        fitted
    });
    let fitted = turned.into_iter().enumerate().map(|(t, turned)| {
        turned * Quaternion::from([0, 1, 2, 3].map(|part| parts[part][t])).normalised()
    });
    let mut fitted: Vec<Quaternion> = fitted.collect();
    make_sign_continuous(&mut fitted);
    for (t, quaternion) in fitted.into_iter().enumerate() {
        match known[t] {
            true => motion.set_quaternion(t, motion.quaternion(t).nearer_to(quaternion)),
            false => motion.set_quaternion(t, quaternion),
        }
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_random::{Key, Purpose};

    use super::*;
    use crate::random_phrase::random_phrase;

    /// Mean angle in radians between the orientations of two motions.
    fn apart(a: &Phrase, b: &Phrase) -> f64 {
        let apart = |t| (a.quaternion(t) * b.quaternion(t).conjugate()).to_rotation_vector();
        let angles = (0..a.frames()).map(|t| crate::vector::length(apart(t)));
        angles.sum::<f64>() / a.frames() as f64
    }

    fn turn_acceleration(motion: &Phrase) -> f64 {
        let rates = crate::derivatives::angular_rates(motion);
        let steps = rates.windows(2).map(|pair| {
            let parts = pair[1].iter().zip(pair[0]).map(|(b, a)| (b - a).powi(2));
            parts.sum::<f64>().sqrt()
        });
        steps.sum::<f64>() / (rates.len() - 1) as f64
    }

    /// The motion with noisy quaternions and angular velocities, and random signs of quaternions.
    fn shaken(motion: &Phrase, quaternion: f64, rate: f64) -> Phrase {
        let mut shaken = motion.clone();
        let noise = Key::new(9, Purpose::Noise).normals(8 * motion.frames());
        for (t, noise) in noise.chunks(8).enumerate() {
            let noise: Vec<f64> = noise.iter().map(|&value| f64::from(value)).collect();
            let turn = [noise[0], noise[1], noise[2]].map(|value| value * quaternion);
            let sign = if noise[6] < 0.0 { -1.0 } else { 1.0 };
            let turned = Quaternion::from_rotation_vector(turn) * motion.quaternion(t);
            shaken.set_quaternion(t, turned.scale(sign));
            let noisy = motion.vector(t, ANGULAR_VELOCITY);
            let noisy = [0, 1, 2].map(|axis| noisy[axis] + rate * noise[3 + axis]);
            shaken.set_vector(t, ANGULAR_VELOCITY, noisy);
        }
        shaken
    }

    #[test]
    fn orientations_that_agree_stay() {
        for frames in [1, 2, 3, 47] {
            let original = random_phrase(5, frames);
            let mut fitted = original.clone();
            fit_orientation(&mut fitted, &[0.7; 25], &vec![false; frames]);
            assert!(apart(&original, &fitted) < 1e-4, "{frames}");
        }
    }

    #[test]
    fn shaking_goes_and_the_turn_stays() {
        let original = random_phrase(6, 120);
        let shaken = shaken(&original, 0.1, 0.1);
        let mut fitted = shaken.clone();
        fit_orientation(&mut fitted, &[1.0; 25], &[false; 120]);
        let [left, before] = [&fitted, &shaken].map(|motion| apart(&original, motion));
        assert!(left < 0.35 * before, "{left} {before}");
        let [before, after, truth] = [&shaken, &fitted, &original].map(turn_acceleration);
        assert!(
            before > 5.0 * truth && after < 1.1 * truth,
            "{before} {after} {truth}"
        );
        for t in 1..120 {
            assert!(
                fitted.quaternion(t).dot(fitted.quaternion(t - 1)) > 0.9,
                "{t}"
            );
        }
    }

    #[test]
    fn known_frames_stay_and_the_others_turn_towards_them() {
        let original = random_phrase(7, 60);
        let mut motion = original.clone();
        for t in 20..60 {
            // The other frames face another direction with the same angular velocity.
            let turned = Quaternion::from_yaw(0.5) * original.quaternion(t);
            motion.set_quaternion(t, turned.scale(-1.0));
        }
        let known: Vec<bool> = (0..60).map(|t| t < 20).collect();
        fit_orientation(&mut motion, &[1.0; 25], &known);
        for t in 0..20 {
            assert_eq!(motion.frame(t), original.frame(t), "{t}");
        }
        // A jump of half a radian would give 0.97.
        let least = |motion: &Phrase| {
            let step = |t| motion.quaternion(t).dot(motion.quaternion(t - 1));
            (1..60).map(step).fold(1.0, f64::min)
        };
        let [found, before] = [&motion, &original].map(least);
        assert!(found > before - 2e-3, "{found} {before}");
    }
}
