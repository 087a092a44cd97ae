//! The DDIM step.

use crate::per_sample::per_sample;
use crate::{Error, GaussianDiffusion, PredictionType};

use super::{Clip, SamplerConfig, StepInput, StepOutput};

/// One step of denoising diffusion implicit models (CC-MotionGen, sections 5.4 and 8.1;
/// docs/sources.md, section 1.9; Song et al. 2021, <https://arxiv.org/abs/2010.02502>, equations 12
/// and 16).
///
/// `eta` and `recompute_epsilon` are read from `config`. With `eta` 1 and jumps of one timestep it
/// is [`super::ddpm_step`].
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
pub fn ddim_step(
    diffusion: &GaussianDiffusion,
    input: StepInput<'_>,
    config: &SamplerConfig,
    clip: &Clip,
) -> Result<StepOutput, Error> {
    // abar         alpha-bar_t      where the sample is
    // abar'        alpha-bar_{t-1}  where it goes; the paper's t-1 is the next timestep visited
    // sigma        sigma_t          noise drawn in this step
    // direction    sqrt(1 - alpha-bar_{t-1} - sigma_t^2), "direction pointing to x_t"
    input.check()?;
    let variance = |alphas: super::step::Alphas| config.eta.powi(2) * alphas.posterior_variance();

    // 1. Predicted x_0, clipped.
    let x_start = input.pred_original_sample(diffusion, clip)?;

    // 2. Predicted noise: the network's, or the one that leads from the clipped x_0 to x_t.
    let epsilon = if config.recompute_epsilon && *clip != Clip::None {
        let (from, to) = (PredictionType::Sample, PredictionType::Epsilon);
        diffusion.convert(
            x_start.clone(),
            input.x_t.clone(),
            input.timesteps,
            from,
            to,
        )
    } else {
        diffusion.pred_epsilon(
            input.model_output.clone(),
            input.x_t.clone(),
            input.timesteps,
        )
    };

    // 3. sigma^2 = eta^2 (1 - abar') / (1 - abar) (1 - abar / abar'), on the host in f64.
    let sigma = input.coefficients(diffusion, |alphas| variance(alphas).max(0.0).sqrt());
    let signal = input.coefficients(diffusion, |alphas| alphas.abar_prev.sqrt());
    let direction = input.coefficients(diffusion, |alphas| {
        (alphas.one_minus_abar_prev - variance(alphas))
            .max(0.0)
            .sqrt()
    });

    // 4. x' = sqrt(abar') x_0 + direction epsilon + sigma z.
    let mut prev_sample = x_start.clone() * per_sample(&signal, &x_start)
        + epsilon.clone() * per_sample(&direction, &epsilon);
    if let Some(noise) = input.noise {
        let sigma = per_sample(&sigma, &noise);
        prev_sample = prev_sample + noise * sigma;
    }
    Ok(StepOutput {
        prev_sample,
        pred_original_sample: x_start,
    })
}
