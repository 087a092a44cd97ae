//! The constant-Q transform: 252 bins a third of a semitone apart.
//!
//! ```text
//! C[k, t] = sqrt(L_k) | sum_n h_k[-n] y[t * HOP + n] |,  L_k = Q * 44100 / f_k
//! f_k = 440 * 2^(-45/12) * 2^((k + tuning) / 36),  Q = (2^(2/36) + 1) / (2^(2/36) - 1)
//! ```
//! `h_k` is a Hann-windowed complex exponential of length `L_k` and L1 norm 1. The smallest values
//! of its spectrum (1 % of the magnitude sum) are zero. A unit sine on a bin's centre gives
//! `sqrt(L_k) / 2`.
//!
//! Each octave is computed from frames of 1024 samples of a band-limited signal, instead of frames
//! of up to 65536 samples. Source: Schörkhuber and Klapuri, Constant-Q transform toolbox for music
//! processing, 2010; librosa 0.11 `cqt`.

use rayon::prelude::*;
use realfft::RealFftPlanner;

use crate::octaves::{self, Octaves};
use crate::wavelets::{self, FRAME};
use crate::{FrameMatrix, HOP, num_frames};

/// Bins in an octave.
pub const BINS_PER_OCTAVE: usize = 36;

/// Octaves from C1 upwards.
pub const OCTAVES: usize = 7;

/// Bins in all.
pub const BINS: usize = OCTAVES * BINS_PER_OCTAVE;

/// Centre frequency of bin `k` in Hz, `tuning` bins above concert pitch.
pub fn bin_frequency(k: usize, tuning: f64) -> f64 {
    440.0 * 2f64.powf(-45.0 / 12.0 + (k as f64 + tuning) / BINS_PER_OCTAVE as f64)
}

/// Frames of a piece, two minutes: the octaves of a long song take more memory than the song.
const FRAMES_AT_A_TIME: usize = 4096;

/// Most samples that are band-limited at a time.
pub(crate) const SAMPLES_AT_A_TIME: usize = FRAMES_AT_A_TIME * HOP + 2 * octaves::CONTEXT;

/// Magnitudes of the constant-Q transform of `signal`, `[T, 252]`, for a deviation from concert
/// pitch ([`tuning::estimate`](crate::tuning::estimate)).
pub fn magnitudes(signal: &[f32], tuning: f64) -> FrameMatrix {
    in_pieces(signal, tuning, FRAMES_AT_A_TIME)
}

/// [`magnitudes`] in pieces of `frames` frames. The bits do not depend on `frames`.
fn in_pieces(signal: &[f32], tuning: f64, frames: usize) -> FrameMatrix {
    let filters = wavelets::all(tuning);
    let transform = RealFftPlanner::<f32>::new().plan_fft_forward(FRAME);
    let mut out = FrameMatrix::zeros(num_frames(signal.len()), BINS);
    let pieces = out.as_mut_slice().chunks_mut(frames * BINS);
    for (piece, rows) in pieces.enumerate() {
        let centre = piece * frames * HOP;
        // An even sample, because the octaves contain every second sample.
        let begin = centre.saturating_sub(octaves::CONTEXT) / 2 * 2;
        let end = centre + rows.len() / BINS * HOP + octaves::CONTEXT;
        let mut octaves = Octaves::new(&signal[begin..end.min(signal.len())]);
        for octave in 0..OCTAVES {
            if octave > 0 {
                octaves.descend();
            }
            let first = (OCTAVES - 1 - octave) * BINS_PER_OCTAVE;
            let bins = first..first + BINS_PER_OCTAVE;
            rows.par_chunks_exact_mut(BINS)
                .enumerate()
                .with_min_len(32)
                .for_each_init(
                    || {
                        (
                            transform.make_input_vec(),
                            transform.make_output_vec(),
                            transform.make_scratch_vec(),
                        )
                    },
                    |(frame, spectrum, scratch), (t, row)| {
                        let centre = (centre + t * HOP - begin) / 2;
                        octaves.gather(centre, wavelets::stride(octave), frame);
                        transform
                            .process_with_scratch(frame, spectrum, scratch)
                            .expect("the buffers were made for this transform");
                        for (magnitude, filter) in
                            row[bins.clone()].iter_mut().zip(&filters[bins.clone()])
                        {
                            *magnitude = filter.response(spectrum);
                        }
                    },
                );
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    #[test]
    fn pieces_have_the_bits_of_the_whole() {
        for len in [0, 1, 3 * HOP, 100_001, 220_500] {
            let signal: Vec<f32> = (0..len).map(|n| (n as f32).powf(1.7).sin()).collect();
            let whole = in_pieces(&signal, 0.13, usize::MAX / BINS);
            for frames in [1, 7, 40] {
                assert!(in_pieces(&signal, 0.13, frames) == whole, "{len} {frames}");
            }
        }
    }

    #[test]
    fn a_sine_on_a_bin_gives_half_the_root_of_the_wavelet_length() {
        for bin in [3, 40, 100, 130, 180, 251] {
            let hz = bin_frequency(bin, 0.0);
            let tone: Vec<f32> = (0..4 * 44_100)
                .map(|n| (TAU * hz * f64::from(n) / 44_100.0).sin() as f32)
                .collect();
            let cqt = magnitudes(&tone, 0.0);
            let ratio = 2f64.powf(2.0 / 36.0);
            let length = (ratio + 1.0) / (ratio - 1.0) * 44_100.0 / hz;
            let expected = length.sqrt() / 2.0;
            let found = f64::from(cqt.frame(60)[bin]);
            assert!(
                (found / expected - 1.0).abs() < 0.01,
                "{bin}: {found} {expected}"
            );
        }
    }
}
