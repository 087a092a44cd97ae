//! The moving average of the weights.

use crate::config::EmaConfig;

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

    /// The average of parameter `index` and the share of the distance to its value that it moves:
    /// `shadow += (1 - decay) (parameter - shadow)`, the form that does not drift when `decay` and
    /// `1 - decay` are rounded apart. The optimiser's pass moves it.
    pub fn average(&mut self, index: usize, decay: f64) -> (&mut [f32], f64) {
        (&mut self.shadow[index], 1.0 - decay)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::OptimConfig;
    use crate::optim::AdamW;

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
            let decay = ema.decay_at(1).expect("an update");
            let mut optimizer = AdamW::new(&OptimConfig::default(), [2]);
            optimizer.begin_step();
            let average = Some(ema.average(0, decay));
            optimizer.update(0, &mut [5.0, 7.0], &[0.0; 2], 1.0, 0.0, average);
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
