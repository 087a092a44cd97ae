//! The phase that is nearest to the stated one and advances steadily.
//!
//! With `z_t = exp(2 pi i phase_t)`, `w` its mean advance, and `u_t = z_t exp(-i w t)`:
//!
//! ```text
//! min_v  sum_t |v_t - u_t|^2 + S^4 |v_{t+2} - 2 v_{t+1} + v_t|^2
//! ```
//!
//! which lets the tempo change over times longer than about `2 pi S` frames. The phase is the angle
//! of `v_t exp(i w t)`.

use std::f64::consts::TAU;

use super::weight;
use crate::Motion;
use crate::banded::{BAND, Cholesky};
use crate::phrase::PHASE;

/// `S`: a change of tempo that comes and goes within four seconds is taken for noise.
const STEADINESS_FRAMES: f64 = 20.0;

/// The second difference of three frames.
const SECOND_DIFFERENCE: [f64; 3] = [1.0, -2.0, 1.0];

/// Replaces the phase of a phrase of any length by the nearest one that advances steadily, from 0
/// to below 1, except in frames that are `known`.
///
/// # Panics
/// Panics if there is not one flag for each frame.
pub fn fit_phase(motion: &mut Motion, known: &[bool]) {
    let frames = motion.frames();
    assert_eq!(known.len(), frames, "known frames");
    let angle = |t: usize| TAU * f64::from(motion.frame(t)[PHASE]);
    let steps = (1..frames).map(|t| (angle(t) - angle(t - 1)).sin_cos());
    let (sin, cos) = steps.fold((0.0, 0.0), |sum, step| (sum.0 + step.0, sum.1 + step.1));
    let advance = f64::atan2(sin, cos);

    let mut normal = vec![[0.0; BAND]; frames];
    for (row, known) in normal.iter_mut().zip(known) {
        row[0] = weight(*known);
    }
    for first in 0..frames.saturating_sub(2) {
        for (i, a) in SECOND_DIFFERENCE.iter().enumerate() {
            for (j, b) in SECOND_DIFFERENCE.iter().enumerate().take(i + 1) {
                normal[first + i][i - j] += STEADINESS_FRAMES.powi(4) * a * b;
            }
        }
    }
    let factor = Cholesky::new(normal);
    let fitted = |part: fn(f64) -> f64| {
        let said = (0..frames).map(|t| weight(known[t]) * part(angle(t) - advance * t as f64));
        let mut fitted: Vec<f64> = said.collect();
        factor.solve(&mut fitted);
        fitted
    };
    let (sines, cosines) = (fitted(f64::sin), fitted(f64::cos));
    for t in (0..frames).filter(|t| !known[*t]) {
        let turned = f64::atan2(sines[t], cosines[t]) + advance * t as f64;
        let phase = (turned / TAU).rem_euclid(1.0) as f32;
        // What is just below 1 may round to it.
        motion.frame_mut(t)[PHASE] = if phase < 1.0 { phase } else { 0.0 };
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_random::{Key, Purpose};

    use super::*;
    use crate::circular;
    use crate::phrase::CHANNELS;

    /// A motion with these phases in turns.
    fn with_phases(turns: &[f64]) -> Motion {
        let mut motion = Motion::new(vec![0.0; CHANNELS * turns.len()]).expect("whole frames");
        for (t, turn) in turns.iter().enumerate() {
            motion.frame_mut(t)[PHASE] = turn.rem_euclid(1.0) as f32;
        }
        motion
    }

    fn distance(motion: &Motion, turns: &[f64]) -> f64 {
        let phase = |t: usize| f64::from(motion.frame(t)[PHASE]);
        let distances = turns.iter().enumerate();
        let distances = distances.map(|(t, turn)| circular::distance(phase(t), *turn));
        distances.fold(0.0, f64::max)
    }

    #[test]
    fn a_steady_phase_stays() {
        for (frames, rate) in [(1, 0.02), (2, 0.02), (3, 0.5), (90, 0.017), (77, -0.01)] {
            let turns: Vec<f64> = (0..frames).map(|t| 0.3 + rate * f64::from(t)).collect();
            let mut motion = with_phases(&turns);
            fit_phase(&mut motion, &vec![false; turns.len()]);
            assert!(distance(&motion, &turns) < 1e-4, "{frames} {rate}");
            let phases = (0..turns.len()).map(|t| motion.frame(t)[PHASE]);
            assert!(phases.into_iter().all(|phase| (0.0..1.0).contains(&phase)));
        }
    }

    #[test]
    fn noise_goes_and_a_tempo_that_changes_stays() {
        // From 0.45 to 0.6 bars a second within a minute, with noise of a twentieth of a bar.
        let truth: Vec<f64> = (0..1800)
            .map(|t| f64::from(t) / 30.0)
            .map(|seconds| 0.9 + 0.45 * seconds + 0.15 / 120.0 * seconds * seconds)
            .collect();
        let noise = Key::new(3, Purpose::Noise).normals(truth.len());
        let said = truth.iter().zip(noise);
        let said: Vec<f64> = said.map(|(turn, n)| turn + 0.05 * f64::from(n)).collect();
        let mut motion = with_phases(&said);
        assert!(
            crate::movement::phase_steps(&motion)
                .iter()
                .any(|step| *step < -0.05)
        );
        fit_phase(&mut motion, &vec![false; truth.len()]);
        assert!(
            distance(&motion, &truth) < 0.05,
            "{}",
            distance(&motion, &truth)
        );
        for step in crate::movement::phase_steps(&motion) {
            assert!((0.005..0.03).contains(&step), "{step}");
        }
    }

    #[test]
    fn a_known_phase_is_met() {
        let mut turns: Vec<f64> = (0..60).map(|t| 0.02 * f64::from(t)).collect();
        turns[40..].iter_mut().for_each(|turn| *turn += 0.2);
        let known: Vec<bool> = (0..60).map(|t| t < 40).collect();
        let (mut motion, before) = (with_phases(&turns), with_phases(&turns));
        fit_phase(&mut motion, &known);
        for t in 0..40 {
            assert_eq!(motion.frame(t), before.frame(t));
        }
        let steps = crate::movement::phase_steps(&motion);
        assert!(steps[39..].iter().all(|step| (0.0..0.05).contains(step)));
    }
}
