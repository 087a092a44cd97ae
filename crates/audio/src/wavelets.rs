//! The filters of the constant-Q transform, as sparse rows over the spectrum of a frame.
//!
//! Every octave reads frames of [`FRAME`] samples. Source: librosa 0.11 `filters.wavelet` and
//! `util.sparsify_rows`.

use std::f64::consts::{PI, TAU};

use rayon::prelude::*;
use rustfft::algorithm::Radix4;
use rustfft::num_complex::{Complex32, Complex64};
use rustfft::{Fft, FftDirection};

use crate::SAMPLE_RATE;
use crate::cqt::{BINS, BINS_PER_OCTAVE, OCTAVES, bin_frequency};

/// Samples of a frame, after its octave's stride.
pub(crate) const FRAME: usize = 1024;

/// Share of a row's magnitude sum that is dropped, smallest magnitudes first.
const DROPPED_SHARE: f64 = 0.01;

/// One filter: weights of neighbouring bins of a frame's spectrum.
pub(crate) struct Wavelet {
    first_bin: usize,
    weights: Vec<Complex32>,
}

impl Wavelet {
    /// Magnitude of the filter's response to a frame with this spectrum.
    pub fn response(&self, spectrum: &[Complex32]) -> f32 {
        let covered = &spectrum[self.first_bin..][..self.weights.len()];
        let pairs = covered.iter().zip(&self.weights);
        let sum: Complex32 = pairs.map(|(y, w)| y * w).sum();
        (sum.re * sum.re + sum.im * sum.im).sqrt()
    }
}

/// Samples at 22050 Hz between two samples of a frame; octave 0 is the top octave.
pub(crate) fn stride(octave: usize) -> usize {
    1 << octave
}

/// The filters of all [`BINS`], lowest first, `tuning` bins above concert pitch.
pub(crate) fn all(tuning: f64) -> Vec<Wavelet> {
    // A planner of double precision would compile all of rustfft a second time.
    let transform = Radix4::<f64>::new(FRAME, FftDirection::Forward);
    (0..BINS)
        .into_par_iter()
        .with_min_len(BINS_PER_OCTAVE)
        .map(|bin| {
            let kernel = Kernel::new(bin, tuning);
            let mut spectrum = kernel.samples();
            transform.process(&mut spectrum);
            spectrum.truncate(FRAME / 2 + 1);
            spectrum
                .iter_mut()
                .for_each(|weight| *weight *= kernel.gain);
            sparsify(&spectrum, kernel.tail() * kernel.gain)
        })
        .collect()
}

/// A wavelet in time, centred in its frame.
///
/// ```text
/// h[n] = exp(2 pi i f n / sr') w[n] / sum w,  floor(-L/2) <= n < floor(L/2),  L = Q sr' / f
/// ```
/// `w` is a periodic Hann window. The working rate `sr'` is 44100 in the top octave, else 22050;
/// frames contain every `stride`-th sample.
struct Kernel {
    /// Cycles per sample at the working rate.
    frequency: f64,
    /// First sample and the sample after the last, counted from the centre.
    start: f64,
    end: f64,
    /// Distance of the frame's samples at the working rate.
    stride: f64,
    /// Scale of a response: `stride * sqrt(L at 44100) / FRAME`.
    gain: f64,
}

impl Kernel {
    fn new(bin: usize, tuning: f64) -> Self {
        let octave = OCTAVES - 1 - bin / BINS_PER_OCTAVE;
        let full_rate = f64::from(SAMPLE_RATE);
        let (rate, stride) = match octave {
            0 => (full_rate, 2.0),
            _ => (full_rate / 2.0, stride(octave) as f64),
        };
        let ratio = 2f64.powf(2.0 / BINS_PER_OCTAVE as f64);
        let quality = (ratio + 1.0) / (ratio - 1.0);
        let hz = bin_frequency(bin, tuning);
        let length = quality * rate / hz;
        Self {
            frequency: hz / rate,
            start: (-length / 2.0).floor(),
            end: (length / 2.0).floor(),
            stride,
            gain: stride * (quality * full_rate / hz).sqrt() / FRAME as f64,
        }
    }

    /// Magnitude sum, relative to `gain`, of the bins that the frame lacks because of its stride.
    /// The sum decides borderline cases of the sparsification.
    ///
    /// ```text
    /// |H(x)| = |sin(pi x)| / (pi x (x^2 - 1)),  x bins of a transform as long as the wavelet away
    /// ```
    /// For large `x` the mean of `|sin|` is 2 / pi, and the sum of `x^-3` is an integral.
    fn tail(&self) -> f64 {
        let full = FRAME as f64 * self.stride;
        let bin_width = (self.end - self.start) / full;
        let distance = |bin: f64| (bin + 0.5 - self.frequency * full) * bin_width;
        let [near, far] = [FRAME as f64 / 2.0, full / 2.0].map(distance);
        (near.powi(-2) - far.powi(-2)) / (PI * PI * bin_width) / self.stride
    }

    /// The frame's samples.
    fn samples(&self) -> Vec<Complex64> {
        let mut samples = vec![Complex64::default(); FRAME];
        let length = self.end - self.start;
        for (m, sample) in samples.iter_mut().enumerate() {
            let n = (m as f64 - FRAME as f64 / 2.0) * self.stride;
            if n < self.start || n >= self.end {
                continue;
            }
            // sin^2(pi i / M) is the Hann window, and its sum is M / 2.
            let window = (PI * (n - self.start) / length).sin().powi(2) / (length / 2.0);
            *sample = Complex64::from_polar(window, TAU * self.frequency * n);
        }
        samples
    }
}

/// Drops the smallest magnitudes and cuts the row to the remaining bins. `tail` is the magnitude
/// sum beyond the row.
fn sparsify(row: &[Complex64], tail: f64) -> Wavelet {
    let mut sorted: Vec<f64> = row.iter().map(|w| w.norm()).collect();
    let total = sorted.iter().sum::<f64>() + tail;
    sorted.sort_unstable_by(f64::total_cmp);
    let mut sum = tail;
    let smallest = sorted.iter().copied().find(|magnitude| {
        sum += magnitude;
        sum >= DROPPED_SHARE * total
    });
    let is_large = |w: &Complex64| smallest.is_some_and(|smallest| w.norm() >= smallest);
    let first_bin = row.iter().position(is_large).unwrap_or(0);
    let end = row.iter().rposition(is_large).map_or(0, |last| last + 1);
    let weights = row[first_bin..end].iter().map(|w| {
        if is_large(w) {
            Complex32::new(w.re as f32, w.im as f32)
        } else {
            Complex32::ZERO
        }
    });
    Wavelet {
        first_bin,
        weights: weights.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_narrow_bands() {
        for tuning in [-0.5, 0.0, 0.49] {
            let rows = all(tuning);
            assert_eq!(rows.len(), BINS);
            for row in rows {
                assert!(
                    (8..40).contains(&row.weights.len()),
                    "{}",
                    row.weights.len()
                );
                // Below a quarter of the frame's rate the octave filters have full gain.
                assert!(row.first_bin + row.weights.len() < FRAME / 4);
            }
        }
    }
}
