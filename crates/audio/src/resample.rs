//! Conversion to [`SAMPLE_RATE`].

use rubato::audioadapter_buffers::direct::InterleavedSlice;
use rubato::{Fft, FixedSync, Resampler, WindowFunction};

use crate::SAMPLE_RATE;

/// Samples of a block at the lower of both rates, at least: the filter then passes about 0.91 of
/// the lower Nyquist frequency and stops everything above it, as soxr's "HQ" does.
const BLOCK: usize = 288;

/// The signal at [`SAMPLE_RATE`], linear phase, without delay:
/// `ceil(samples.len() * 44100 / rate)` samples.
///
/// # Panics
/// Panics if `rate` is zero.
pub fn to_sample_rate(samples: Vec<f32>, rate: u32) -> Vec<f32> {
    if rate == SAMPLE_RATE || samples.is_empty() {
        return samples;
    }
    let divisor = greatest_common_divisor(rate, SAMPLE_RATE);
    let lower = (rate.min(SAMPLE_RATE) / divisor) as usize;
    // An even number of blocks: the filter's delay is half a block, a whole number of samples.
    let blocks = BLOCK.div_ceil(lower).next_multiple_of(2);
    let block = blocks * (rate / divisor) as usize;
    let mut resampler = Fft::<f32>::new_custom(
        rate as usize,
        SAMPLE_RATE as usize,
        block,
        1,
        1,
        WindowFunction::BlackmanHarris2,
        FixedSync::Both,
    )
    .expect("both rates and the block are positive");
    let input = InterleavedSlice::new(&samples, 1, samples.len()).expect("one channel");
    let resampled = resampler
        .process_all(&input, samples.len(), None)
        .expect("the buffers have the sizes asked for");
    let mut resampled = resampled.take_data();
    let length = samples.len() as u64 * u64::from(SAMPLE_RATE);
    resampled.resize(length.div_ceil(u64::from(rate)) as usize, 0.0);
    resampled
}

fn greatest_common_divisor(a: u32, b: u32) -> u32 {
    if b == 0 {
        a
    } else {
        greatest_common_divisor(b, a % b)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    fn sine(hz: f64, rate: u32, samples: usize) -> Vec<f32> {
        (0..samples)
            .map(|n| (TAU * hz * n as f64 / f64::from(rate)).sin() as f32)
            .collect()
    }

    #[test]
    fn a_sine_keeps_its_phase_and_level() {
        for rate in [8000, 11_025, 22_050, 32_000, 44_101, 48_000, 96_000] {
            let hz = 1000.0;
            let found = to_sample_rate(sine(hz, rate, rate as usize), rate);
            assert_eq!(found.len(), 44_100, "{rate}");
            let expected = sine(hz, SAMPLE_RATE, 44_100);
            let middle = 10_000..34_000;
            for (a, b) in found[middle.clone()].iter().zip(&expected[middle]) {
                assert!((a - b).abs() < 1e-4, "{rate}: {a} {b}");
            }
        }
    }

    #[test]
    fn what_lies_above_the_new_limit_is_gone() {
        let found = to_sample_rate(sine(23_500.0, 96_000, 96_000), 96_000);
        assert!(found[10_000..34_000].iter().all(|y| y.abs() < 2e-6));
    }

    #[test]
    fn lengths_are_rounded_up() {
        assert_eq!(to_sample_rate(vec![0.0; 1], 48_000).len(), 1);
        assert_eq!(to_sample_rate(vec![0.0; 0], 48_000).len(), 0);
        assert_eq!(to_sample_rate(vec![0.0; 481], 48_000).len(), 442);
        assert_eq!(to_sample_rate(vec![0.0; 7], 44_100).len(), 7);
    }
}
