//! The loss of both models.

use crate::network::TextDenoiser;
use kinegrad_data::TEXT;
use kinegrad_diffusion::GaussianDiffusion;

use kinegrad_train::Loss;
use kinegrad_train::clips::weighted_masked_loss;
use kinegrad_train::denoising::{Inputs, RandomInputs, denoising_loss};

/// The loss of one batch, `x_start` standing in the network's space:
///
/// ```text
/// L = mean over the batch of  w(t) sum over real frames and channels  w_c |target - f(x_t, t, text)|
///                                  / real frames                      with the w_c adding up to 1
/// ```
///
/// with the distance of `diffusion.loss_type` and the weights w(t) of `diffusion.snr_gamma`, where
/// it is `weighted`. Source: GMD's published program, which has squares and no w(t)
/// (docs/sources.md, section 4.10). To the sum of a frame comes `loss.velocity` times the squared
/// error of its difference from the frame before it.
pub fn clip_loss(
    diffusion: &GaussianDiffusion,
    model: &TextDenoiser,
    inputs: Inputs,
    draws: RandomInputs,
    channel_weights: &[f64],
    velocity: f64,
    weighted: bool,
) -> Loss {
    let weights = (weighted && diffusion.config.snr_gamma.is_some())
        .then(|| diffusion.loss_weights(&draws.timesteps));
    denoising_loss(
        diffusion,
        inputs,
        draws,
        |x_t, time, cond, dropout| {
            model.forward_training(x_t, time, cond.get(TEXT).clone(), dropout)
        },
        |model_output, target, mask| {
            let loss_type = diffusion.config.loss_type;
            weighted_masked_loss(
                model_output,
                target,
                mask,
                channel_weights,
                velocity,
                weights.as_deref(),
                loss_type,
            )
        },
    )
}
