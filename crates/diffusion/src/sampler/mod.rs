//! From noise to motion: the sampling loop.
//!
//! A sampler is a list of timesteps ([`timesteps`]) and a step from each to the next: [`ddim_step`]
//! or [`ddpm_step`]. [`sample`] walks the list; the steps are public, and take their noise as an
//! argument, for whoever writes another loop.

mod clip;
mod config;
mod ddim;
mod ddpm;
mod spacing;
mod step;

use burn::tensor::{Tensor, TensorData};
use kinegrad_random::Key;

pub use clip::Clip;
pub use config::{FinalAlpha, SamplerConfig, SamplerKind, TimestepSpacing};
pub use ddim::ddim_step;
pub use ddpm::ddpm_step;
pub use spacing::timesteps;
pub(crate) use step::Posterior;
pub use step::{StepInput, StepOutput};

use crate::{Denoiser, Error, GaussianDiffusion, guided};

/// Draws one motion per sample of the start noise (CC-MotionGen, sections 3.2.4, 8.1 and 8.3;
/// docs/sources.md, sections 1.3 and 1.9).
///
/// Run it on a plain device with a network of plain weights (Burn: `Module::valid`): on a device
/// with autodiff every step keeps its graph, and memory grows from call to call.
///
/// `key` is what the noise of the steps is drawn from, where there is any (`ddpm`, and `ddim` with
/// `eta` above 0): sample `i` of the batch draws that of step `n` from `key.at(n).at(i)`, on the
/// host, so that it does not depend on the device or on how many samples are drawn at once.
///
/// After each step `on_step` is told the number of steps done, 1 being the first, the number of
/// steps in all, and the state `[batch, channels, time]` that the step led to.
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
    non_snake_case,
    reason = "x_T is the field's symbol for the start noise"
)]
#[expect(
    clippy::too_many_arguments,
    reason = "each is another thing, named at the call"
)]
pub fn sample<D: Denoiser + ?Sized>(
    diffusion: &GaussianDiffusion,
    denoiser: &D,
    x_T: Tensor<3>,
    cond: &D::Cond,
    config: &SamplerConfig,
    clip: &Clip,
    key: Key,
    on_step: &mut dyn FnMut(usize, usize, &Tensor<3>),
) -> Result<Tensor<3>, Error> {
    let num_train_timesteps = diffusion.schedule.num_train_timesteps();
    config.validate(num_train_timesteps)?;
    let [batch, channels, _] = x_T.dims();
    clip.validate(channels)?;

    let kept = timesteps(config, num_train_timesteps);
    let mut x = x_T;
    for (index, &timestep) in kept.iter().enumerate() {
        let prev_timestep = match kept.get(index + 1) {
            Some(&next) => Some(next),
            None => config.last_landing(),
        };
        let now = vec![timestep; batch];
        let model_output = guided(denoiser, x.clone(), &now, cond, config.guidance_scale);
        let input = StepInput {
            model_output,
            noise: draws_noise(config, timestep, prev_timestep)
                .then(|| step_noise(key.at(index as u64), &x)),
            x_t: x,
            timesteps: &now,
            prev_timesteps: &vec![prev_timestep; batch],
        };
        let output = match config.kind {
            SamplerKind::Ddim => ddim_step(diffusion, input, config, clip)?,
            SamplerKind::Ddpm => ddpm_step(diffusion, input, clip)?,
        };
        x = output.prev_sample;
        on_step(index + 1, kept.len(), &x);
    }
    Ok(x)
}

/// Whether the step's noise has a factor above 0: not when it lands on the clean motion, and not
/// when it stays where it is.
pub(crate) fn draws_noise(
    config: &SamplerConfig,
    timestep: usize,
    prev_timestep: Option<usize>,
) -> bool {
    let random = config.kind == SamplerKind::Ddpm || config.eta > 0.0;
    random && prev_timestep.is_some_and(|prev| prev != timestep)
}

/// Standard normal noise like `x`, each sample's from a key of its own.
pub(crate) fn step_noise(key: Key, x: &Tensor<3>) -> Tensor<3> {
    let [batch, channels, time] = x.dims();
    let values: Vec<f32> = (0..batch as u64)
        .flat_map(|sample| key.at(sample).normals(channels * time))
        .collect();
    let data = TensorData::new(values, [batch, channels, time]);
    Tensor::from_data(data, (&x.device(), x.dtype()))
}

#[cfg(test)]
mod tests;
