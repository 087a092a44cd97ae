//! Mel-frequency cepstral coefficients.

use std::f64::consts::PI;

use crate::FrameMatrix;
use crate::mel::BANDS;

/// Coefficients, the zeroth included.
pub const COEFFICIENTS: usize = 20;

/// The first [`COEFFICIENTS`] values of the orthonormal DCT-II over the bands of each frame,
/// without a lifter.
///
/// ```text
/// c[i] = sqrt((i == 0 ? 1 : 2) / M) sum_m db[m] cos(pi i (m + 1/2) / M),  M = 128
/// ```
///
/// # Shapes
/// `mel_full_db`: `[T, 128]`; result: `[T, 20]`.
pub fn coefficients(mel_full_db: &FrameMatrix) -> FrameMatrix {
    let bands = BANDS as f64;
    let basis: Vec<f64> = (0..COEFFICIENTS)
        .flat_map(|i| {
            let scale = (if i == 0 { 1.0 } else { 2.0 } / bands).sqrt();
            (0..BANDS).map(move |m| scale * (PI * i as f64 * (m as f64 + 0.5) / bands).cos())
        })
        .collect();
    let mut out = FrameMatrix::zeros(mel_full_db.frames(), COEFFICIENTS);
    for (t, row) in out
        .as_mut_slice()
        .chunks_exact_mut(COEFFICIENTS)
        .enumerate()
    {
        let db = mel_full_db.frame(t);
        for (c, cosines) in row.iter_mut().zip(basis.chunks_exact(BANDS)) {
            *c = cosines
                .iter()
                .zip(db)
                .map(|(b, &v)| b * f64::from(v))
                .sum::<f64>() as f32;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_spectrum_has_only_the_zeroth_coefficient() {
        let mut db = FrameMatrix::zeros(1, BANDS);
        db.as_mut_slice().fill(-2.0);
        let c = coefficients(&db);
        assert!((c.frame(0)[0] + 2.0 * (BANDS as f32).sqrt()).abs() < 1e-5);
        assert!(c.frame(0)[1..].iter().all(|v| v.abs() < 1e-5));
    }
}
