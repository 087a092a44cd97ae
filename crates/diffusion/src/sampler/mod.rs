//! Samplers: from noise to motion.
//!
//! Each sampler is a loop in its own file that calls a [`Predict`] along a [`TimestepPath`].
//! [`sample`] runs a config's sampler with a network, [`sample_with`] runs it with any [`Predict`].
//! The steps of DDIM and DDPM are public for custom loops.

#![expect(
    non_snake_case,
    reason = "x_T is the field's symbol for the start noise"
)]

mod clip;
mod config;
mod ddim;
mod ddpm;
mod dpm_solver;
mod heun;
mod imputation;
mod level;
mod noise;
mod path;
mod posterior;
mod prediction;
mod spacing;
mod steered;
mod table;

use std::ops::ControlFlow;

use burn::tensor::Tensor;

pub use clip::ClipRange;
pub use config::{
    Ddim, Ddpm, Dopri5, FinalAlpha, SamplerConfig, SamplerKind, TimestepSpacing, Timesteps,
    VarianceType, must_suit, must_suit_flow,
};
pub use ddim::{ddim, ddim_step};
pub use ddpm::{ddpm, ddpm_step};
pub use dpm_solver::dpmpp_2m;
pub use heun::heun;
pub use imputation::{Imputation, Space};
pub use noise::{FixedNoise, NoiseKeys, noise_of_parts};
pub use path::TimestepPath;
pub use prediction::{Predict, Prediction};
pub use spacing::timesteps;
pub use steered::Steered;

use crate::{Denoiser, Error, GaussianDiffusion, Time, guided};

/// Callback after each step: the number of steps done, starting from 1, the total number of steps,
/// and the new state `[batch, channels, time]`. `Break` ends the sampler with [`Error::Stopped`].
pub type OnStep<'a> = dyn FnMut(usize, usize, &Tensor<3>) -> ControlFlow<()> + 'a;

/// [`Error::Stopped`] if a callback returned `Break`.
pub(crate) fn continue_or_stop(flow: ControlFlow<()>) -> Result<(), Error> {
    match flow {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Stopped),
    }
}

/// Generates one motion per sample of the start noise (CC-MotionGen, sections 3.2.4, 8.1 and 8.3;
/// docs/sources.md, sections 1.3 and 1.9).
///
/// The device and the network's weights must be plain (Burn: `Module::valid`). On an autodiff
/// device every step stores its graph, and memory grows with every call.
///
/// `keys` seed the noise of the steps (`ddpm`, and `ddim` with `eta` above 0). The noise is
/// generated on the host, so it does not depend on the device.
///
/// # Shapes
/// - x_T, the start noise, standard normal: `[batch, channels, time]`
/// - cond: the denoiser's condition for the batch
/// - output: `[batch, channels, time]`
///
/// # Errors
/// Fails if the sampler's settings are not valid for this process, the clipping bounds do not fit
/// the channels, or the sizes of the network's output and input differ.
#[expect(
    clippy::too_many_arguments,
    reason = "each is another thing, named at the call"
)]
pub fn sample<'k, D: Denoiser + ?Sized>(
    diffusion: &GaussianDiffusion,
    denoiser: &D,
    x_T: Tensor<3>,
    cond: &D::Cond,
    config: &SamplerConfig,
    clip: &ClipRange,
    keys: impl Into<NoiseKeys<'k>>,
    on_step: &mut OnStep<'_>,
) -> Result<Tensor<3>, Error> {
    clip.validate(x_T.dims()[1])?;
    let mut predict = |x: Tensor<3>, time: &[Time]| {
        let scales = config.guidance(time[0].timestep());
        let model_output = guided(denoiser, x.clone(), time, cond, scales);
        Prediction::new(diffusion, model_output, x, &Time::timesteps(time), clip)
    };
    sample_with(diffusion, &mut predict, x_T, config, keys.into(), on_step)
}

/// Runs the sampler of `config` with `predict`, as [`sample`] does.
///
/// # Shapes
/// - x_T, output: `[batch, channels, time]`
///
/// # Errors
/// The errors of `predict`, and an error for settings that are not valid for this process.
pub fn sample_with(
    diffusion: &GaussianDiffusion,
    predict: &mut Predict<'_, '_>,
    x_T: Tensor<3>,
    config: &SamplerConfig,
    keys: NoiseKeys<'_>,
    on_step: &mut OnStep<'_>,
) -> Result<Tensor<3>, Error> {
    must_suit(config, &diffusion.config)?;
    let num_train_timesteps = diffusion.schedule.num_train_timesteps();
    let path = TimestepPath::of(config, num_train_timesteps, x_T.dims()[0]);
    match &config.kind {
        SamplerKind::Ddim(ddim) => self::ddim(diffusion, predict, x_T, &path, ddim, keys, on_step),
        SamplerKind::Ddpm(ddpm) => self::ddpm(diffusion, predict, x_T, &path, ddpm, keys, on_step),
        SamplerKind::Dpmpp2m(_) => dpmpp_2m(diffusion, predict, x_T, &path, on_step),
        SamplerKind::Heun(_) => heun(diffusion, predict, x_T, &path, on_step),
        kind => unreachable!("refused above: {kind}"),
    }
}

#[cfg(test)]
mod tests;
