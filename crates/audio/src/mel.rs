//! Mel filter banks and decibels.
//!
//! ```text
//! mel(f) = f / (200/3)                       below 1000 Hz
//!        = 15 + ln(f / 1000) / (ln 6.4 / 27) from there on
//! db(S, ref) = 10 log10(max(1e-10, S)) - 10 log10(max(1e-10, ref)), not below its maximum - 80
//! ```
//! Source: Slaney, Auditory Toolbox, 1998; librosa 0.11 `filters.mel`, `power_to_db`.

use crate::FrameMatrix;
use crate::stft::{BINS, bin_frequency};

/// Bands of a bank.
pub const BANDS: usize = 128;

/// Decibels from the loudest value to the floor.
pub const DYNAMIC_RANGE_DB: f64 = 80.0;

const QUIETEST_POWER: f64 = 1e-10;
const HZ_PER_MEL: f64 = 200.0 / 3.0;
const BREAK_HZ: f64 = 1000.0;
const BREAK_MEL: f64 = BREAK_HZ / HZ_PER_MEL;
/// Logarithmic step of a mel above the break: ln(6.4) / 27.
const LOG_STEP: f64 = 1.856_297_990_365_626_3 / 27.0;

/// [`BANDS`] triangular filters of equal area, equally spaced on Slaney's mel scale.
pub struct MelBank {
    filters: Vec<Filter>,
}

/// The nonzero part of a filter.
struct Filter {
    first_bin: usize,
    weights: Vec<f32>,
}

impl MelBank {
    /// The bank between `low` and `high` Hz.
    pub fn new(low: f64, high: f64) -> Self {
        let (low, high) = (hz_to_mel(low), hz_to_mel(high));
        let step = (high - low) / (BANDS + 1) as f64;
        let edges: Vec<f64> = (0..BANDS + 2)
            .map(|i| mel_to_hz(low + step * i as f64))
            .collect();
        let filters = edges.windows(3).map(|edge| {
            let weight = |k: usize| {
                let f = bin_frequency(k);
                let rise = (f - edge[0]) / (edge[1] - edge[0]);
                let fall = (edge[2] - f) / (edge[2] - edge[1]);
                rise.min(fall).max(0.0) * 2.0 / (edge[2] - edge[0])
            };
            let inside: Vec<usize> = (0..BINS).filter(|&k| weight(k) > 0.0).collect();
            Filter {
                first_bin: inside.first().copied().unwrap_or(0),
                weights: inside.iter().map(|&k| weight(k) as f32).collect(),
            }
        });
        Self {
            filters: filters.collect(),
        }
    }

    /// The bank of the mel rows, 20 to 8000 Hz.
    pub fn conditioning() -> Self {
        Self::new(20.0, 8000.0)
    }

    /// The bank behind MFCC and onset strength, 0 to 22050 Hz.
    pub fn full_range() -> Self {
        Self::new(0.0, f64::from(crate::SAMPLE_RATE) / 2.0)
    }

    /// Sums the power spectrum of one frame in each band.
    ///
    /// # Shapes
    /// `power`: `[1025]`; `bands`: `[128]`.
    pub fn apply(&self, power: &[f32], bands: &mut [f32]) {
        for (band, filter) in bands.iter_mut().zip(&self.filters) {
            let covered = &power[filter.first_bin..][..filter.weights.len()];
            *band = covered
                .iter()
                .zip(&filter.weights)
                .map(|(p, w)| p * w)
                .sum();
        }
    }
}

fn hz_to_mel(f: f64) -> f64 {
    if f < BREAK_HZ {
        f / HZ_PER_MEL
    } else {
        BREAK_MEL + (f / BREAK_HZ).ln() / LOG_STEP
    }
}

fn mel_to_hz(mel: f64) -> f64 {
    if mel < BREAK_MEL {
        mel * HZ_PER_MEL
    } else {
        BREAK_HZ * ((mel - BREAK_MEL) * LOG_STEP).exp()
    }
}

/// A power spectrogram in decibels relative to `reference`, cut off [`DYNAMIC_RANGE_DB`] below
/// its own maximum.
pub fn decibels(mut power: FrameMatrix, reference: f32) -> FrameMatrix {
    let level = |p: f32| 10.0 * f64::from(p).max(QUIETEST_POWER).log10();
    let zero = level(reference);
    let quietest = level(maximum(&power)) - zero - DYNAMIC_RANGE_DB;
    for value in power.as_mut_slice() {
        *value = (level(*value) - zero).max(quietest) as f32;
    }
    power
}

/// The largest value of a power spectrogram.
pub fn maximum(power: &FrameMatrix) -> f32 {
    power.as_slice().iter().copied().fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_and_its_inverse_agree() {
        for f in [0.0, 20.0, 999.0, 1000.0, 6400.0, 22050.0] {
            assert!((mel_to_hz(hz_to_mel(f)) - f).abs() < 1e-9);
        }
        assert!((hz_to_mel(6400.0) - 42.0).abs() < 1e-9);
        assert!((LOG_STEP - 6.4f64.ln() / 27.0).abs() < 1e-15);
    }

    #[test]
    fn no_filter_is_empty() {
        for bank in [MelBank::conditioning(), MelBank::full_range()] {
            assert_eq!(bank.filters.len(), BANDS);
            assert!(bank.filters.iter().all(|f| !f.weights.is_empty()));
        }
    }

    #[test]
    fn decibels_stop_eighty_below_the_loudest() {
        let mut power = FrameMatrix::zeros(1, 3);
        power.as_mut_slice().copy_from_slice(&[1e-3, 1.0, 0.0]);
        let db = decibels(power, 1.0);
        assert_eq!(db.as_slice(), &[-30.0, 0.0, -80.0]);
        let silence = decibels(FrameMatrix::zeros(2, 3), 0.0);
        assert!(silence.as_slice().iter().all(|&v| v == 0.0));
    }
}
