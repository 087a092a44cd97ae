//! Denoising diffusion probabilistic models.

use burn::tensor::Tensor;

use super::config::Ddpm;
use super::noise::NoiseKeys;
use super::path::TimestepPath;
use super::posterior::Posterior;
use super::prediction::{Predict, Prediction};
use super::{OnStep, continue_or_stop};
use crate::{Error, GaussianDiffusion};

/// Samples by DDPM along `path` (Ho et al. 2020, <https://arxiv.org/abs/2006.11239>), with the
/// steering of the predictions. `variance_type` is read from `config`.
///
/// # Shapes
/// - x_T, output: `[batch, channels, time]`
///
/// # Errors
/// The errors of `predict`.
pub fn ddpm(
    diffusion: &GaussianDiffusion,
    predict: &mut Predict<'_, '_>,
    x_T: Tensor<3>,
    path: &TimestepPath,
    config: &Ddpm,
    keys: NoiseKeys<'_>,
    on_step: &mut OnStep<'_>,
) -> Result<Tensor<3>, Error> {
    let mut x = x_T;
    for index in 0..path.num_steps() {
        let (now, next) = (path.timesteps(index), path.prev_timesteps(index));
        let prediction = predict(x, &path.time(index))?;
        let noise = path
            .stays_noisy(index)
            .then(|| keys.noise(index, None, &prediction.x_t));
        let imputation_noise = prediction
            .steered
            .as_ref()
            .filter(|steered| steered.imputation.is_some())
            .map(|_| keys.noise(index, Some("imputation"), &prediction.x_t));
        let noises = [noise, imputation_noise];
        x = ddpm_step(diffusion, &prediction, now, &next, noises, config);
        continue_or_stop(on_step(index + 1, path.num_steps(), &x))?;
    }
    Ok(x)
}

/// One step of DDPM: samples from the posterior `q(x_{t-1} | x_t, x_0)` with the predicted x_0
/// (CC-MotionGen, section 3.2.4; docs/sources.md, section 1.3; Ho et al. 2020,
/// <https://arxiv.org/abs/2006.11239>, equations 6 and 7).
///
/// `variance_type` is read from `config`. A jump over several timesteps is a step of the respaced process (Nichol and Dhariwal 2021,
/// <https://arxiv.org/abs/2102.09672>, equation 19) with the beta `1 - abar / abar'`. A sample
/// whose step ends at the clean motion gets no noise. The source decides by the first sample.
///
/// Timesteps and noise are those of [`super::ddim_step`]. With steering (docs/sources.md, sections
/// 4.6 to 4.8) the gradient shifts the mean:
///
/// ```text
/// mean = coef1 x_0 + coef2 x_t + variance g           g: Steered::scaled_gradient
/// ```
///
/// If the network predicts the clean motion, known values replace entries of x_0, and the resulting
/// entries replace those of the guided mean:
///
/// ```text
/// mean  <- known entries of (coef1 put(x_0) + coef2 x_t), else mean
/// ```
///
/// If the network predicts noise, known values replace entries of the sample. `imputation_noise`
/// first noises the known values to the level of `prev_timesteps`.
///
/// The noises are those of the step and of imputed values.
///
/// # Shapes
/// - both noises, standard normal, output: `[batch, channels, time]`
///
/// # Panics
/// Panics unless each sample has one timestep before and one after the step, all below the
/// process's number of timesteps.
pub fn ddpm_step(
    diffusion: &GaussianDiffusion,
    prediction: &Prediction<'_>,
    timesteps: &[usize],
    prev_timesteps: &[Option<usize>],
    [noise, imputation_noise]: [Option<Tensor<3>>; 2],
    config: &Ddpm,
) -> Tensor<3> {
    // abar, abar'   alpha-bar_t, alpha-bar_{t-1}: before and after the step
    // beta          beta_t of the jump; 1 - beta = alpha_t = abar / abar'
    // coef1, coef2  factors of x_0 and x_t in the posterior mean, mu-tilde_t
    // sigma         square root of the step's variance: beta-tilde_t, or beta
    let posterior = Posterior::of(diffusion, timesteps, prev_timesteps, config.variance_type);

    // 1. mean = beta sqrt(abar') / (1 - abar) x_0 + (1 - abar') sqrt(alpha) / (1 - abar) x_t.
    let (x_start, x_t) = (prediction.x_start.clone(), prediction.x_t.clone());
    let mean = posterior.mean(x_start.clone(), x_t.clone());
    let mean = match &prediction.steered {
        Some(steered) => steered.mean(diffusion, mean, &x_start, x_t, &posterior),
        None => mean,
    };

    // 2. x' = mean + sigma z, with sigma 0 where x' is the clean motion.
    let sample = match noise {
        Some(noise) => mean + posterior.scaled(noise),
        None => mean,
    };
    match &prediction.steered {
        Some(steered) => {
            steered.impute(diffusion, sample, x_start, prev_timesteps, imputation_noise)
        }
        None => sample,
    }
}
