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
//!
//! Where the network tracks the beats of the music itself (`model.beats`), the squared error of what
//! it finds is added, over the frames of which the beats are told; its tracker has no other loss.

use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::{GaussianDiffusion, diffusion_loss};
use kinegrad_models::{BEAT_CHANNELS, UNet1d};

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

/// The loss above. Where it is `weighted`, with the weights w(t), and with that of the tracker.
pub(in super::super) fn denoising_loss(
    diffusion: &GaussianDiffusion,
    unet: &UNet1d,
    inputs: Inputs,
    draws: Draws,
    weighted: bool,
) -> Loss {
    let lengths = inputs.lengths.clone();
    let weights = weighted.then(|| diffusion.loss_weights(&draws.timesteps));
    let tracking = weighted.then(|| tracking_loss(unet, &inputs)).flatten();
    let mut loss = crate::denoising::denoising_loss(
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
    );
    if let Some(tracking) = tracking {
        loss.total = loss.total + tracking.clone();
        loss.terms.push(("beats", tracking));
    }
    loss
}

/// The mean squared error of the beats that the network tracks, over the frames of which they are
/// told; none for a network that does not.
fn tracking_loss(unet: &UNet1d, inputs: &Inputs) -> Option<Tensor<1>> {
    let cond = condition(&inputs.cond, inputs.lengths.clone());
    let found = unet.track_beats(&cond)?;
    let [batch, tracked, time] = found.dims();
    let first = cond.features.dims()[1] - BEAT_CHANNELS;
    let told = cond.features.narrow(1, first, tracked);
    // Sine and cosine of one angle, unless they are masked, replaced by noise or unknown.
    let norm = told.clone().square().sum_dim(1).sqrt();
    let is_told = (norm.clone() - 1.0).abs().lower_elem(0.5).float();
    let mask = is_told * inputs.mask.clone().reshape([batch, 1, time]);
    let error = (found - told / norm.clamp_min(0.5)).square() * mask.clone();
    let sum = |x: Tensor<3>| x.sum_dim(2).sum_dim(1).sum_dim(0).reshape([1]);
    Some(sum(error) / (sum(mask) * tracked as f64).clamp_min(1.0))
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
