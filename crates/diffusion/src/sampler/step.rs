//! What a step takes and gives.

use burn::tensor::Tensor;

use super::Clip;
use crate::{Error, GaussianDiffusion};

/// The input of [`super::ddim_step`] and [`super::ddpm_step`].
#[derive(Clone, Debug)]
pub struct StepInput<'a> {
    /// The network's (guided) answer to `x_t`: `[batch, channels, time]`.
    pub model_output: Tensor<3>,
    /// The noisy motion: `[batch, channels, time]`.
    pub x_t: Tensor<3>,
    /// Standard normal noise `[batch, channels, time]`. None stands for zeros: right where the
    /// step draws no noise, and the mean of the step elsewhere.
    pub noise: Option<Tensor<3>>,
    /// Where each sample is.
    pub timesteps: &'a [usize],
    /// Where each sample goes: a timestep not above its own, or `None` for the clean motion.
    pub prev_timesteps: &'a [Option<usize>],
}

/// The output of [`super::ddim_step`] and [`super::ddpm_step`].
#[derive(Clone, Debug)]
pub struct StepOutput {
    /// The less noisy motion: `[batch, channels, time]`.
    pub prev_sample: Tensor<3>,
    /// The clean motion predicted on the way, clipped: `[batch, channels, time]`.
    pub pred_original_sample: Tensor<3>,
}

impl StepInput<'_> {
    /// Refuses a network's output of other sizes than its input.
    ///
    /// # Panics
    /// Panics if there is not one timestep before and after for each sample.
    pub(super) fn check(&self) -> Result<(), Error> {
        let (found, expected) = (self.model_output.dims(), self.x_t.dims());
        if found != expected {
            return Err(Error::ModelOutput {
                found: found.into(),
                expected: expected.into(),
            });
        }
        assert_eq!(self.timesteps.len(), expected[0], "one timestep per sample");
        assert_eq!(
            self.prev_timesteps.len(),
            expected[0],
            "one landing per sample"
        );
        Ok(())
    }

    /// The predicted clean motion, clipped.
    pub(super) fn pred_original_sample(
        &self,
        diffusion: &GaussianDiffusion,
        clip: &Clip,
    ) -> Result<Tensor<3>, Error> {
        let (model_output, x_t) = (self.model_output.clone(), self.x_t.clone());
        clip.apply(diffusion.pred_original_sample(model_output, x_t, self.timesteps))
    }

    /// One value per sample, from `(abar, 1 - abar, abar', 1 - abar')`, unprimed where it is and
    /// primed where it goes.
    pub(super) fn coefficients(
        &self,
        diffusion: &GaussianDiffusion,
        coefficient: impl Fn(Alphas) -> f64,
    ) -> Vec<f64> {
        let schedule = &diffusion.schedule;
        let pairs = self.timesteps.iter().zip(self.prev_timesteps);
        pairs
            .map(|(&t, &prev)| {
                let (abar, one_minus_abar) = schedule.landing(Some(t));
                let (abar_prev, one_minus_abar_prev) = schedule.landing(prev);
                coefficient(Alphas {
                    abar,
                    one_minus_abar,
                    abar_prev,
                    one_minus_abar_prev,
                })
            })
            .collect()
    }
}

/// The cumulative products at both ends of a step.
#[derive(Clone, Copy)]
pub(super) struct Alphas {
    pub abar: f64,
    pub one_minus_abar: f64,
    pub abar_prev: f64,
    pub one_minus_abar_prev: f64,
}

impl Alphas {
    /// The beta of the whole jump, `1 - abar / abar'`: that of timestep t for a jump of one.
    pub fn beta(self) -> f64 {
        1.0 - self.abar / self.abar_prev
    }

    /// The variance of the posterior of the whole jump: `beta (1 - abar') / (1 - abar)`.
    pub fn posterior_variance(self) -> f64 {
        self.beta() * self.one_minus_abar_prev / self.one_minus_abar
    }
}
