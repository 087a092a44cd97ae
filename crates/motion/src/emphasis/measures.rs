//! Measures of a projection: conditioning, variances, round-trip error.

use kinegrad_random::{Key, Purpose};
use serde::Serialize;

use super::EmphasisProjection;
use crate::moments::{mean, mean_and_deviation};

/// Frames of the round trip.
const FRAMES: usize = 196;

/// Measurements of one [`EmphasisProjection`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EmphasisMeasures {
    /// Largest singular value divided by the smallest.
    pub condition_number: f64,
    /// Smallest variance of a projected feature, if the features are independent with variance 1.
    pub variance_min: f64,
    /// Mean of these variances.
    pub variance_mean: f64,
    /// Largest of these variances.
    pub variance_max: f64,
    /// Population standard deviation of these variances.
    pub variance_std: f64,
    /// Share of the emphasized features in the total variance.
    pub trajectory_share: f64,
    /// Largest absolute error of a single-precision round trip of standard normal frames.
    pub round_trip_max: f64,
    /// Mean absolute error of these frames.
    pub round_trip_mean: f64,
}

impl EmphasisProjection {
    /// Measures this projection, with 196 random frames of `seed` for the round trip.
    pub fn measure(&self, seed: u64) -> EmphasisMeasures {
        let variances = self.variance_per_dimension();
        let (variance_mean, variance_std) = mean_and_deviation(variances.iter().copied());
        // This random stream is one level below the matrix's.
        let frames = Key::new(seed, Purpose::Emphasis)
            .at(0)
            .normals(FRAMES * self.dimension());
        let back = self.unproject(&self.project(&frames));
        let pairs = frames.iter().zip(&back);
        let errors = pairs.map(|(&a, &b)| (f64::from(a) - f64::from(b)).abs());
        EmphasisMeasures {
            condition_number: self.condition_number(),
            variance_min: variances.iter().copied().fold(f64::INFINITY, f64::min),
            variance_mean,
            variance_max: variances.iter().copied().fold(0.0, f64::max),
            variance_std,
            trajectory_share: self.trajectory_share(),
            round_trip_max: errors.clone().fold(0.0, f64::max),
            round_trip_mean: mean(errors),
        }
    }
}
