//! A denoiser on noised motion (CC-MotionGen, sections 5.3 and 6.2; docs/sources.md, section 1.4):
//!
//! ```text
//! L = w(t) E |target - f(x_t, t, cond)|     x_t = sqrt(abar_t) x_start + sqrt(1 - abar_t) noise
//! ```
//!
//! with `t` uniform over the timesteps, the target chosen by `diffusion.prediction_type`, the
//! distance by `diffusion.loss_type`, and the condition replaced by zeros with probability
//! `diffusion.cond_drop_prob`, so that classifier-free guidance has a null condition it knows.

use burn::tensor::{Device, Tensor};
use kinegrad_data::Batch;
use kinegrad_diffusion::{GaussianDiffusion, Time, diffusion_loss};
use kinegrad_models::{DropoutKey, UNet1d};
use kinegrad_random::Purpose;

use super::{HeldOut, Inputs};
use crate::draws::{keep_cond, noise, spread_timesteps};
use crate::recipe::{Loss, Measured, Recipe, StepKey};

/// Trains a [`UNet1d`] to denoise.
pub struct DiffusionRecipe {
    diffusion: GaussianDiffusion,
    held_out: HeldOut,
}

impl DiffusionRecipe {
    /// A recipe over `diffusion`, validated on `held_out`.
    pub fn new(diffusion: GaussianDiffusion, held_out: HeldOut) -> Self {
        Self {
            diffusion,
            held_out,
        }
    }

    /// The loss of given draws.
    pub fn loss_of(&self, model: &UNet1d, inputs: Inputs, draws: DenoisingDraws) -> Loss {
        denoising_loss(&self.diffusion, model, inputs, draws)
    }
}

impl Recipe for DiffusionRecipe {
    type Model = UNet1d;
    type Pending = ();

    fn loss(&self, model: &UNet1d, batch: &Batch, key: StepKey, device: &Device) -> Loss {
        let inputs = Inputs::new(batch, device);
        let draws = DenoisingDraws::new(&self.diffusion, inputs.x_start.dims(), key, device);
        self.loss_of(model, inputs, draws)
    }

    fn validation_loss(&self, model: &UNet1d, device: &Device) -> Measured {
        Measured {
            total: denoising_validation_loss(&self.diffusion, model, &self.held_out, device),
            terms: Vec::new(),
        }
    }
}

/// What is random in the loss of one batch.
#[derive(Clone, Debug)]
pub struct DenoisingDraws {
    /// One timestep a sample.
    pub timesteps: Vec<usize>,
    /// Standard normal: `[batch, channels, time]`.
    pub noise: Tensor<3>,
    /// 0 where the condition is dropped, else 1: `[batch, 1, 1]`. None drops none.
    pub keep_cond: Option<Tensor<3>>,
    /// The network's dropout.
    pub dropout: DropoutKey,
}

impl DenoisingDraws {
    /// The draws of `key` for a batch of this shape.
    pub fn new(
        diffusion: &GaussianDiffusion,
        shape: [usize; 3],
        key: StepKey,
        device: &Device,
    ) -> Self {
        let config = &diffusion.config;
        let batch = shape[0];
        Self {
            timesteps: key
                .of(Purpose::Timesteps)
                .integers(batch, config.num_train_timesteps),
            noise: noise(key.of(Purpose::Noise), shape, device),
            keep_cond: keep_cond(config.cond_drop_prob, batch, key, device),
            dropout: Some(key.of(Purpose::Dropout)),
        }
    }
}

/// The loss above.
pub(super) fn denoising_loss(
    diffusion: &GaussianDiffusion,
    unet: &UNet1d,
    inputs: Inputs,
    draws: DenoisingDraws,
) -> Loss {
    let Inputs {
        x_start,
        cond,
        mask,
    } = inputs;
    let DenoisingDraws {
        timesteps,
        noise,
        keep_cond,
        dropout,
    } = draws;
    let x_t = diffusion.add_noise(x_start.clone(), noise.clone(), &timesteps);
    let cond = match keep_cond {
        Some(keep) => cond * keep,
        None => cond,
    };
    let model_output = unet.forward(x_t.clone(), &Time::of(&timesteps), cond.clone(), dropout);

    let target = diffusion.target(x_start.clone(), noise, &timesteps);
    let weights = diffusion.loss_weights(&timesteps);
    let total = diffusion_loss(
        model_output.clone(),
        target,
        Some(mask),
        Some(&weights),
        diffusion.config.loss_type,
    );
    Loss {
        terms: vec![("diffusion", total.clone())],
        probes: vec![
            ("x_start", x_start),
            ("cond", cond),
            ("x_t", x_t),
            ("model_output", model_output),
        ],
        total,
        pending: (),
    }
}

/// The same loss without dropout on held-out phrases, at [`spread_timesteps`].
pub(super) fn denoising_validation_loss(
    diffusion: &GaussianDiffusion,
    unet: &UNet1d,
    held_out: &HeldOut,
    device: &Device,
) -> f64 {
    let (phrases, draws) = (held_out.phrases.len(), held_out.draws);
    let num_train_timesteps = diffusion.config.num_train_timesteps;
    let mut sum = 0.0;
    for draw in 0..draws {
        for (range, inputs) in held_out.batches(device) {
            let Inputs {
                x_start,
                cond,
                mask,
            } = inputs;
            let timesteps =
                spread_timesteps(range.clone(), draw, draws, phrases, num_train_timesteps);
            let noise = held_out.noise(range.clone(), draw as u64, &x_start);
            let x_t = diffusion.add_noise(x_start.clone(), noise.clone(), &timesteps);
            let model_output = unet.forward(x_t, &Time::of(&timesteps), cond, None);
            let target = diffusion.target(x_start, noise, &timesteps);
            let loss_type = diffusion.config.loss_type;
            let loss = diffusion_loss(model_output, target, Some(mask), None, loss_type);
            sum += f64::from(loss.into_scalar::<f32>()) * range.len() as f64;
        }
    }
    sum / (draws * phrases) as f64
}
