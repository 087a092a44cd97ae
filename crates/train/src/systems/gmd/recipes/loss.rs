//! The loss of both models.

use burn::tensor::{Tensor, TensorData};
use kinegrad_data::TEXT;
use kinegrad_diffusion::loss::elementwise;
use kinegrad_diffusion::{GaussianDiffusion, LossType};
use kinegrad_models::TextDenoiser;

use crate::denoising::{Draws, Inputs, denoising_loss};
use crate::recipe::Loss;

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
    draws: Draws,
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

/// The loss above of an output.
///
/// # Shapes
/// - model_output, target: `[batch, channels, time]`
/// - mask: `[batch, time]`; a sample without a real frame counts as 0
/// - weights: one per sample
pub fn weighted_masked_loss(
    model_output: Tensor<3>,
    target: Tensor<3>,
    mask: Tensor<2>,
    channel_weights: &[f64],
    velocity: f64,
    weights: Option<&[f64]>,
    loss_type: LossType,
) -> Tensor<1> {
    let [batch, channels, time] = model_output.dims();
    assert_eq!(channel_weights.len(), channels, "one weight a channel");
    let sum: f64 = channel_weights.iter().sum();
    let shares: Vec<f32> = channel_weights.iter().map(|w| (w / sum) as f32).collect();
    let device = model_output.device();
    let shares: Tensor<3> = Tensor::from_data(TensorData::new(shares, [1, channels, 1]), &device);
    let mut distances = elementwise(model_output.clone(), target.clone(), loss_type);
    if velocity > 0.0 && time > 1 {
        let error = model_output - target;
        let [later, earlier] = [1, 0].map(|first| error.clone().narrow(2, first, time - 1));
        let change = (later - earlier).powi_scalar(2) * velocity;
        // The first frame follows none. Of two real frames the second is real.
        let first = Tensor::zeros([batch, channels, 1], &device);
        distances = distances + Tensor::cat(vec![first, change], 2);
    }
    let distances = distances * shares;
    // In a fixed order, whatever the number of threads: channels, frames, then the batch.
    let frames = distances.sum_dim(1).reshape([batch, time]) * mask.clone();
    let real = mask.sum_dim(1).clamp_min(1.0);
    let samples = frames.sum_dim(1) / real;
    let samples = match weights {
        Some(weights) => {
            let weights: Vec<f32> = weights.iter().map(|&w| w as f32).collect();
            samples * Tensor::<2>::from_data(TensorData::new(weights, [batch, 1]), &device)
        }
        None => samples,
    };
    samples.sum() / batch as f64
}
