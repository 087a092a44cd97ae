//! Root mean square of the samples around each frame.

use rayon::prelude::*;

use crate::stft::{N_FFT, copy_centred};
use crate::{HOP, num_frames};

/// `sqrt(mean(y^2))` over the [`N_FFT`] samples around each frame, zeros outside the signal and
/// no window: `[T]`.
pub fn root_mean_square(signal: &[f32]) -> Vec<f32> {
    (0..num_frames(signal.len()))
        .into_par_iter()
        .with_min_len(64)
        .map_init(
            || vec![0.0f32; N_FFT],
            |frame, t| {
                copy_centred(signal, t * HOP, frame);
                let sum: f64 = frame.iter().map(|&y| f64::from(y) * f64::from(y)).sum();
                (sum / N_FFT as f64).sqrt() as f32
            },
        )
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_keeps_its_level_and_halves_its_power_at_the_border() {
        let rms = root_mean_square(&[0.5; 5 * HOP]);
        assert_eq!(rms.len(), 6);
        assert!((rms[0] - 0.5 * 0.5f32.sqrt()).abs() < 1e-6);
        assert_eq!(rms[2], 0.5);
        assert_eq!(root_mean_square(&[]), vec![0.0]);
    }
}
