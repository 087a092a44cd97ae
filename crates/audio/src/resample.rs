//! Conversion to [`SAMPLE_RATE`].

use std::collections::TryReserveError;

use rubato::audioadapter_buffers::direct::InterleavedSlice;
use rubato::{Fft, FixedSync, Resampler, WindowFunction};

use crate::SAMPLE_RATE;

/// Fewest samples of a block at the lower rate. The filter then passes about 0.91 of the lower
/// Nyquist frequency and stops all frequencies above Nyquist, as soxr's "HQ" does.
const BLOCK: usize = 288;

/// Resamples pieces of a signal to [`SAMPLE_RATE`], with linear phase and without delay. The buffer
/// contains less than a block.
pub(crate) struct Resampling {
    rate: u32,
    /// `None` if the signal has the target rate already.
    resampler: Option<Fft<f32>>,
    /// Samples that do not yet fill a block.
    pending: Vec<f32>,
    /// Remaining samples of the filter's delay.
    delay: usize,
    received: u64,
    resampled: Vec<f32>,
}

impl Resampling {
    /// Resamples from `rate` samples per second.
    ///
    /// # Panics
    /// Panics if `rate` is zero.
    pub fn new(rate: u32) -> Self {
        let resampler = (rate != SAMPLE_RATE).then(|| resampler(rate));
        Self {
            rate,
            delay: resampler.as_ref().map_or(0, Resampler::output_delay),
            resampler,
            pending: Vec::new(),
            received: 0,
            resampled: Vec::new(),
        }
    }

    /// Samples received so far.
    pub fn received(&self) -> u64 {
        self.received
    }

    /// Reserves memory for the result of `more` samples.
    ///
    /// # Errors
    /// If memory is full.
    pub fn reserve(&mut self, more: usize) -> Result<(), TryReserveError> {
        let block = self
            .resampler
            .as_ref()
            .map_or(0, Resampler::output_frames_next);
        let received = self.received + more as u64;
        let needed = received * u64::from(SAMPLE_RATE) / u64::from(self.rate) + block as u64;
        let missing = (needed as usize).saturating_sub(self.resampled.len());
        if missing <= self.resampled.capacity() - self.resampled.len() {
            return Ok(());
        }
        // The buffer grows by a quarter, because doubling would need most of the memory of a song.
        let step = missing.max(self.resampled.len() / 4);
        self.resampled.try_reserve_exact(step)
    }

    /// Takes the next piece.
    pub fn push(&mut self, samples: &[f32]) {
        self.received += samples.len() as u64;
        let Some(resampler) = &self.resampler else {
            self.resampled.extend_from_slice(samples);
            return;
        };
        let block = resampler.input_frames_next();
        self.pending.extend_from_slice(samples);
        let whole = self.pending.len() - self.pending.len() % block;
        let rest = self.pending.split_off(whole);
        let blocks = std::mem::replace(&mut self.pending, rest);
        for block in blocks.chunks_exact(block) {
            self.resample(block);
        }
    }

    /// Resamples one block.
    fn resample(&mut self, block: &[f32]) {
        let input = InterleavedSlice::new(block, 1, block.len()).expect("one channel");
        let resampler = self
            .resampler
            .as_mut()
            .expect("only where the rates differ");
        let output = resampler.process(&input, None);
        let output = output.expect("the block has the right size").take_data();
        let late = self.delay.min(output.len());
        self.delay -= late;
        self.resampled.extend_from_slice(&output[late..]);
    }

    /// The resampled signal: `ceil(received * 44100 / rate)` samples.
    pub fn finish(mut self) -> Vec<f32> {
        let length = self.received * u64::from(SAMPLE_RATE);
        let length = length.div_ceil(u64::from(self.rate)) as usize;
        if let Some(resampler) = &self.resampler {
            let block = resampler.input_frames_next();
            let mut last = std::mem::take(&mut self.pending);
            while !last.is_empty() || self.resampled.len() < length {
                last.resize(block, 0.0);
                self.resample(&last);
                last.clear();
            }
        }
        self.resampled.resize(length, 0.0);
        self.resampled.shrink_to_fit();
        self.resampled
    }
}

fn resampler(rate: u32) -> Fft<f32> {
    let divisor = greatest_common_divisor(rate, SAMPLE_RATE);
    let lower = (rate.min(SAMPLE_RATE) / divisor) as usize;
    // An even number, so that the filter's delay, half a block, is a whole number of samples.
    let blocks = BLOCK.div_ceil(lower).next_multiple_of(2);
    let block = blocks * (rate / divisor) as usize;
    Fft::new_custom(
        rate as usize,
        SAMPLE_RATE as usize,
        block,
        1,
        1,
        WindowFunction::BlackmanHarris2,
        FixedSync::Both,
    )
    .expect("both rates and the block are positive")
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

    fn to_sample_rate(samples: Vec<f32>, rate: u32) -> Vec<f32> {
        let mut resampling = Resampling::new(rate);
        resampling.push(&samples);
        resampling.finish()
    }

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
    fn frequencies_above_the_new_limit_are_removed() {
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

    #[test]
    fn pieces_make_the_same_signal_and_are_not_kept() {
        let signal = sine(440.0, 96_000, 10_007);
        let whole = to_sample_rate(signal.clone(), 96_000);
        let mut resampling = Resampling::new(96_000);
        for piece in signal.chunks(113) {
            resampling.push(piece);
            assert!(resampling.pending.len() < 2 * 640);
        }
        assert_eq!(resampling.received(), 10_007);
        assert_eq!(resampling.finish(), whole);
    }
}
