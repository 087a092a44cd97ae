//! Symmetric positive definite band systems, solved in linear time.

/// Diagonals from the main one down, in sums of squared second differences.
pub const BAND: usize = 3;

/// The Cholesky factor of a band matrix: entry `[row][d]` with d < `BAND` is in column `row - d`.
#[derive(Clone, Debug)]
pub struct Cholesky<const BAND: usize>(Vec<[f64; BAND]>);

impl<const BAND: usize> Cholesky<BAND> {
    /// The factor of a matrix in the same layout.
    pub fn new(mut matrix: Vec<[f64; BAND]>) -> Self {
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
        Self(matrix)
    }

    /// Solves the system in place.
    pub fn solve(&self, x: &mut [f64]) {
        let factor = &self.0;
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_solution_solves_the_system() {
        for size in [1usize, 2, 3, 17] {
            let matrix: Vec<[f64; BAND]> = (0..size)
                .map(|row| [5.0 + (row as f64).sin(), -1.5, 0.75])
                .collect();
            let entry = |i: usize, j: usize| {
                let (row, d) = (i.max(j), i.abs_diff(j));
                if d < BAND { matrix[row][d] } else { 0.0 }
            };
            let expected: Vec<f64> = (0..size).map(|i| (i as f64 * 1.7).cos()).collect();
            let mut x: Vec<f64> = (0..size)
                .map(|i| (0..size).map(|j| entry(i, j) * expected[j]).sum())
                .collect();
            Cholesky::new(matrix.clone()).solve(&mut x);
            for (found, expected) in x.iter().zip(&expected) {
                assert!(
                    (found - expected).abs() < 1e-12,
                    "{size}: {found} {expected}"
                );
            }
        }
    }
}
