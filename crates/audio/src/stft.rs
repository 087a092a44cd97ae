//! Magnitudes of the short-time Fourier transform.

use std::f64::consts::TAU;
use std::sync::Arc;

use realfft::num_complex::Complex32;
use realfft::{RealFftPlanner, RealToComplex};

/// Samples in a frame.
pub const N_FFT: usize = 2048;

/// Frequency bins of a frame, from 0 Hz to half the sample rate.
pub const BINS: usize = N_FFT / 2 + 1;

/// Frequency of bin `k` in Hz.
pub fn bin_frequency(k: usize) -> f64 {
    k as f64 * f64::from(crate::SAMPLE_RATE) / N_FFT as f64
}

/// The transform with a periodic Hann window of [`N_FFT`] samples and no scaling.
///
/// ```text
/// |X[k]| = | sum_n w[n] y[c - N/2 + n] exp(-2 pi i k n / N) |,  w[n] = 0.5 - 0.5 cos(2 pi n / N)
/// ```
/// Outside the signal `y` is zero.
pub struct Stft {
    transform: Arc<dyn RealToComplex<f32>>,
    window: Vec<f32>,
}

/// Working memory of one thread.
pub struct Scratch {
    frame: Vec<f32>,
    spectrum: Vec<Complex32>,
    transform: Vec<Complex32>,
    magnitudes: Vec<f32>,
}

impl Default for Stft {
    fn default() -> Self {
        let window = (0..N_FFT).map(|n| 0.5 - 0.5 * (TAU * n as f64 / N_FFT as f64).cos());
        Self {
            transform: RealFftPlanner::new().plan_fft_forward(N_FFT),
            window: window.map(|w| w as f32).collect(),
        }
    }
}

impl Stft {
    /// Working memory for [`magnitudes`](Self::magnitudes).
    pub fn scratch(&self) -> Scratch {
        Scratch {
            frame: self.transform.make_input_vec(),
            spectrum: self.transform.make_output_vec(),
            transform: self.transform.make_scratch_vec(),
            magnitudes: vec![0.0; BINS],
        }
    }

    /// The [`BINS`] magnitudes of the frame centred on sample `centre` of `signal`.
    pub fn magnitudes<'a>(
        &self,
        signal: &[f32],
        centre: usize,
        scratch: &'a mut Scratch,
    ) -> &'a [f32] {
        copy_centred(signal, centre, &mut scratch.frame);
        for (sample, weight) in scratch.frame.iter_mut().zip(&self.window) {
            *sample *= weight;
        }
        self.transform
            .process_with_scratch(
                &mut scratch.frame,
                &mut scratch.spectrum,
                &mut scratch.transform,
            )
            .expect("the buffers were made for this transform");
        for (magnitude, bin) in scratch.magnitudes.iter_mut().zip(&scratch.spectrum) {
            *magnitude = (bin.re * bin.re + bin.im * bin.im).sqrt();
        }
        &scratch.magnitudes
    }
}

/// Fills `frame` with the samples around `centre`, zeros outside the signal.
pub(crate) fn copy_centred(signal: &[f32], centre: usize, frame: &mut [f32]) {
    let half = frame.len() / 2;
    let first = centre.saturating_sub(half).min(signal.len());
    let last = (centre + frame.len() - half).min(signal.len());
    let skipped = half.saturating_sub(centre);
    frame.fill(0.0);
    frame[skipped..][..last - first].copy_from_slice(&signal[first..last]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_on_a_bin_has_half_its_window_sum_there() {
        let signal: Vec<f32> = (0..N_FFT)
            .map(|n| (TAU * 40.0 * n as f64 / N_FFT as f64).sin() as f32)
            .collect();
        let stft = Stft::default();
        let mut scratch = stft.scratch();
        let magnitudes = stft.magnitudes(&signal, N_FFT / 2, &mut scratch);
        assert!((magnitudes[40] - N_FFT as f32 / 4.0).abs() < 1e-2);
        assert!(magnitudes[50] < 1e-3);
    }

    #[test]
    fn a_frame_over_the_border_is_filled_with_zeros() {
        let mut frame = [9.0; 6];
        copy_centred(&[1.0, 2.0, 3.0], 1, &mut frame);
        assert_eq!(frame, [0.0, 0.0, 1.0, 2.0, 3.0, 0.0]);
        copy_centred(&[1.0, 2.0, 3.0], 40, &mut frame);
        assert_eq!(frame, [0.0; 6]);
        copy_centred(&[], 0, &mut frame);
        assert_eq!(frame, [0.0; 6]);
    }
}
