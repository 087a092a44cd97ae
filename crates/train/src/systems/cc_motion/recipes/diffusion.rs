//! Training of the denoiser (CC-MotionGen, sections 5.3 and 6.2; docs/sources.md, section 1.4):
//!
//! ```text
//! L = w(t) E |target - f(x_t, t, cond)|     x_t = sqrt(abar_t) x_start + sqrt(1 - abar_t) noise
//! ```
//!
//! with `t` uniform over the timesteps, the target chosen by `diffusion.prediction_type`, the
//! distance by `diffusion.loss_type`, and the condition replaced by zeros with probability
//! `diffusion.cond_drop_prob`, which trains the null condition of classifier-free guidance, and the
//! style, of a network with one, with probability `diffusion.style_drop_prob`.

use burn::tensor::Device;
use kinegrad_diffusion::{GaussianDiffusion, diffusion_loss};
use kinegrad_models::UNet1d;

use crate::denoising::{DenoisingRecipe, Draws, HeldOut, Inputs};
use crate::recipe::Loss;
use crate::systems::cc_motion::style::condition;

/// Trains a [`UNet1d`] to denoise, over `diffusion`, validated on `held_out`.
pub fn diffusion_recipe(
    diffusion: GaussianDiffusion,
    held_out: HeldOut,
) -> DenoisingRecipe<UNet1d> {
    DenoisingRecipe::new(diffusion, held_out, denoising_loss)
}

/// The loss above, with the weights w(t) where it is `weighted`.
pub(in super::super) fn denoising_loss(
    diffusion: &GaussianDiffusion,
    unet: &UNet1d,
    inputs: Inputs,
    draws: Draws,
    weighted: bool,
) -> Loss {
    let lengths = inputs.lengths.clone();
    let weights = weighted.then(|| diffusion.loss_weights(&draws.timesteps));
    crate::denoising::denoising_loss(
        diffusion,
        inputs,
        draws,
        |x_t, time, cond, dropout| unet.forward(x_t, time, condition(cond, lengths), dropout),
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
