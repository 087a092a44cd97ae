//! The exponential moving average of the weights. The average starts as a copy of the weights, and
//! the optimizer's pass updates it:
//!
//! ```text
//! average += (1 - decay) (parameter - average)
//! ```
//!
//! This form does not drift when `decay` and `1 - decay` are rounded separately.

use crate::config::EmaConfig;

impl EmaConfig {
    /// The decay of optimizer step `step` (from 1), `min(decay, 1 - (1 + n / inv_gamma)^-power)`
    /// for update n; `None` without an update.
    fn decay_at(&self, step: u64) -> Option<f64> {
        if !step.is_multiple_of(self.update_every) {
            return None;
        }
        let update = (step / self.update_every) as f64;
        let warmed = match self.inv_gamma > 0.0 {
            true => 1.0 - (1.0 + update / self.inv_gamma).powf(-self.power),
            false => 1.0,
        };
        Some(self.decay.min(warmed))
    }

    /// `1 - decay` of optimizer step `step` (from 1); `None` without an update.
    pub fn share_at(&self, step: u64) -> Option<f64> {
        self.decay_at(step).map(|decay| 1.0 - decay)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::OptimConfig;
    use crate::optim::{AdamW, Moments};

    fn ema(decay: f64, inv_gamma: f64) -> EmaConfig {
        EmaConfig {
            decay,
            update_every: 1,
            inv_gamma,
            power: 1.0,
        }
    }

    #[test]
    fn decay_zero_copies_and_one_freezes() {
        for (decay, expected) in [(0.0, [5.0, 7.0]), (1.0, [1.0, 2.0])] {
            let mut average = [1.0, 2.0];
            let mut optimizer = AdamW::new(&OptimConfig::default(), 0);
            optimizer.begin_step();
            let share = ema(decay, 0.0).share_at(1).expect("an update");
            let moved = Some((&mut average[..], share));
            let step = optimizer.step(0, 1.0, 0.0);
            Moments::zeros(2).update(step, &mut [5.0, 7.0], &[0.0; 2], moved);
            assert_eq!(average, expected);
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
