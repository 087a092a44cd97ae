//! The moving average of the weights.

use rayon::prelude::*;

use crate::config::EmaConfig;

/// Elements that one thread handles at a time.
const CHUNK: usize = 1 << 14;

/// An exponential moving average over named parameters, kept on the host; it starts as a copy.
#[derive(Clone, Debug)]
pub struct Ema {
    config: EmaConfig,
    shadow: Vec<Vec<f32>>,
}

impl Ema {
    /// An average whose current values are `shadow`: the first weights, or saved ones.
    pub fn new(config: &EmaConfig, shadow: Vec<Vec<f32>>) -> Self {
        Self {
            config: config.clone(),
            shadow,
        }
    }

    /// The averaged weights, in the parameters' order.
    pub fn shadow(&self) -> &[Vec<f32>] {
        &self.shadow
    }

    /// The share that the update at optimiser step `step` (from 1) keeps, or `None` when that
    /// step has no update.
    ///
    /// Update n keeps `min(decay, 1 - (1 + n / inv_gamma)^-power)`.
    pub fn decay_at(&self, step: u64) -> Option<f64> {
        let EmaConfig {
            decay,
            update_every,
            inv_gamma,
            power,
        } = self.config;
        if !step.is_multiple_of(update_every) {
            return None;
        }
        let update = (step / update_every) as f64;
        let warmed = if inv_gamma > 0.0 {
            1.0 - (1.0 + update / inv_gamma).powf(-power)
        } else {
            1.0
        };
        Some(decay.min(warmed))
    }

    /// Moves the average of parameter `index` towards its value: `shadow += (1 - decay) (parameter
    /// - shadow)`, the form that does not drift when `decay` and `1 - decay` are rounded apart.
    ///
    /// # Panics
    /// Panics if the lengths differ.
    pub fn update(&mut self, index: usize, parameter: &[f32], decay: f64) {
        let shadow = &mut self.shadow[index];
        assert_eq!(
            shadow.len(),
            parameter.len(),
            "average of parameter {index}"
        );
        let rate = (1.0 - decay) as f32;
        shadow
            .par_chunks_mut(CHUNK)
            .zip(parameter.par_chunks(CHUNK))
            .for_each(|(shadow, parameter)| {
                for (s, p) in shadow.iter_mut().zip(parameter) {
                    *s += rate * (p - *s);
                }
            });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ema(decay: f64, inv_gamma: f64) -> Ema {
        let config = EmaConfig {
            decay,
            update_every: 1,
            inv_gamma,
            power: 1.0,
        };
        Ema::new(&config, vec![vec![1.0, 2.0]])
    }

    #[test]
    fn decay_zero_copies_and_one_freezes() {
        for (decay, expected) in [(0.0, [5.0, 7.0]), (1.0, [1.0, 2.0])] {
            let mut ema = ema(decay, 0.0);
            ema.update(0, &[5.0, 7.0], ema.decay_at(1).expect("an update"));
            assert_eq!(ema.shadow()[0], expected);
        }
    }

    #[test]
    fn the_warm_up_is_the_inverse_gamma_one() {
        let ema = ema(0.999, 9.0);
        for n in 0..5u64 {
            let expected = (1.0 + n as f64) / (10.0 + n as f64);
            assert!((ema.decay_at(n + 1).expect("an update") - expected).abs() < 1e-12);
        }
        assert_eq!(ema.decay_at(1_000_000), Some(0.999));
    }
}
