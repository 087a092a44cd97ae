//! The coherent trajectory nearest to contradicting positions, velocities and accelerations:
//!
//! ```text
//! min_p  sum_t |p_t - P_t|^2 / s_p^2 + |fps (p_{t+1} - p_t) - V_t|^2 / s_v^2
//!              + |fps^2 (p_{t+2} - 2 p_{t+1} + p_t) - A_t|^2 / s_a^2
//! ```
//!
//! With the training deviations as scales `s`, this is the orthogonal projection of the normalized
//! estimates onto coherent motion. The matrix has two diagonals beside the main diagonal.
//! Differences are forward. Two extra frames complete the last velocity and acceleration.

use super::weight;
use crate::Phrase;
use crate::banded::{BAND, Cholesky};
use crate::phrase::{ACCELERATION, FPS, POSITION, VELOCITY};

/// Frames of the fitted trajectory after the last estimate.
pub const EXTRA_FRAMES: usize = 2;

/// Smallest scales of velocity and acceleration relative to the position scale, 1/s and 1/s^2.
const LEAST_RATES: [f64; 2] = [1e-3, 1e-2];

/// The estimates as linear combinations of positions, from the estimate's frame on.
const STENCILS: [&[f64]; 3] = [
    &[1.0],
    &[-FPS, FPS],
    &[FPS * FPS, -2.0 * FPS * FPS, FPS * FPS],
];

/// The fit of one axis.
#[derive(Clone, Debug)]
pub struct CoherentFit {
    /// `1 / s^2` for each estimate and frame, times the weight of known frames.
    weights: [Vec<f64>; 3],
    /// Factor of the normal equations.
    factor: Cholesky<BAND>,
}

impl CoherentFit {
    /// The fit with `scales` `[s_p, s_v, s_a]` in m, m/s, m/s^2, exact in `known` frames.
    ///
    /// # Panics
    /// Panics if a scale is not positive.
    pub fn new(known: &[bool], scales: [f64; 3]) -> Self {
        assert!(scales.iter().all(|&scale| scale > 0.0), "scales {scales:?}");
        // In known frames the position is decisive; in the last of a run also velocity and
        // acceleration.
        let is_last = |t: usize| known[t] && known.get(t + 1) != Some(&true);
        let decides: [&dyn Fn(usize) -> bool; 3] = [&|t| known[t], &is_last, &is_last];
        let weights = [0, 1, 2].map(|estimate| {
            let (decides, scale): (_, f64) = (decides[estimate], scales[estimate]);
            let of_frame = |t| weight(decides(t)) / (scale * scale);
            (0..known.len()).map(of_frame).collect::<Vec<f64>>()
        });
        let mut normal = vec![[0.0; BAND]; known.len() + EXTRA_FRAMES];
        for (stencil, weights) in STENCILS.iter().zip(&weights) {
            for (t, weight) in weights.iter().enumerate() {
                for (i, a) in stencil.iter().enumerate() {
                    for (j, b) in stencil.iter().enumerate().take(i + 1) {
                        normal[t + i][i - j] += a * b * weight;
                    }
                }
            }
        }
        Self {
            weights,
            factor: Cholesky::new(normal),
        }
    }

    /// Frames of the estimates.
    pub fn frames(&self) -> usize {
        self.weights[0].len()
    }

    /// The fitted positions, `[frames + 2]`, from positions, velocities and accelerations,
    /// `[frames]`.
    pub fn positions(&self, estimates: [&[f64]; 3]) -> Vec<f64> {
        let mut positions = vec![0.0; self.frames() + EXTRA_FRAMES];
        for ((stencil, weights), estimate) in STENCILS.iter().zip(&self.weights).zip(estimates) {
            for (t, (value, weight)) in estimate.iter().zip(weights).enumerate() {
                for (i, a) in stencil.iter().enumerate() {
                    positions[t + i] += a * weight * value;
                }
            }
        }
        self.factor.solve(&mut positions);
        positions
    }

    /// The adjoint of [`positions`](Self::positions).
    pub fn adjoint(&self, mut gradient: Vec<f64>) -> [Vec<f64>; 3] {
        self.factor.solve(&mut gradient);
        let estimates = [0, 1, 2].map(|estimate| (STENCILS[estimate], &self.weights[estimate]));
        estimates.map(|(stencil, weights)| {
            let of = |(t, weight): (usize, &f64)| {
                let terms = stencil.iter().zip(&gradient[t..]);
                weight * terms.map(|(a, g)| a * g).sum::<f64>()
            };
            weights.iter().enumerate().map(of).collect()
        })
    }
}

/// The dense matrix of a fit, `[frames + 2, 3 frames]`, row-major, for devices that multiply
/// matrices. Columns belong to the scaled estimates `[P / s_p | V / s_v | A / s_a]`.
///
/// # Panics
/// Panics if a scale is not positive.
pub fn coherent_matrix(frames: usize, scales: [f64; 3]) -> Vec<f32> {
    let fit = CoherentFit::new(&vec![false; frames], scales);
    let rows = frames + EXTRA_FRAMES;
    let row = |row: usize| {
        let mut unit = vec![0.0; rows];
        unit[row] = 1.0;
        let columns = fit.adjoint(unit).into_iter().zip(scales);
        columns.flat_map(|(column, scale)| column.into_iter().map(move |v| (v * scale) as f32))
    };
    (0..rows).flat_map(row).collect()
}

/// Replaces position, velocity and acceleration of a phrase by the nearest coherent values, except
/// in `known` frames. `std` are the training deviations of the channels, `[25]`.
pub fn fit_trajectory(motion: &mut Phrase, std: &[f64], known: &[bool]) {
    let frames = motion.frames();
    assert_eq!(known.len(), frames, "known frames");
    for axis in 0..3 {
        let components = [POSITION, VELOCITY, ACCELERATION].map(|component| component.start + axis);
        let estimates = components.map(|channel| motion.column(channel));
        let [position, velocity, acceleration] = components.map(|channel| std[channel]);
        // A nearly constant axis would exceed the digits of double precision.
        let scales = [
            position,
            velocity.max(LEAST_RATES[0] * position),
            acceleration.max(LEAST_RATES[1] * position),
        ];
        let fit = CoherentFit::new(known, scales);
        let position = fit.positions([&estimates[0], &estimates[1], &estimates[2]]);
        let velocity = differences(&position);
        let acceleration = differences(&velocity);
        for t in (0..frames).filter(|&t| !known[t]) {
            let frame = motion.frame_mut(t);
            let values = [&position, &velocity, &acceleration].map(|values| values[t] as f32);
            for (channel, value) in components.into_iter().zip(values) {
                frame[channel] = value;
            }
        }
    }
}

fn differences(values: &[f64]) -> Vec<f64> {
    let pairs = values.windows(2);
    pairs.map(|pair| FPS * (pair[1] - pair[0])).collect()
}

#[cfg(test)]
mod tests {
    use kinegrad_random::{Key, Purpose};

    use super::*;

    const SCALES: [f64; 3] = [0.9, 0.5, 2.5];

    /// The fit of scaled and concatenated estimates.
    fn fitted(frames: usize, estimates: &[f64]) -> Vec<f64> {
        let mut parts = estimates.chunks(frames).zip(SCALES);
        let estimates = [(); 3].map(|()| {
            let (part, scale) = parts.next().expect("three estimates");
            part.iter().map(|value| value * scale).collect::<Vec<f64>>()
        });
        let [p, v, a] = &estimates;
        CoherentFit::new(&vec![false; frames], SCALES).positions([p, v, a])
    }

    /// The scaled estimates that positions imply.
    fn implied(positions: &[f64]) -> Vec<f64> {
        let frames = positions.len() - EXTRA_FRAMES;
        let velocity = |t: usize| FPS * (positions[t + 1] - positions[t]);
        let acceleration = |t: usize| FPS * (velocity(t + 1) - velocity(t));
        (0..frames)
            .map(|t| positions[t] / SCALES[0])
            .chain((0..frames).map(|t| velocity(t) / SCALES[1]))
            .chain((0..frames).map(|t| acceleration(t) / SCALES[2]))
            .collect()
    }

    fn walk(frames: usize) -> Vec<f64> {
        (0..frames + EXTRA_FRAMES)
            .map(|t| (t as f64 * 0.11).sin() + 0.02 * t as f64)
            .collect()
    }

    #[test]
    fn a_coherent_motion_stays_as_it_is() {
        for frames in [1, 2, 3, 40] {
            let positions = walk(frames);
            let found = fitted(frames, &implied(&positions));
            for (found, expected) in found.iter().zip(&positions) {
                assert!(
                    (found - expected).abs() < 1e-9,
                    "{frames}: {found} {expected}"
                );
            }
        }
    }

    #[test]
    fn no_other_trajectory_is_nearer() {
        let frames = 12;
        let noise = Key::new(4, Purpose::Noise).normals(3 * frames);
        let estimates: Vec<f64> = implied(&walk(frames))
            .iter()
            .zip(noise)
            .map(|(e, n)| e + f64::from(n))
            .collect();
        let distance = |positions: &[f64]| -> f64 {
            let of = implied(positions);
            of.iter()
                .zip(&estimates)
                .map(|(a, b)| (a - b).powi(2))
                .sum()
        };
        let best = fitted(frames, &estimates);
        let least = distance(&best);
        for t in 0..best.len() {
            for step in [-1e-3, 1e-3] {
                let mut other = best.clone();
                other[t] += step;
                assert!(distance(&other) > least, "frame {t}");
            }
        }
    }

    #[test]
    fn the_matrix_is_the_fit() {
        for frames in [1, 2, 5, 31] {
            let estimates: Vec<f64> = Key::new(6, Purpose::Noise)
                .normals(3 * frames)
                .into_iter()
                .map(f64::from)
                .collect();
            let banded = fitted(frames, &estimates);
            let matrix = coherent_matrix(frames, SCALES);
            assert_eq!(matrix.len(), banded.len() * estimates.len());
            for (row, expected) in matrix.chunks(estimates.len()).zip(&banded) {
                let products = row.iter().zip(&estimates);
                let found: f64 = products.map(|(f, e)| f64::from(*f) * e).sum();
                assert!((found - expected).abs() < 1e-5, "{found} {expected}");
            }
        }
    }

    #[test]
    fn the_adjoint_is_the_gradient() {
        let frames = 9;
        let fit = CoherentFit::new(&vec![false; frames], SCALES);
        let normals = |seed, n| -> Vec<f64> {
            let values = Key::new(seed, Purpose::Noise).normals(n);
            values.into_iter().map(f64::from).collect()
        };
        let (y, g) = (normals(1, 3 * frames), normals(2, frames + EXTRA_FRAMES));
        let loss = |y: &[f64]| -> f64 {
            let mut parts = y.chunks(frames);
            let parts = [(); 3].map(|()| parts.next().expect("three"));
            fit.positions(parts)
                .iter()
                .zip(&g)
                .map(|(p, g)| p * g)
                .sum()
        };
        let gradient = fit.adjoint(g.clone()).concat();
        for (index, found) in gradient.iter().enumerate() {
            let at = |step: f64| {
                let mut y = y.clone();
                y[index] += step;
                loss(&y)
            };
            let expected = (at(1e-3) - at(-1e-3)) / 2e-3;
            assert!(
                (found - expected).abs() < 1e-8,
                "{index}: {found} {expected}"
            );
        }
    }

    #[test]
    fn an_axis_that_hardly_moves_keeps_its_precision() {
        let mut motion = crate::random_phrase::random_phrase(2, 600);
        let original = motion.clone();
        let mut std = [0.9; 25];
        std[VELOCITY].fill(1e-7);
        std[ACCELERATION].fill(1e-7);
        fit_trajectory(&mut motion, &std, &[false; 600]);
        for t in 0..600 {
            let pairs = motion.frame(t)[..3].iter().zip(&original.frame(t)[..3]);
            for (found, expected) in pairs {
                assert!((found - expected).abs() < 1e-2, "{t}: {found} {expected}");
            }
        }
    }

    #[test]
    fn known_positions_dominate_contradicting_accelerations() {
        let mut motion = crate::random_phrase::random_phrase(5, 90);
        let noise = Key::new(1, Purpose::Noise).normals(90);
        for (t, noise) in noise.into_iter().enumerate().take(58) {
            let [x, y, z] = motion.vector(t, ACCELERATION);
            motion.set_vector(t, ACCELERATION, [x + 3.0 * f64::from(noise), y, z]);
        }
        let known: Vec<bool> = (0..90).map(|t| t < 60).collect();
        let original = motion.clone();
        fit_trajectory(&mut motion, &[0.5; 25], &known);
        // The first frame after the known frames continues their motion.
        let step = |motion: &Phrase| motion.frame(60)[0] - motion.frame(59)[0];
        assert!((step(&motion) - step(&original)).abs() < 1e-3);
    }

    #[test]
    fn a_fit_passes_through_known_frames_and_continues_from_there() {
        let mut motion = crate::random_phrase::random_phrase(3, 60);
        let original = motion.clone();
        for t in 20..60 {
            // The other frames are 2 m to the side.
            let [x, y, z] = motion.vector(t, POSITION);
            motion.set_vector(t, POSITION, [x + 2.0, y, z]);
        }
        let known: Vec<bool> = (0..60).map(|t| t < 20).collect();
        fit_trajectory(&mut motion, &[0.5; 25], &known);
        for t in 0..20 {
            assert_eq!(motion.frame(t), original.frame(t), "{t}");
        }
        for t in 0..59 {
            let step = |axis| (motion.frame(t + 1)[axis] - motion.frame(t)[axis]) * FPS as f32;
            for axis in POSITION {
                let stated = motion.frame(t)[VELOCITY.start + axis];
                assert!(
                    (step(axis) - stated).abs() < 2e-3,
                    "{t}: {} {stated}",
                    step(axis)
                );
            }
        }
    }
}
