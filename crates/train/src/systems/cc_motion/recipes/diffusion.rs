//! Training of the denoiser (CC-MotionGen, sections 5.3 and 6.2; docs/sources.md, section 1.4):
//!
//! ```text
//! L = w(t) E |target - f(x_t, t, cond)|     x_t = sqrt(abar_t) x_start + sqrt(1 - abar_t) noise
//! ```
//!
//! with `t` uniform over the timesteps, the target chosen by `diffusion.prediction_type`, the
//! distance by `diffusion.loss_type`, and the condition replaced by zeros with probability
//! `diffusion.cond_drop_prob`, which trains the null condition of classifier-free guidance.

use burn::tensor::Device;
use kinegrad_data::{AUDIO, Batch};
use kinegrad_diffusion::{GaussianDiffusion, diffusion_loss};
use kinegrad_models::UNet1d;

use crate::denoising::{Draws, HeldOut, Inputs};
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
    pub fn loss_of(&self, model: &UNet1d, inputs: Inputs, draws: Draws) -> Loss {
        denoising_loss(&self.diffusion, model, inputs, draws, true)
    }
}

impl Recipe for DiffusionRecipe {
    type Model = UNet1d;
    type Pending = ();

    fn loss(&self, model: &UNet1d, batch: &Batch, key: StepKey, device: &Device) -> Loss {
        let inputs = Inputs::new(batch, device);
        let draws = Draws::new(&self.diffusion, inputs.x_start.dims(), key, device);
        self.loss_of(model, inputs, draws)
    }

    fn validation_loss(&self, model: &UNet1d, device: &Device) -> Measured {
        Measured {
            total: denoising_validation_loss(&self.diffusion, model, &self.held_out, device),
            terms: Vec::new(),
        }
    }
}

/// The loss above, with the weights w(t) where it is `weighted`.
pub(super) fn denoising_loss(
    diffusion: &GaussianDiffusion,
    unet: &UNet1d,
    inputs: Inputs,
    draws: Draws,
    weighted: bool,
) -> Loss {
    let weights = weighted.then(|| diffusion.loss_weights(&draws.timesteps));
    crate::denoising::denoising_loss(
        diffusion,
        inputs,
        draws,
        |x_t, time, cond, dropout| unet.forward(x_t, time, cond.get(AUDIO).clone(), dropout),
        |model_output, target, mask| {
            let loss_type = diffusion.config.loss_type;
            diffusion_loss(
                model_output,
                target,
                Some(mask),
                weights.as_deref(),
                loss_type,
            )
        },
    )
}

/// The same loss, not weighted, on held-out phrases.
pub(super) fn denoising_validation_loss(
    diffusion: &GaussianDiffusion,
    unet: &UNet1d,
    held_out: &HeldOut,
    device: &Device,
) -> f64 {
    held_out.mean_loss(diffusion, device, |inputs, draws| {
        denoising_loss(diffusion, unet, inputs, draws, false).total
    })
}
