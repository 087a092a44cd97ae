//! The Fréchet distance between two sets of phrases.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::TRAJECTORY;
use crate::moments::mean_and_deviation;
use crate::{Phrase, Statistics};

/// 9 means, then 9 deviations over frames of [`TRAJECTORY`], in training standard deviations.
pub fn trajectory_features(motion: &Phrase, training: &Statistics) -> Vec<f64> {
    let moments = TRAJECTORY.map(|channel| {
        let values = motion.column(channel);
        let (mean, deviation) = mean_and_deviation(values.into_iter());
        let unit = training.std[channel];
        (mean / unit, deviation / unit)
    });
    let (means, deviations): (Vec<f64>, Vec<f64>) = moments.unzip();
    [means, deviations].concat()
}

/// The normal distribution fitted to a set of feature vectors.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureMoments {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl FeatureMoments {
    /// Mean and unbiased covariance of `features`, `[n, features]`. `None` for fewer than two
    /// vectors or values that are not finite. The covariance may be singular.
    pub fn compute(features: &[Vec<f64>]) -> Option<Self> {
        let count = features.len();
        // The eigendecomposition of NaN does not terminate.
        if count < 2 || features.iter().flatten().any(|value| !value.is_finite()) {
            return None;
        }
        let vectors = features
            .iter()
            .map(|vector| DVector::from_column_slice(vector));
        let vectors: Vec<DVector<f64>> = vectors.collect();
        let mean = vectors.iter().sum::<DVector<f64>>() / count as f64;
        let mut covariance = DMatrix::zeros(mean.len(), mean.len());
        for vector in &vectors {
            let centred = vector - &mean;
            covariance += &centred * centred.transpose();
        }
        covariance /= (count - 1) as f64;
        Some(Self { mean, covariance })
    }
}

/// The squared Fréchet (2-Wasserstein) distance of two normal distributions, as in FID:
///
/// ```text
/// |m1 - m2|^2 + tr(S1 + S2 - 2 (S1^1/2 S2 S1^1/2)^1/2)
/// ```
///
/// Source: Heusel et al. 2017, <https://arxiv.org/abs/1706.08500>.
pub fn frechet_distance(a: &FeatureMoments, b: &FeatureMoments) -> f64 {
    let root = square_root(&a.covariance);
    let mut product = &root * &b.covariance * &root;
    // Rounding makes the matrix slightly asymmetric.
    product = (&product + product.transpose()) / 2.0;
    let eigenvalues = SymmetricEigen::new(product).eigenvalues;
    let roots = eigenvalues
        .iter()
        .map(|eigenvalue| eigenvalue.max(0.0).sqrt());
    let cross: f64 = roots.sum();
    let spread = a.covariance.trace() + b.covariance.trace() - 2.0 * cross;
    // Rounding may make the distance of equal sets negative.
    ((&a.mean - &b.mean).norm_squared() + spread).max(0.0)
}

/// The symmetric square root of a covariance, with eigenvalues clamped to 0.
fn square_root(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let SymmetricEigen {
        eigenvalues,
        eigenvectors,
    } = SymmetricEigen::new(covariance.clone());
    let roots = eigenvalues.map(|eigenvalue| eigenvalue.max(0.0).sqrt());
    &eigenvectors * DMatrix::from_diagonal(&roots) * eigenvectors.transpose()
}

#[cfg(test)]
mod tests {
    use kinegrad_random::{Key, Purpose};
    use proptest::prelude::*;

    use super::*;
    use crate::CHANNELS;
    use crate::random_phrase::random_phrase;

    fn moments(features: &[&[f64]]) -> FeatureMoments {
        let features: Vec<_> = features.iter().map(|vector| vector.to_vec()).collect();
        FeatureMoments::compute(&features).unwrap()
    }

    fn features_of(seed: u64, count: usize, size: usize) -> Vec<Vec<f64>> {
        let vector = |index: usize| {
            let values = Key::new(seed, Purpose::Synthetic).at(index as u64);
            values.normals(size).into_iter().map(f64::from).collect()
        };
        (0..count).map(vector).collect()
    }

    #[test]
    fn in_one_dimension_it_is_the_difference_of_mean_and_deviation() {
        // Means 1 and 6; variances 2 (of 0, 2) and 18 (of 3, 9).
        let (a, b) = (moments(&[&[0.0], &[2.0]]), moments(&[&[3.0], &[9.0]]));
        let expected = 25.0 + (18.0f64.sqrt() - 2.0f64.sqrt()).powi(2);
        assert!((frechet_distance(&a, &b) - expected).abs() < 1e-12);
        assert!((frechet_distance(&b, &a) - expected).abs() < 1e-12);
    }

    #[test]
    fn covariances_that_do_not_commute_are_compared() {
        // S1 = diag(4, 1) and S2 = [[2, 1], [1, 2]], whose eigenvectors differ. For 2 x 2 matrices
        // tr (M^1/2) = sqrt(tr M + 2 sqrt(det M)), M = S1^1/2 S2 S1^1/2: tr M = tr(S1 S2) = 10,
        // det M = 4 * 3.
        let of = |mean: [f64; 2], covariance: [f64; 4]| FeatureMoments {
            mean: DVector::from_column_slice(&mean),
            covariance: DMatrix::from_row_slice(2, 2, &covariance),
        };
        let a = of([0.0, 0.0], [4.0, 0.0, 0.0, 1.0]);
        let b = of([1.0, -2.0], [2.0, 1.0, 1.0, 2.0]);
        let cross = (10.0 + 2.0 * 12.0f64.sqrt()).sqrt();
        let expected = 5.0 + 5.0 + 4.0 - 2.0 * cross;
        assert!((frechet_distance(&a, &b) - expected).abs() < 1e-12);
    }

    #[test]
    fn the_covariance_is_divided_by_one_less_than_the_count() {
        let moments = moments(&[&[0.0, 1.0], &[3.0, 1.0], &[3.0, 4.0]]);
        assert_eq!(moments.mean.as_slice(), [2.0, 2.0]);
        assert_eq!(moments.covariance.as_slice(), [3.0, 1.5, 1.5, 3.0]);
    }

    #[test]
    fn features_are_means_then_deviations_in_training_units() {
        let mut training = crate::phrase_statistics([&random_phrase(0, 9)]).unwrap();
        training.std[..9].fill(1.0);
        training.std[4] = 0.5;
        let mut motion = Phrase::new(vec![0.0; 2 * CHANNELS]).unwrap();
        motion.frame_mut(0)[4] = 1.0;
        motion.frame_mut(1)[4] = 3.0;
        let mut expected = vec![0.0; 18];
        (expected[4], expected[13]) = (4.0, 2.0);
        assert_eq!(trajectory_features(&motion, &training), expected);
    }

    #[test]
    fn one_vector_or_a_broken_one_has_no_moments() {
        assert_eq!(FeatureMoments::compute(&[]), None);
        assert_eq!(FeatureMoments::compute(&[vec![1.0, 2.0]]), None);
        assert_eq!(FeatureMoments::compute(&[vec![1.0], vec![f64::NAN]]), None);
        assert!(FeatureMoments::compute(&[vec![1.0], vec![1.0]]).is_some());
    }

    proptest! {
        #[test]
        fn it_is_a_squared_distance(seed: u64, count in 2usize..40, shift in -5.0..5.0f64) {
            let size = 18;
            let features = features_of(seed, count, size);
            let a = FeatureMoments::compute(&features).unwrap();
            let b = FeatureMoments::compute(&features_of(seed ^ 1, 30, size)).unwrap();
            let there = frechet_distance(&a, &b);
            prop_assert!(there > 0.0);
            // The root of an eigenvalue that should be 0 is about 1e-8.
            prop_assert!((there - frechet_distance(&b, &a)).abs() < 1e-5);
            prop_assert!(frechet_distance(&a, &a) < 1e-5);
            // The second set is moved along one axis.
            let moved: Vec<_> = features
                .into_iter()
                .map(|mut vector| {
                    vector[3] += shift;
                    vector
                })
                .collect();
            let moved = FeatureMoments::compute(&moved).unwrap();
            prop_assert!((frechet_distance(&a, &moved) - shift.powi(2)).abs() < 1e-5);
        }
    }
}
