//! Denoising diffusion implicit models.

use burn::tensor::Tensor;

use super::config::Ddim;
use super::noise::NoiseKeys;
use super::path::TimestepPath;
use super::posterior::{Alphas, coefficients};
use super::prediction::{Predict, Prediction};
use super::{OnStep, continue_or_stop};
use crate::per_sample::per_sample;
use crate::{Error, GaussianDiffusion};

/// Samples by DDIM along `path` (Song et al. 2021, <https://arxiv.org/abs/2010.02502>). `eta` and
/// `recompute_epsilon` are read from `config`.
///
/// # Shapes
/// - x_T, output: `[batch, channels, time]`
///
/// # Errors
/// The errors of `predict`.
pub fn ddim(
    diffusion: &GaussianDiffusion,
    predict: &mut Predict<'_, '_>,
    x_T: Tensor<3>,
    path: &TimestepPath,
    config: &Ddim,
    keys: NoiseKeys<'_>,
    on_step: &mut OnStep<'_>,
) -> Result<Tensor<3>, Error> {
    let mut x = x_T;
    for index in 0..path.num_steps() {
        let (now, next) = (path.timesteps(index), path.prev_timesteps(index));
        let prediction = predict(x, &path.time(index))?;
        let noise = (config.eta > 0.0 && path.stays_noisy(index))
            .then(|| keys.noise(index, None, &prediction.x_t));
        x = ddim_step(diffusion, &prediction, now, &next, noise, config);
        continue_or_stop(on_step(index + 1, path.num_steps(), &x))?;
    }
    Ok(x)
}

/// One step of DDIM (CC-MotionGen, sections 5.4 and 8.1; docs/sources.md, section 1.9; Song et al.
/// 2021, <https://arxiv.org/abs/2010.02502>, equations 12 and 16).
///
/// `eta` and `recompute_epsilon` are read from `config`. With `eta` 1 and jumps of one timestep,
/// the step equals [`super::ddpm_step`].
///
/// Each sample goes from its entry in `timesteps` to its entry in `prev_timesteps`, which is the
/// same or lower; `None` is the clean motion. Without noise the step returns the mean.
///
/// # Shapes
/// - noise, standard normal, output: `[batch, channels, time]`
///
/// # Panics
/// Panics unless each sample has one timestep before and one after the step, all below the
/// process's number of timesteps.
pub fn ddim_step(
    diffusion: &GaussianDiffusion,
    prediction: &Prediction<'_>,
    timesteps: &[usize],
    prev_timesteps: &[Option<usize>],
    noise: Option<Tensor<3>>,
    config: &Ddim,
) -> Tensor<3> {
    // abar         alpha-bar_t      where the sample is
    // abar'        alpha-bar_{t-1}  where it goes; the paper's t-1 is the next timestep visited
    // sigma        sigma_t          scale of the noise of this step
    // direction    sqrt(1 - alpha-bar_{t-1} - sigma_t^2), "direction pointing to x_t"
    let of =
        |value: &dyn Fn(Alphas) -> f64| coefficients(diffusion, timesteps, prev_timesteps, value);
    let variance = |alphas: Alphas| config.eta.powi(2) * alphas.posterior_variance();

    // 1. Predicted x_0 and noise.
    let x_start = prediction.x_start.clone();
    let epsilon = prediction.epsilon(diffusion, timesteps, config.recompute_epsilon);

    // 2. sigma^2 = eta^2 (1 - abar') / (1 - abar) (1 - abar / abar'), on the host in f64.
    let sigma = of(&|alphas| variance(alphas).max(0.0).sqrt());
    let signal = of(&|alphas| alphas.abar_prev.sqrt());
    let direction = of(&|alphas| {
        (alphas.one_minus_abar_prev - variance(alphas))
            .max(0.0)
            .sqrt()
    });

    // 3. x' = sqrt(abar') x_0 + direction epsilon + sigma z.
    let signal = per_sample(&signal, &x_start);
    let direction = per_sample(&direction, &epsilon);
    let prev_sample = x_start * signal + epsilon * direction;
    match noise {
        Some(noise) => {
            let sigma = per_sample(&sigma, &noise);
            prev_sample + noise * sigma
        }
        None => prev_sample,
    }
}
