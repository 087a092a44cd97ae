//! Properties of both kinds of matrix, and errors.

use proptest::prelude::*;

use super::*;

const CHANNELS: [usize; 3] = [0, 1, 2];

fn of_kind(kind: EmphasisKind, scale: f64, seed: u64, dimension: usize) -> EmphasisProjection {
    let config = EmphasisConfig {
        kind,
        scale,
        seed,
        ..EmphasisConfig::default()
    };
    config.projection(dimension).unwrap().unwrap()
}

#[test]
fn the_orthogonal_matrix_is_better_conditioned_and_its_round_trip_more_exact() {
    let scales = [1.0, 2.0, 5.0, 10.0];
    for scale in scales {
        let measured = |kind| of_kind(kind, scale, 0, 263).measure(0);
        let gaussian = measured(EmphasisKind::Gaussian);
        let orthogonal = measured(EmphasisKind::Orthogonal);
        assert!((orthogonal.condition_number / scale - 1.0).abs() < 1e-5);
        assert!(gaussian.condition_number > 20.0 * orthogonal.condition_number);
        assert!(gaussian.round_trip_max > 5.0 * orthogonal.round_trip_max);
        assert!(gaussian.round_trip_mean > 5.0 * orthogonal.round_trip_mean);
        // Both kinds have the same expected emphasis; the orthogonal kind is exact.
        let expected = relative_importance(scale, 3, 263);
        assert!((orthogonal.trajectory_share - expected).abs() < 1e-6);
        assert!((gaussian.trajectory_share - expected).abs() < 0.1);
        assert!((orthogonal.variance_mean - 1.0).abs() < 1e-6);
        assert!((gaussian.variance_mean - 1.0).abs() < 0.2);
    }
    // An orthogonal matrix without emphasis does not change variances.
    let plain = of_kind(EmphasisKind::Orthogonal, 1.0, 0, 263).measure(0);
    assert!(plain.variance_std < 1e-6);
}

#[test]
fn the_half_of_the_variance_is_reached_at_the_stated_scale() {
    let scale = (260.0f64 / 3.0).sqrt();
    assert!((relative_importance(scale, 3, 263) - 0.5).abs() < 1e-12);
    assert_eq!(relative_importance(10.0, 3, 263), 300.0 / 560.0);
}

#[test]
fn a_frame_is_a_row() {
    // P = [[1, 2], [0, 1]]: the first feature goes to both outputs.
    let projection = EmphasisProjection::from_matrix(&[1.0, 2.0, 0.0, 1.0], 2, 1.0, &[0]).unwrap();
    assert_eq!(projection.inverse(), [1.0, -2.0, 0.0, 1.0]);
    assert_eq!(
        projection.project(&[1.0, 0.0, 3.0, 4.0]),
        [1.0, 2.0, 3.0, 10.0]
    );
    assert_eq!(projection.unproject(&[1.0, 2.0]), [1.0, 0.0]);
    assert_eq!(projection.project(&[]), [0.0f32; 0]);
    assert_eq!(projection.variance_per_dimension(), [1.0, 5.0]);
    assert_eq!(projection.trajectory_share(), 5.0 / 6.0);
    // The eigenvalues of P P^T = [[5, 2], [2, 1]] are 3 +- sqrt(8).
    let expected = ((3.0 + 8f64.sqrt()) / (3.0 - 8f64.sqrt())).sqrt();
    assert!((projection.condition_number() - expected).abs() < 1e-12);
}

#[test]
fn matrices_that_cannot_be_undone_are_refused() {
    let read = |matrix: &[f32], dimension| {
        EmphasisProjection::from_matrix(matrix, dimension, 10.0, &[0]).unwrap_err()
    };
    for (values, dimension) in [(3, 2), (0, 0), (8, 3), (0, usize::MAX)] {
        let expected = EmphasisError::NotSquare { values, dimension };
        assert_eq!(read(&vec![1.0; values], dimension), expected);
    }
    let found = f32::INFINITY;
    let (row, column) = (1, 0);
    let expected = EmphasisError::NonFinite { row, column, found };
    assert_eq!(read(&[1.0, 2.0, found, 4.0], 2), expected);
    let singular = |matrix: &[f32]| match read(matrix, matrix.len().isqrt()) {
        EmphasisError::Singular { .. } => {}
        other => panic!("{other:?}"),
    };
    singular(&[0.0; 4]);
    singular(&[1.0, 2.0, 2.0, 4.0]);
    singular(&[1.0, 2.0, 2.0, 4.000001]);
    singular(&[0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.5, 0.7, 0.9]);
}

proptest! {
    #[test]
    fn frames_come_back(
        seed: u64,
        dimension in 3usize..24,
        scale in 0.5..20.0f64,
        gaussian: bool,
    ) {
        let kind = if gaussian { EmphasisKind::Gaussian } else { EmphasisKind::Orthogonal };
        let projection = of_kind(kind, scale, seed, dimension);
        let allowed = 1e-6 * dimension as f64 * projection.condition_number();
        prop_assert!(projection.measure(seed).round_trip_max < allowed);
    }

    #[test]
    fn orthogonal_rows_are_orthogonal_and_of_the_stated_lengths(
        seed: u64,
        dimension in 3usize..24,
        scale in 0.1..20.0f64,
    ) {
        let projection = of_kind(EmphasisKind::Orthogonal, scale, seed, dimension);
        let size = dimension as f64 / total_variance(dimension, 3, scale);
        let rows: Vec<&[f32]> = projection.matrix().chunks(dimension).collect();
        for (i, a) in rows.iter().enumerate() {
            for (j, b) in rows.iter().enumerate() {
                let dot: f64 = a.iter().zip(*b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
                let length = if CHANNELS.contains(&i) { scale.powi(2) } else { 1.0 };
                let expected = if i == j { length * size } else { 0.0 };
                prop_assert!((dot - expected).abs() < 1e-5 * scale.max(1.0).powi(2) * size);
            }
        }
        let expected = if dimension == 3 { 1.0 } else { scale.max(1.0 / scale) };
        prop_assert!((projection.condition_number() / expected - 1.0).abs() < 1e-4);
    }
}
