//! Tuning: the deviation from concert pitch.
//!
//! Source: librosa 0.11 `estimate_tuning` with 36 bins an octave.

use rayon::prelude::*;

use crate::cqt::BINS_PER_OCTAVE;
use crate::onset::median;
use crate::stft::{BINS, N_FFT, Stft, bin_frequency};

const HOP: usize = 512;
const LOWEST_HZ: f64 = 150.0;
const HIGHEST_HZ: f64 = 4000.0;
/// Least height of a peak, relative to its frame's maximum.
const PEAK_THRESHOLD: f32 = 0.1;
/// 440 Hz, four octaves down.
const REFERENCE_HZ: f64 = 27.5;
/// Histogram bars per bin of the transform.
const BARS: usize = 100;

/// A spectral peak between two bins.
struct Peak {
    height: f32,
    /// Distance to the nearest bin of the concert-pitch scale, in bins, in [-0.5, 0.5).
    residual: f32,
}

/// The deviation from concert pitch in fractions of a 1/36-octave bin, a multiple of 0.01 in
/// [-0.5, 0.5); 0 without peaks, arbitrary for noise.
pub fn estimate(signal: &[f32]) -> f64 {
    let stft = Stft::default();
    let mut peaks: Vec<Peak> = (0..1 + signal.len() / HOP)
        .into_par_iter()
        .with_min_len(64)
        .map_init(
            || stft.scratch(),
            |scratch, t| peaks(stft.magnitudes(signal, t * HOP, scratch)),
        )
        .flatten_iter()
        .collect();
    let mut heights: Vec<f32> = peaks.iter().map(|peak| peak.height).collect();
    let threshold = median(&mut heights);
    peaks.retain(|peak| peak.height >= threshold);
    if peaks.is_empty() {
        return 0.0;
    }
    let mut histogram = [0usize; BARS];
    for peak in &peaks {
        let bar = ((f64::from(peak.residual) + 0.5) * BARS as f64).floor() as usize;
        histogram[bar.min(BARS - 1)] += 1;
    }
    // The first of the fullest bars.
    let fullest = (0..BARS).rev().max_by_key(|&bar| histogram[bar]);
    (fullest.unwrap_or(BARS / 2) as f64 - BARS as f64 / 2.0) / BARS as f64
}

/// The peaks of one frame, placed by a parabola through three bins.
fn peaks(magnitudes: &[f32]) -> Vec<Peak> {
    let threshold = PEAK_THRESHOLD * magnitudes.iter().copied().fold(0.0, f32::max);
    let above_threshold = |k: usize| {
        if magnitudes[k] > threshold {
            magnitudes[k]
        } else {
            0.0
        }
    };
    (1..BINS - 1)
        .filter(|&k| (LOWEST_HZ..HIGHEST_HZ).contains(&bin_frequency(k)))
        .filter(|&k| {
            above_threshold(k) > above_threshold(k - 1)
                && above_threshold(k) >= above_threshold(k + 1)
        })
        .map(|k| {
            let [below, at, above] = [k - 1, k, k + 1].map(|k| f64::from(magnitudes[k]));
            let curvature = above + below - 2.0 * at;
            let slope = (above - below) / 2.0;
            let shift = if slope.abs() < curvature.abs() {
                -slope / curvature
            } else {
                0.0
            };
            let frequency = (k as f64 + shift) * f64::from(crate::SAMPLE_RATE) / N_FFT as f64;
            let bin = BINS_PER_OCTAVE as f64 * (frequency / REFERENCE_HZ).log2();
            let fraction = bin - bin.floor();
            let residual = if fraction >= 0.5 {
                fraction - 1.0
            } else {
                fraction
            };
            Peak {
                height: (at + 0.5 * slope * shift) as f32,
                residual: residual as f32,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sharp_tone_is_found_sharp() {
        let bins = 0.25;
        let step = std::f64::consts::TAU * 440.0 * 2f64.powf(bins / 36.0) / 44_100.0;
        let tone: Vec<f32> = (0..44_100)
            .map(|n| (n as f64 * step).sin() as f32)
            .collect();
        let found = estimate(&tone);
        assert!((found - bins).abs() <= 0.05, "{found}");
    }

    #[test]
    fn silence_is_in_tune() {
        assert_eq!(estimate(&[0.0; 5000]), 0.0);
        assert_eq!(estimate(&[]), 0.0);
    }
}
