//! Tempo from the autocorrelation of an onset envelope.
//!
//! Source: librosa 0.11 `feature.tempogram` and `feature.tempo` with a prior of one octave around
//! 120 beats per minute.

use std::f64::consts::TAU;

use rayon::prelude::*;
use rustfft::algorithm::Radix4;
use rustfft::num_complex::Complex64;
use rustfft::{Fft, FftDirection};

/// Frames of a window, and number of lags of the autocorrelation.
pub const LAGS: usize = 240;

/// Frames in a minute: a lag of `lag` frames is `1800 / lag` beats per minute.
pub const FRAMES_PER_MINUTE: f64 = 60.0 * crate::FPS;

const PRIOR_BPM: f64 = 120.0;
/// Width of the prior around a stated tempo, in octaves.
const STATED_OCTAVES: f64 = 0.1;
/// Largest distance from a stated tempo, in octaves.
const STATED_REACH: f64 = 0.3;
/// Estimated tempos are below this limit.
const TOO_FAST_BPM: f64 = 320.0;
/// Windows of a task; fixed, so that sums do not depend on the number of threads.
const WINDOWS: usize = 256;

/// A tempo and its autocorrelation.
#[derive(Clone, Debug, PartialEq)]
pub struct Tempo {
    /// Beats per minute, `1800 / lag` for a whole lag.
    pub bpm: f64,
    /// Time-mean of the normalised local autocorrelation, `[240]`.
    pub tempogram_mean: Vec<f64>,
}

/// The tempo of `onset_envelope`, `[T]`, any scale.
pub fn estimate(onset_envelope: &[f32]) -> Tempo {
    let log_prior = |bpm: f64| match bpm < TOO_FAST_BPM {
        true => -0.5 * (bpm / PRIOR_BPM).log2().powi(2),
        false => f64::NEG_INFINITY,
    };
    choose(onset_envelope, log_prior)
}

/// The tempo of `onset_envelope`, `[T]`, any scale, near `stated` beats per minute, without its
/// half and double.
pub fn estimate_near(onset_envelope: &[f32], stated: f64) -> Tempo {
    // The nearest whole lag is always allowed.
    let nearest = (FRAMES_PER_MINUTE / stated)
        .round()
        .clamp(1.0, (LAGS - 1) as f64);
    let log_prior = |bpm: f64| {
        let octaves = (bpm / stated).log2();
        match octaves.abs() < STATED_REACH || bpm == FRAMES_PER_MINUTE / nearest {
            true => -0.5 * (octaves / STATED_OCTAVES).powi(2),
            false => f64::NEG_INFINITY,
        }
    };
    choose(onset_envelope, log_prior)
}

/// The tempo of the whole lag with the largest log autocorrelation plus log prior.
fn choose(onset_envelope: &[f32], log_prior: impl Fn(f64) -> f64) -> Tempo {
    let tempogram_mean = tempogram_mean(onset_envelope);
    let mut best = (f64::NEG_INFINITY, 1);
    for (lag, &mean) in tempogram_mean.iter().enumerate().skip(1) {
        let score = (1e6 * mean).ln_1p() + log_prior(FRAMES_PER_MINUTE / lag as f64);
        if score > best.0 {
            best = (score, lag);
        }
    }
    Tempo {
        bpm: FRAMES_PER_MINUTE / best.1 as f64,
        tempogram_mean,
    }
}

/// Mean over all frames of the frame's autocorrelation in a Hann window, divided by its largest
/// magnitude: `[240]`.
fn tempogram_mean(onset_envelope: &[f32]) -> Vec<f64> {
    let frames = onset_envelope.len();
    let extended = extend(onset_envelope);
    let hann: Vec<f64> = (0..LAGS)
        .map(|n| 0.5 - 0.5 * (TAU * n as f64 / LAGS as f64).cos())
        .collect();
    // Twice the window, so that the autocorrelation does not wrap.
    let size = (2 * LAGS).next_power_of_two();
    // A planner of double precision would compile all of rustfft a second time.
    let forward = Radix4::<f64>::new(size, FftDirection::Forward);
    let inverse = Radix4::<f64>::new(size, FftDirection::Inverse);
    let sums: Vec<Vec<f64>> = (0..frames.div_ceil(WINDOWS))
        .into_par_iter()
        .map(|block| {
            let mut sum = vec![0.0; LAGS];
            let mut window = vec![Complex64::ZERO; size];
            let mut scratch = vec![Complex64::ZERO; forward.get_inplace_scratch_len()];
            for t in block * WINDOWS..frames.min((block + 1) * WINDOWS) {
                window.fill(Complex64::ZERO);
                for (w, (h, x)) in window.iter_mut().zip(hann.iter().zip(&extended[t..])) {
                    w.re = h * x;
                }
                forward.process_with_scratch(&mut window, &mut scratch);
                window
                    .iter_mut()
                    .for_each(|bin| *bin = bin.norm_sqr().into());
                inverse.process_with_scratch(&mut window, &mut scratch);
                let largest = window[..LAGS].iter().fold(0.0f64, |m, v| m.max(v.re.abs()));
                if largest >= f64::from(f32::MIN_POSITIVE) {
                    for (s, v) in sum.iter_mut().zip(&window) {
                        *s += v.re / largest;
                    }
                }
            }
            sum
        })
        .collect();
    let mut mean = vec![0.0; LAGS];
    for sum in &sums {
        mean.iter_mut().zip(sum).for_each(|(m, s)| *m += s);
    }
    mean.iter_mut().for_each(|m| *m /= frames.max(1) as f64);
    mean
}

/// The curve with half a window of linear decay to zero at either end.
fn extend(curve: &[f32]) -> Vec<f64> {
    const HALF: usize = LAGS / 2;
    let first = f64::from(curve.first().copied().unwrap_or(0.0));
    let last = f64::from(curve.last().copied().unwrap_or(0.0));
    let ramp = |i: usize| i as f64 / HALF as f64;
    let rise = (0..HALF).map(|i| first * ramp(i));
    let fall = (0..HALF).rev().map(|i| last * ramp(i));
    rise.chain(curve.iter().map(|&v| f64::from(v)))
        .chain(fall)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_every_fifteen_frames_is_120_bpm() {
        let pulses: Vec<f32> = (0..600).map(|t| f32::from(u8::from(t % 15 == 0))).collect();
        let tempo = estimate(&pulses);
        assert_eq!(tempo.bpm, 120.0);
        assert!((tempo.tempogram_mean[0] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_ends_fall_to_zero() {
        let extended = extend(&[2.0, 3.0]);
        assert_eq!(extended.len(), LAGS + 2);
        assert_eq!((extended[0], extended[60], extended[120]), (0.0, 1.0, 2.0));
        assert_eq!(
            (extended[121], extended[122], extended[241]),
            (3.0, 3.0 * 119.0 / 120.0, 0.0)
        );
    }
}
