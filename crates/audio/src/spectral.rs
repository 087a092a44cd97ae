//! Features from the shared short-time Fourier transform: both mel spectrograms and the spectral
//! centroid.

use rayon::prelude::*;

use crate::mel::{BANDS, MelBank};
use crate::stft::{BINS, Stft, bin_frequency};
use crate::{FrameMatrix, HOP, num_frames};

/// Summaries of the spectrum of every frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Spectral {
    /// Mel power between 20 and 8000 Hz, `[T, 128]`.
    pub mel_power: FrameMatrix,
    /// Mel power between 0 and 22050 Hz, `[T, 128]`.
    pub mel_full_power: FrameMatrix,
    /// Spectral centroid in Hz, `[T]`.
    pub centroid: Vec<f32>,
}

/// Transforms every frame of `signal` once.
pub fn analyse(signal: &[f32]) -> Spectral {
    let frames = num_frames(signal.len());
    let stft = Stft::default();
    let (conditioning, full_range) = (MelBank::conditioning(), MelBank::full_range());
    let frequencies: Vec<f64> = (0..BINS).map(bin_frequency).collect();
    let mut out = Spectral {
        mel_power: FrameMatrix::zeros(frames, BANDS),
        mel_full_power: FrameMatrix::zeros(frames, BANDS),
        centroid: vec![0.0; frames],
    };
    let rows = out.mel_power.as_mut_slice().par_chunks_exact_mut(BANDS);
    let full_rows = out
        .mel_full_power
        .as_mut_slice()
        .par_chunks_exact_mut(BANDS);
    rows.zip(full_rows)
        .zip(&mut out.centroid)
        .enumerate()
        .with_min_len(32)
        .for_each_init(
            || (stft.scratch(), vec![0.0f32; BINS]),
            |(scratch, power), (t, ((row, full_row), centroid))| {
                let magnitudes = stft.magnitudes(signal, t * HOP, scratch);
                *centroid = spectral_centroid(magnitudes, &frequencies);
                for (p, m) in power.iter_mut().zip(magnitudes) {
                    *p = m * m;
                }
                conditioning.apply(power, row);
                full_range.apply(power, full_row);
            },
        );
    out
}

/// Mean frequency weighted by magnitude; 0 for a silent frame.
fn spectral_centroid(magnitudes: &[f32], frequencies: &[f64]) -> f32 {
    let (mut weighted, mut sum) = (0.0f64, 0.0f64);
    for (&m, f) in magnitudes.iter().zip(frequencies) {
        weighted += f64::from(m) * f;
        sum += f64::from(m);
    }
    if sum < f64::from(f32::MIN_POSITIVE) {
        0.0
    } else {
        (weighted / sum) as f32
    }
}
