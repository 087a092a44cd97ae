//! Onset strength: growth of the spectrum between frames.
//!
//! ```text
//! d[m, t] = max(0, S[m, t] - S[m, t-1])     S in decibels, 0 to 22050 Hz; d[m, 0] = 0
//! ```
//! Source: librosa 0.11 `onset.onset_strength` with lag 1, no local maximum over frequency, no
//! detrending.

use crate::FrameMatrix;

/// The mean and median growth over the bands, each `[T]`.
#[derive(Clone, Debug, PartialEq)]
pub struct OnsetStrength {
    /// Mean over the bands: the conditioning row before its normalisation.
    pub mean: Vec<f32>,
    /// Median over the bands, for beat tracking.
    pub median: Vec<f32>,
}

/// Onset strength of a spectrogram in decibels.
///
/// # Shapes
/// `mel_full_db`: `[T, 128]`; results: `[T]`.
pub fn strength(mel_full_db: &FrameMatrix) -> OnsetStrength {
    let frames = mel_full_db.frames();
    let mut growth = vec![0.0f32; mel_full_db.width()];
    let mut out = OnsetStrength {
        mean: vec![0.0; frames],
        median: vec![0.0; frames],
    };
    for t in 1..frames {
        let pair = mel_full_db.frame(t).iter().zip(mel_full_db.frame(t - 1));
        for (d, (now, before)) in growth.iter_mut().zip(pair) {
            *d = (now - before).max(0.0);
        }
        let sum: f64 = growth.iter().map(|&d| f64::from(d)).sum();
        out.mean[t] = (sum / growth.len() as f64) as f32;
        out.median[t] = median(&mut growth);
    }
    out
}

/// The middle value, or the mean of the two middle values; 0 without values. Reorders `values`.
pub(crate) fn median(values: &mut [f32]) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let half = values.len() / 2;
    let even = values.len().is_multiple_of(2);
    let (below, &mut upper, _) = values.select_nth_unstable_by(half, f32::total_cmp);
    if even {
        let lower = below.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        (lower + upper) / 2.0
    } else {
        upper
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_growth_counts() {
        let mut db = FrameMatrix::zeros(3, 4);
        db.as_mut_slice()
            .copy_from_slice(&[0., 0., 0., 0., 1., 2., 3., -9., 0., 0., 0., 0.]);
        let onset = strength(&db);
        assert_eq!(onset.mean, vec![0.0, 1.5, 2.25]);
        assert_eq!(onset.median, vec![0.0, 1.5, 0.0]);
    }

    #[test]
    fn medians() {
        assert_eq!(median(&mut []), 0.0);
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&mut [4.0, 1.0, 2.0, 3.0]), 2.5);
    }
}
