//! The nearest coherent trajectory to estimates of position, velocity and acceleration.
//!
//! A phrase states the same trajectory three times: by its positions, by its velocities and by its
//! accelerations. Where the three are estimates that contradict each other, this is the
//! trajectory that fits all of them best:
//!
//! ```text
//! min_p  sum_t |p_t - P_t|^2 / s_p^2 + |fps (p_{t+1} - p_t) - V_t|^2 / s_v^2
//!              + |fps^2 (p_{t+2} - 2 p_{t+1} + p_t) - A_t|^2 / s_a^2
//! ```
//!
//! With the training deviations as scales `s`, it is the orthogonal projection of the normalised
//! estimates onto the coherent motions. It is linear in them, so that it is one matrix per axis
//! and number of frames. Differences are forward, as everywhere ([`crate::kinematics`]); two
//! frames beyond the last one let the last velocity and acceleration say what follows.

use crate::phrase::FPS;

/// Frames that the fitted trajectory has beyond those of the estimates.
pub const EXTRA_FRAMES: usize = 2;

/// Diagonals of a symmetric matrix at and below the main one that are not zero.
const BAND: usize = 3;

/// The matrix `[frames + 2, 3 frames]`, row-major, that takes the estimates of one axis, each
/// divided by its scale and laid end to end `[P / s_p | V / s_v | A / s_a]`, to the fitted
/// positions. `scales` are `[s_p, s_v, s_a]` in m, m/s and m/s^2.
///
/// # Panics
/// Panics if a scale is not positive.
pub fn coherent_fit(frames: usize, scales: [f64; 3]) -> Vec<f32> {
    assert!(scales.iter().all(|&scale| scale > 0.0), "scales {scales:?}");
    // What one frame of each estimate says of the positions from its own frame on.
    let stencils: [&[f64]; 3] = [
        &[1.0],
        &[-FPS, FPS],
        &[FPS * FPS, -2.0 * FPS * FPS, FPS * FPS],
    ];
    let stencils: Vec<Vec<f64>> = stencils
        .iter()
        .zip(scales)
        .map(|(stencil, scale)| stencil.iter().map(|weight| weight / scale).collect())
        .collect();

    // The normal equations A^T A p = A^T y.
    let unknowns = frames + EXTRA_FRAMES;
    let mut normal = vec![[0.0; BAND]; unknowns];
    for stencil in &stencils {
        for t in 0..frames {
            for (i, a) in stencil.iter().enumerate() {
                for (j, b) in stencil.iter().enumerate().take(i + 1) {
                    normal[t + i][i - j] += a * b;
                }
            }
        }
    }
    let factor = cholesky(normal);

    let columns = stencils.len() * frames;
    let mut fit = vec![0.0; unknowns * columns];
    let mut column = vec![0.0; unknowns];
    for (estimate, stencil) in stencils.iter().enumerate() {
        for t in 0..frames {
            column.fill(0.0);
            column[t..t + stencil.len()].copy_from_slice(stencil);
            solve(&factor, &mut column);
            for (row, value) in column.iter().enumerate() {
                fit[row * columns + estimate * frames + t] = *value as f32;
            }
        }
    }
    fit
}

/// The lower factor of a positive definite band matrix; entry `[row][d]` is that of column
/// `row - d`.
fn cholesky(mut matrix: Vec<[f64; BAND]>) -> Vec<[f64; BAND]> {
    for row in 0..matrix.len() {
        for d in (0..BAND.min(row + 1)).rev() {
            let column = row - d;
            let shared: f64 = (1..BAND - d)
                .filter(|k| *k <= column)
                .map(|k| matrix[row][d + k] * matrix[column][k])
                .sum();
            let rest = matrix[row][d] - shared;
            matrix[row][d] = if d == 0 {
                rest.sqrt()
            } else {
                rest / matrix[column][0]
            };
        }
    }
    matrix
}

/// Solves `L L^T x = b` in place.
fn solve(factor: &[[f64; BAND]], x: &mut [f64]) {
    for row in 0..x.len() {
        for d in 1..BAND.min(row + 1) {
            x[row] -= factor[row][d] * x[row - d];
        }
        x[row] /= factor[row][0];
    }
    for row in (0..x.len()).rev() {
        for d in 1..BAND.min(x.len() - row) {
            x[row] -= factor[row + d][d] * x[row + d];
        }
        x[row] /= factor[row][0];
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_random::{Key, Purpose};

    use super::*;

    const SCALES: [f64; 3] = [0.9, 0.5, 2.5];

    fn fitted(fit: &[f32], estimates: &[f64]) -> Vec<f64> {
        let dot = |row: &[f32]| {
            row.iter()
                .zip(estimates)
                .map(|(f, e)| f64::from(*f) * e)
                .sum()
        };
        fit.chunks(estimates.len()).map(dot).collect()
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
            let found = fitted(&coherent_fit(frames, SCALES), &implied(&positions));
            for (found, expected) in found.iter().zip(&positions) {
                assert!(
                    (found - expected).abs() < 1e-5,
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
        let best = fitted(&coherent_fit(frames, SCALES), &estimates);
        let least = distance(&best);
        for t in 0..best.len() {
            for step in [-1e-3, 1e-3] {
                let mut other = best.clone();
                other[t] += step;
                assert!(distance(&other) > least, "frame {t}");
            }
        }
    }
}
