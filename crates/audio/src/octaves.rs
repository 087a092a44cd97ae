//! The signal at half the sample rate, band-limited further for every lower octave.
//!
//! The hop at half rate, 735 samples, is odd, so the rate cannot be halved again. Instead each
//! octave halves only the band: the same half-band filter is applied with taps twice as far apart
//! (the "à trous" cascade). Frames are read with a stride.

use std::f64::consts::PI;

use rayon::prelude::*;

use crate::wavelets::FRAME;

/// Taps of the band filter on one side of its centre, at odd distances. With the window below, the
/// filter passes frequencies up to 0.1 of the rate and attenuates frequencies from 0.4 on by 90 dB.
const BAND_TAPS: usize = 6;
/// Taps of the filter that halves the rate; its transition is 0.46 to 0.54 of the new rate.
const RATE_TAPS: usize = 40;
const KAISER_BETA: f64 = 10.06;
/// Widest spread of the taps: the six filters below octave 1 are spread 1 to 32.
const WIDEST_SPREAD: usize = 32;
/// Samples of silence on both sides of the signal, where the filters ring out: the sum of the
/// filters' reaches, plus the last reach again for reading.
const PAD: usize = reach(BAND_TAPS) * 3 * WIDEST_SPREAD + reach(BAND_TAPS);
/// Number of full-rate samples on each side of a frame's centre that affect the frame.
pub(crate) const CONTEXT: usize = 2 * (PAD + FRAME / 2 * 2 * WIDEST_SPREAD + RATE_TAPS);
/// Samples of a task.
const CHUNK: usize = 4096;

/// The band-limited signal of the current octave, at 22050 samples a second.
pub(crate) struct Octaves<'a> {
    signal: &'a [f32],
    /// Taps of the band filter.
    taps: Vec<f32>,
    /// The octave's signal with [`PAD`] samples on both sides.
    samples: Vec<f32>,
    filtered: Vec<f32>,
    /// Spread of the next filter's taps: 1, 2, 4, ...
    spread: usize,
}

impl<'a> Octaves<'a> {
    /// The top octave of `signal`: every second sample.
    pub fn new(signal: &'a [f32]) -> Self {
        let taps = half_band(BAND_TAPS);
        let samples = halve(signal, &taps);
        Self {
            signal,
            filtered: vec![0.0; samples.len()],
            taps,
            samples,
            spread: 1,
        }
    }

    /// Halves the band: the next octave down.
    pub fn descend(&mut self) {
        if self.spread == 1 {
            // The reference reads the top octave at the full rate and the other octaves from a
            // half-rate signal with sharp ends.
            self.samples = halve(self.signal, &half_band(RATE_TAPS));
            let end = self.samples.len() - PAD;
            self.samples[..PAD].fill(0.0);
            self.samples[end..].fill(0.0);
        }
        let (samples, taps, spread) = (&self.samples, &self.taps, self.spread);
        filter(
            &mut self.filtered,
            reach(BAND_TAPS) * spread,
            |first, out| {
                for (y, x) in out.iter_mut().zip(&samples[first..]) {
                    *y = 0.5 * x;
                }
                for (m, tap) in taps.iter().enumerate() {
                    let distance = (2 * m + 1) * spread;
                    let (before, after) =
                        (&samples[first - distance..], &samples[first + distance..]);
                    add_pair(out, *tap, before, after);
                }
            },
        );
        std::mem::swap(&mut self.samples, &mut self.filtered);
        self.spread *= 2;
    }

    /// Fills `frame` with every `stride`-th sample around `centre`, zeros outside the signal.
    pub fn gather(&self, centre: usize, stride: usize, frame: &mut [f32]) {
        let before = stride * (frame.len() / 2);
        let centre = centre + PAD;
        // Samples of the frame before the first stored one.
        let skipped = before
            .saturating_sub(centre)
            .div_ceil(stride)
            .min(frame.len());
        let (silent, rest) = frame.split_at_mut(skipped);
        silent.fill(0.0);
        let first = (centre + stride * skipped).saturating_sub(before);
        let stored = self.samples.get(first..).unwrap_or_default();
        let mut stored = stored.iter().step_by(stride);
        for value in rest {
            *value = stored.next().copied().unwrap_or(0.0);
        }
    }
}

/// Distance of the farthest tap.
const fn reach(taps: usize) -> usize {
    2 * taps - 1
}

/// `signal` at half the rate, between [`PAD`] samples.
fn halve(signal: &[f32], taps: &[f32]) -> Vec<f32> {
    let half = signal.len().div_ceil(2);
    let even = padded(signal.iter().copied().step_by(2), half);
    let odd = padded(signal.iter().copied().skip(1).step_by(2), half);
    let mut out = vec![0.0; even.len()];
    filter(&mut out, taps.len(), |first, out| {
        for (y, x) in out.iter_mut().zip(&even[first..]) {
            *y = 0.5 * x;
        }
        for (m, tap) in taps.iter().enumerate() {
            add_pair(out, *tap, &odd[first - m - 1..], &odd[first + m..]);
        }
    });
    out
}

/// `samples` between [`PAD`] zeros, `len + 2 * PAD` in all.
fn padded(samples: impl Iterator<Item = f32>, len: usize) -> Vec<f32> {
    let mut out = Vec::with_capacity(len + 2 * PAD);
    out.resize(PAD, 0.0);
    out.extend(samples);
    out.resize(len + 2 * PAD, 0.0);
    out
}

/// Calls `chunk(first, out)` for the parts of `out`, without `reach` samples at either end.
fn filter(out: &mut [f32], reach: usize, chunk: impl Fn(usize, &mut [f32]) + Sync) {
    let end = out.len() - reach;
    out[reach..end]
        .par_chunks_mut(CHUNK)
        .enumerate()
        .for_each(|(i, out)| chunk(reach + i * CHUNK, out));
}

fn add_pair(out: &mut [f32], tap: f32, before: &[f32], after: &[f32]) {
    for (y, (a, b)) in out.iter_mut().zip(before.iter().zip(after)) {
        *y += tap * (a + b);
    }
}

/// `count` taps at the distances 1, 3, 5, ... of a half-band low-pass filter; the centre tap is
/// 1/2.
fn half_band(count: usize) -> Vec<f32> {
    let window = |n: f64| {
        let edge = 1.0 - (n / (reach(count) + 1) as f64).powi(2);
        bessel_i0(KAISER_BETA * edge.sqrt()) / bessel_i0(KAISER_BETA)
    };
    let taps = (0..count).map(|m| {
        let n = (2 * m + 1) as f64;
        (PI * n / 2.0).sin() / (PI * n) * window(n)
    });
    let taps: Vec<f64> = taps.collect();
    let sum: f64 = taps.iter().sum();
    // Unit gain at 0 Hz: 1/2 + 2 * sum = 1.
    taps.iter().map(|tap| (tap / (4.0 * sum)) as f32).collect()
}

/// The modified Bessel function of order 0, by its power series.
fn bessel_i0(x: f64) -> f64 {
    let mut term = 1.0;
    let mut sum = 1.0;
    for k in 1..60 {
        term *= (x / (2.0 * f64::from(k))).powi(2);
        sum += term;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gain of a half-band filter at `f` times the rate.
    fn gain(taps: usize, f: f64) -> f64 {
        let pairs = half_band(taps)
            .into_iter()
            .enumerate()
            .map(|(m, tap)| 2.0 * f64::from(tap) * (2.0 * PI * f * (2 * m + 1) as f64).cos());
        0.5 + pairs.sum::<f64>()
    }

    #[test]
    fn the_filters_have_their_pass_and_stop_bands() {
        for (taps, passed) in [(BAND_TAPS, 0.1), (RATE_TAPS, 0.23)] {
            for i in 0..=100 {
                let f = passed * f64::from(i) / 100.0;
                assert!((gain(taps, f) - 1.0).abs() < 3e-5, "{f}");
                assert!(gain(taps, 0.5 - f).abs() < 3e-5, "{f}");
            }
        }
    }

    #[test]
    fn a_slow_signal_passes_every_octave_unchanged() {
        let slow: Vec<f32> = (0..40_000).map(|n| (n as f32 * 0.002).cos()).collect();
        let mut octaves = Octaves::new(&slow);
        for _ in 0..6 {
            octaves.descend();
        }
        let mut frame = [0.0; 4];
        octaves.gather(10_000, 8, &mut frame);
        for (value, n) in frame.iter().zip([9984, 9992, 10_000, 10_008]) {
            assert!((value - slow[2 * n]).abs() < 1e-4);
        }
    }

    #[test]
    fn frames_over_the_ends_are_filled_with_zeros() {
        for len in [0, 1, 3] {
            let signal = vec![1.0; len];
            let octaves = Octaves::new(&signal);
            let mut frame = [9.0; 1024];
            octaves.gather(0, 64, &mut frame);
            assert!(frame[..400].iter().chain(&frame[600..]).all(|&v| v == 0.0));
            octaves.gather(1_000_000, 64, &mut frame);
            assert_eq!(frame, [0.0; 1024]);
        }
    }
}
