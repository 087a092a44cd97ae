//! Samplers: from noise to motion.
//!
//! Each sampler is a function in its own file that contains its whole loop: it calls a [`Predict`]
//! for the clean motion along a [`Path`] of noise levels. [`sample`] runs the sampler of a config
//! with a network, [`draw`] with any [`Predict`]. The single steps of DDIM and DDPM are public too,
//! with their noise as an argument, for custom loops.

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
mod level;
mod noise;
mod path;
mod prediction;
mod spacing;
mod step;

use std::ops::ControlFlow;

use burn::tensor::Tensor;

pub use clip::ClipRange;
pub use config::{FinalAlpha, SamplerConfig, SamplerKind, TimestepSpacing};
pub use ddim::{ddim, ddim_step};
pub use ddpm::{ddpm, ddpm_step};
pub use dpm_solver::dpmpp_2m;
pub use heun::heun;
pub use noise::{GivenNoise, NoiseKeys, noise_of_parts};
pub use path::Path;
pub use prediction::{Predict, Prediction};
pub use spacing::timesteps;
pub(crate) use step::Posterior;

use kinegrad_settings::{InvalidSetting, Refused, require};

use crate::{Denoiser, DiffusionConfig, Error, GaussianDiffusion, Time, guided};

/// Callback after each step: the number of steps done, starting from 1, the total number of steps,
/// and the new state `[batch, channels, time]`. `Break` ends the sampler with [`Error::Stopped`].
pub type OnStep<'a> = dyn FnMut(usize, usize, &Tensor<3>) -> ControlFlow<()> + 'a;

/// The error of a sampler whose callback asked it to stop.
pub(crate) fn go_on(flow: ControlFlow<()>) -> Result<(), Error> {
    match flow {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Stopped),
    }
}

/// Generates one motion per sample of the start noise (CC-MotionGen, sections 3.2.4, 8.1 and 8.3;
/// docs/sources.md, sections 1.3 and 1.9).
///
/// Run it on a plain device with a network of plain weights (Burn: `Module::valid`): on a device
/// with autodiff every step keeps its graph, and memory grows from call to call.
///
/// `keys` seed the noise of the steps (`ddpm`, and `ddim` with `eta` above 0), which is generated
/// on the host so that it does not depend on the device.
///
/// # Shapes
/// - x_T, the start noise, standard normal: `[batch, channels, time]`
/// - cond: what the denoiser takes, for the same batch
/// - output: `[batch, channels, time]`
///
/// # Errors
/// If the sampler's settings are not valid for this process, the clipping bounds do not fit the
/// channels, or the network's output has other sizes than its input.
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
        Prediction::new(diffusion, model_output, x, &timesteps_of(time), clip)
    };
    draw(diffusion, &mut predict, x_T, config, keys.into(), on_step)
}

/// Runs the sampler that `config` names with `predict`; [`sample`] describes the rest.
///
/// # Shapes
/// - x_T, output: `[batch, channels, time]`
///
/// # Errors
/// If the sampler's settings are not valid for this process, and those of `predict`.
pub fn draw(
    diffusion: &GaussianDiffusion,
    predict: &mut Predict<'_, '_>,
    x_T: Tensor<3>,
    config: &SamplerConfig,
    keys: NoiseKeys<'_>,
    on_step: &mut OnStep<'_>,
) -> Result<Tensor<3>, Error> {
    must_suit(config, &diffusion.config)?;
    let num_train_timesteps = diffusion.schedule.num_train_timesteps();
    let path = Path::of(config, num_train_timesteps, x_T.dims()[0]);
    match config.kind {
        SamplerKind::Ddim => ddim(diffusion, predict, x_T, &path, config, keys, on_step),
        SamplerKind::Ddpm => ddpm(diffusion, predict, x_T, &path, keys, on_step),
        SamplerKind::Dpmpp2m => dpmpp_2m(diffusion, predict, x_T, &path, on_step),
        SamplerKind::Heun => heun(diffusion, predict, x_T, &path, on_step),
        SamplerKind::Euler | SamplerKind::Midpoint | SamplerKind::Dopri5 => {
            unreachable!("refused above: {}", config.kind)
        }
    }
}

/// Rejects a sampler's settings that do not work with a process.
///
/// # Errors
/// Names the first bad key: what it is, what is allowed, how to mend it.
pub fn must_suit(config: &SamplerConfig, process: &DiffusionConfig) -> Result<(), InvalidSetting> {
    let all = process.num_train_timesteps;
    config.validate(all)?;
    require(
        config.kind.is_of_diffusion(),
        "sampling.sampler.kind",
        format!("\"{}\"", config.kind),
        "\"ddim\", \"ddpm\", \"dpmpp_2m\" or \"heun\" for a diffusion process",
    )
    .hint("the others are of flows: recipe `flow`")?;
    require(
        config.tolerance.is_none(),
        "sampling.sampler.tolerance",
        config.tolerance.unwrap_or_default(),
        "nothing for a diffusion process",
    )
    .hint("`dopri5` has one, with recipe `flow`")?;
    let from_noise = || timesteps(config, all).contains(&(all - 1));
    let heun = config.kind == SamplerKind::Heun;
    require(
        !(heun && process.rescale_betas_zero_snr && from_noise()),
        "sampling.sampler.kind",
        "\"heun\"",
        "another sampler where `diffusion.rescale_betas_zero_snr` is set",
    )
    .hint("Heun's method needs some motion in x_t, and the last timestep is pure noise")
}

/// The timesteps that times stand for.
pub(crate) fn timesteps_of(time: &[Time]) -> Vec<usize> {
    time.iter().map(|time| time.timestep()).collect()
}

#[cfg(test)]
mod tests;
