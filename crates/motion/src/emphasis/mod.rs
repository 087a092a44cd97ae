//! Emphasis projection: a larger weight of the trajectory in the input of a motion model.
//!
//! The root's rotation and ground position are only three of a frame's 263 features, so a model can
//! neglect the root. The projection multiplies these three by a scale c, and mixes all features by
//! a random matrix of about unit variance. A frame is a row: `y = x P`, `x = y P^-1`. Source:
//! Guided Motion Diffusion, appendix C.
//!
//! Deviation from the source: the factor `1/(D - 3 + 3 c^2)` is a variance, so the matrix uses its
//! square root. As an amplitude the factor would give a variance of 1/560 at c = 10.

mod config;
mod error;
mod measures;

pub use config::{EmphasisConfig, EmphasisKind};
pub use error::EmphasisError;
pub use measures::EmphasisMeasures;

use nalgebra::DMatrix;

/// Condition number at which single precision loses all digits.
const SINGULAR: f64 = 1.0 / f32::EPSILON as f64;

/// A projection of frames of `dimension` features, and its inverse. [`EmphasisConfig::projection`]
/// creates one.
#[derive(Clone, Debug, PartialEq)]
pub struct EmphasisProjection {
    channels: Vec<usize>,
    // nalgebra is column-major. The stored transposes contain P row by row.
    matrix: DMatrix<f32>,
    inverse: DMatrix<f32>,
    condition_number: f64,
}

impl EmphasisProjection {
    /// The published construction from `normals`, independent standard normal numbers `[dimension,
    /// dimension]`. The rows of `channels` are multiplied by `scale`. All values are divided by
    /// `sqrt(D - n + n c^2)`, with D the dimension, n the number of channels and c the scale.
    ///
    /// Projected features have variance 1 on average over matrices. With 263 features and c = 10,
    /// one matrix has variances of about 0.4 to 3 and a condition number in the thousands.
    ///
    /// # Errors
    /// [`EmphasisError::Setting`] about scale or channels, and
    /// [`from_matrix`](Self::from_matrix)'s.
    pub fn gaussian(
        normals: &[f32],
        dimension: usize,
        scale: f64,
        channels: &[usize],
    ) -> Result<Self, EmphasisError> {
        let mut transposed = read(normals, dimension)?;
        config::check(scale, channels, dimension)?;
        emphasise(&mut transposed, scale, channels);
        transposed /= total_variance(dimension, channels.len(), scale).sqrt();
        Self::new(transposed.cast(), channels)
    }

    /// The same emphasis with an orthogonal matrix Q: `P = s diag(c or 1) Q`, `s^2 (D - n + n c^2)
    /// = D`. Q comes from a QR decomposition of `normals` with positive diagonal of R and is
    /// uniformly distributed. The mean variance is 1. The condition number is the scale, its
    /// minimum.
    ///
    /// # Errors
    /// The errors of [`gaussian`](Self::gaussian).
    pub fn orthogonal(
        normals: &[f32],
        dimension: usize,
        scale: f64,
        channels: &[usize],
    ) -> Result<Self, EmphasisError> {
        let normals = read(normals, dimension)?;
        config::check(scale, channels, dimension)?;
        let decomposition = normals.qr();
        let mut rotation = decomposition.q();
        let signs = decomposition.r().diagonal();
        for (mut column, sign) in rotation.column_iter_mut().zip(signs.iter()) {
            column *= sign.signum();
        }
        let mut transposed = rotation.transpose();
        emphasise(&mut transposed, scale, channels);
        let variance = total_variance(dimension, channels.len(), scale);
        transposed *= (dimension as f64 / variance).sqrt();
        Self::new(transposed.cast(), channels)
    }

    /// A published model's matrix, row by row `[dimension, dimension]`, with the scale and channels
    /// that describe it. The inverse is computed in double precision.
    ///
    /// # Errors
    /// [`EmphasisError::NotSquare`], [`EmphasisError::NonFinite`], [`EmphasisError::Singular`], or
    /// [`EmphasisError::Setting`] about scale or channels.
    pub fn from_matrix(
        matrix: &[f32],
        dimension: usize,
        scale: f64,
        channels: &[usize],
    ) -> Result<Self, EmphasisError> {
        let transposed = read(matrix, dimension)?;
        config::check(scale, channels, dimension)?;
        Self::new(transposed.cast(), channels)
    }

    fn new(transposed: DMatrix<f32>, channels: &[usize]) -> Result<Self, EmphasisError> {
        // The stored matrix is what must be inverted.
        let stored: DMatrix<f64> = transposed.clone().cast();
        let singular_values = stored.singular_values();
        let condition_number = singular_values.max() / singular_values.min();
        let singular = || EmphasisError::Singular {
            condition_number,
            limit: SINGULAR,
        };
        // A matrix of zeros gives NaN.
        if condition_number.is_nan() || condition_number >= SINGULAR {
            return Err(singular());
        }
        let inverse = stored.try_inverse().ok_or_else(singular)?;
        Ok(Self {
            channels: channels.to_vec(),
            matrix: transposed,
            inverse: inverse.cast(),
            condition_number,
        })
    }

    /// Number of features of a frame.
    pub fn dimension(&self) -> usize {
        self.matrix.nrows()
    }

    /// P, row by row `[dimension, dimension]`.
    pub fn matrix(&self) -> &[f32] {
        self.matrix.as_slice()
    }

    /// The inverse of P, row by row `[dimension, dimension]`, rounded from double precision.
    pub fn inverse(&self) -> &[f32] {
        self.inverse.as_slice()
    }

    /// Projects frame-major values `[frames, dimension]` in single precision: `y = x P`.
    pub fn project(&self, frames: &[f32]) -> Vec<f32> {
        multiply(&self.matrix, frames)
    }

    /// Brings projected values `[frames, dimension]` back in single precision: `x = y P^-1`.
    pub fn unproject(&self, frames: &[f32]) -> Vec<f32> {
        multiply(&self.inverse, frames)
    }

    /// Largest singular value of P by the smallest: the error amplification of a round trip.
    pub fn condition_number(&self) -> f64 {
        self.condition_number
    }

    /// Variance of each projected feature, `[dimension]`, for independent unit features: `sum_i
    /// P_ij^2`.
    pub fn variance_per_dimension(&self) -> Vec<f64> {
        self.squares().column_sum().as_slice().to_vec()
    }

    /// Share of the emphasized features in the total variance. The expectation is
    /// [`relative_importance`].
    pub fn trajectory_share(&self) -> f64 {
        let of_rows = self.squares().row_sum();
        let emphasised: f64 = self.channels.iter().map(|&row| of_rows[row]).sum();
        emphasised / of_rows.sum()
    }

    fn squares(&self) -> DMatrix<f64> {
        self.matrix.clone().cast::<f64>().map(|value| value.powi(2))
    }
}

/// Share of `channels` features, scaled by `scale`, in the total variance of `dimension` unit
/// features: `n c^2 / (D - n + n c^2)` (GMD, appendix, equation 4).
///
/// # Panics
/// Panics if there are more channels than features.
pub fn relative_importance(scale: f64, channels: usize, dimension: usize) -> f64 {
    channels as f64 * scale.powi(2) / total_variance(dimension, channels, scale)
}

/// Total variance before scaling down: `D - n + n c^2`.
fn total_variance(dimension: usize, channels: usize, scale: f64) -> f64 {
    (dimension - channels) as f64 + channels as f64 * scale.powi(2)
}

/// The transpose of a row-major matrix.
fn read(matrix: &[f32], dimension: usize) -> Result<DMatrix<f64>, EmphasisError> {
    if dimension == 0 || dimension.checked_pow(2) != Some(matrix.len()) {
        return Err(EmphasisError::NotSquare {
            values: matrix.len(),
            dimension,
        });
    }
    if let Some(index) = matrix.iter().position(|value| !value.is_finite()) {
        return Err(EmphasisError::NonFinite {
            row: index / dimension,
            column: index % dimension,
            found: matrix[index],
        });
    }
    let values = matrix.iter().map(|&value| f64::from(value));
    Ok(DMatrix::from_iterator(dimension, dimension, values))
}

/// Multiplies the rows of `channels`, which are columns of the transpose, by `scale`.
fn emphasise(transposed: &mut DMatrix<f64>, scale: f64, channels: &[usize]) {
    for &channel in channels {
        transposed.column_mut(channel).scale_mut(scale);
    }
}

fn multiply(transposed: &DMatrix<f32>, frames: &[f32]) -> Vec<f32> {
    let dimension = transposed.nrows();
    let complete = frames.len().is_multiple_of(dimension);
    assert!(complete, "whole frames of {dimension} features");
    let frames = nalgebra::DMatrixView::from_slice(frames, dimension, frames.len() / dimension);
    (transposed * frames).data.into()
}

#[cfg(test)]
mod tests;
