//! The coefficients of a sampling step.

use burn::tensor::Tensor;

use super::config::VarianceType;
use crate::GaussianDiffusion;
use crate::per_sample::per_sample;

/// One value per sample from its [`Alphas`].
pub(super) fn coefficients(
    diffusion: &GaussianDiffusion,
    timesteps: &[usize],
    prev_timesteps: &[Option<usize>],
    coefficient: impl Fn(Alphas) -> f64,
) -> Vec<f64> {
    let schedule = &diffusion.schedule;
    let pairs = timesteps.iter().zip(prev_timesteps);
    pairs
        .map(|(&t, &prev)| {
            let (abar, one_minus_abar) = schedule.abar_at(Some(t));
            let (abar_prev, one_minus_abar_prev) = schedule.abar_at(prev);
            coefficient(Alphas {
                abar,
                one_minus_abar,
                abar_prev,
                one_minus_abar_prev,
            })
        })
        .collect()
}

/// `q(x' | x_t, x_0)` of a jump, with one value per sample and a variance of choice.
#[derive(Clone, Debug)]
pub(crate) struct Posterior {
    /// Factor of x_0 in the mean.
    pub coef1: Vec<f64>,
    /// Factor of x_t in the mean.
    pub coef2: Vec<f64>,
    /// 0 for a jump to the clean motion.
    pub variance: Vec<f64>,
}

impl Posterior {
    /// The posteriors of the samples' jumps, with variances of `variance_type`.
    pub fn of(
        diffusion: &GaussianDiffusion,
        timesteps: &[usize],
        prev_timesteps: &[Option<usize>],
        variance_type: VarianceType,
    ) -> Self {
        let of = |value: &dyn Fn(Alphas) -> f64| {
            coefficients(diffusion, timesteps, prev_timesteps, value)
        };
        Self {
            coef1: of(&|a| a.beta() * a.abar_prev.sqrt() / a.one_minus_abar),
            coef2: of(&|a| {
                let alpha = a.abar / a.abar_prev;
                a.one_minus_abar_prev * alpha.sqrt() / a.one_minus_abar
            }),
            variance: of(&|a| a.variance(variance_type).max(0.0)),
        }
    }

    /// `coef1 x_0 + coef2 x_t`.
    pub fn mean(&self, x_start: Tensor<3>, x_t: Tensor<3>) -> Tensor<3> {
        let coef1 = per_sample(&self.coef1, &x_start);
        let coef2 = per_sample(&self.coef2, &x_t);
        x_start * coef1 + x_t * coef2
    }

    /// Standard normal noise times the standard deviation.
    pub fn scaled(&self, noise: Tensor<3>) -> Tensor<3> {
        let sigma: Vec<f64> = self.variance.iter().map(|v| v.sqrt()).collect();
        let sigma = per_sample(&sigma, &noise);
        noise * sigma
    }
}

/// The cumulative products before and after a step.
#[derive(Clone, Copy)]
pub(crate) struct Alphas {
    pub abar: f64,
    pub one_minus_abar: f64,
    pub abar_prev: f64,
    pub one_minus_abar_prev: f64,
}

impl Alphas {
    /// The beta of the jump, `1 - abar / abar'`.
    pub fn beta(self) -> f64 {
        1.0 - self.abar / self.abar_prev
    }

    /// The posterior variance of the jump, `beta (1 - abar') / (1 - abar)`.
    pub fn posterior_variance(self) -> f64 {
        self.beta() * self.one_minus_abar_prev / self.one_minus_abar
    }

    /// The variance of a step of DDPM; 0 for a jump to the clean motion.
    fn variance(self, variance_type: VarianceType) -> f64 {
        match variance_type {
            VarianceType::FixedSmall => self.posterior_variance(),
            VarianceType::FixedLarge if self.one_minus_abar_prev > 0.0 => self.beta(),
            VarianceType::FixedLarge => 0.0,
        }
    }
}
