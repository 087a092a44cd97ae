//! The DDPM step.

use crate::{Error, GaussianDiffusion};

use super::{Clip, StepInput, StepOutput};

/// One step of denoising diffusion probabilistic models: a draw from the posterior
/// `q(x_{t-1} | x_t, x_0)` with the predicted x_0 (CC-MotionGen, section 3.2.4; docs/sources.md,
/// section 1.3; Ho et al. 2020, <https://arxiv.org/abs/2006.11239>, equations 6 and 7).
///
/// A jump over several timesteps is a step of the respaced process (Nichol and Dhariwal 2021,
/// <https://arxiv.org/abs/2102.09672>, equation 19): its beta is `1 - abar / abar'`, from the kept
/// cumulative products. A sample that goes to the clean motion gets no noise. The source decides
/// that by the first sample of the batch; here every sample decides for itself.
///
/// # Shapes
/// - on the fields of [`StepInput`] and [`StepOutput`]
///
/// # Errors
/// If the clipping bounds do not fit the channels, or the sizes of the network's output and input
/// differ.
///
/// # Panics
/// Panics if there is not one timestep before and after for each sample, or if one is not below
/// the process's number of timesteps.
pub fn ddpm_step(
    diffusion: &GaussianDiffusion,
    input: StepInput<'_>,
    clip: &Clip,
) -> Result<StepOutput, Error> {
    // abar, abar'   alpha-bar_t, alpha-bar_{t-1}: where the sample is and where it goes
    // beta          beta_t of the jump; 1 - beta = alpha_t = abar / abar'
    // coef1, coef2  factors of x_0 and x_t in the posterior mean, mu-tilde_t
    // sigma         square root of the posterior variance, beta-tilde_t
    input.check()?;

    // 1. Predicted x_0, clipped.
    let x_start = input.pred_original_sample(diffusion, clip)?;

    // 2. mean = beta sqrt(abar') / (1 - abar) x_0 + (1 - abar') sqrt(alpha) / (1 - abar) x_t.
    let posterior = input.posterior(diffusion);
    let mut prev_sample = posterior.mean(x_start.clone(), input.x_t.clone());

    // 3. x' = mean + sigma z, with sigma 0 where x' is the clean motion.
    if let Some(noise) = input.noise {
        prev_sample = prev_sample + posterior.scaled(noise);
    }
    Ok(StepOutput {
        prev_sample,
        pred_original_sample: x_start,
    })
}
