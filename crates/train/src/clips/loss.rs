//! The squared error of clips of several lengths.

use burn::tensor::{Tensor, TensorData};
use kinegrad_diffusion::loss::elementwise;
use kinegrad_diffusion::{GaussianDiffusion, LossType, Time};
use kinegrad_models::DropoutKey;

use crate::denoising::{Conditions, Inputs, RandomInputs, denoising_loss};
use crate::recipe::Loss;

/// Weights of the channels of a distance.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelWeights(Vec<f64>);

impl ChannelWeights {
    /// The weighted mean over channels: weights that add up to 1.
    pub fn mean(weights: &[f64]) -> Self {
        let sum: f64 = weights.iter().sum();
        Self(weights.iter().map(|weight| weight / sum).collect())
    }

    /// The weighted sum over channels.
    pub fn sum(weights: &[f64]) -> Self {
        Self(weights.to_vec())
    }
}

/// The mean over a batch of the error of a network's output:
///
/// ```text
/// weights  sum over real frames and channels  w_c |target - output| / real frames
/// ```
///
/// `loss_type` selects the distance. The loss adds `velocity` times the squared error of the
/// differences between consecutive frames.
///
/// # Shapes
/// - model_output, target: `[batch, channels, time]`
/// - mask: `[batch, time]`; a sample without a real frame counts as 0
/// - weights: one per sample
pub fn weighted_masked_loss(
    model_output: Tensor<3>,
    target: Tensor<3>,
    mask: Tensor<2>,
    channel_weights: &ChannelWeights,
    velocity: f64,
    weights: Option<&[f64]>,
    loss_type: LossType,
) -> Tensor<1> {
    let [batch, channels, time] = model_output.dims();
    let ChannelWeights(shares) = channel_weights;
    assert_eq!(shares.len(), channels, "one weight a channel");
    let shares: Vec<f32> = shares.iter().map(|share| *share as f32).collect();
    let device = model_output.device();
    let shares: Tensor<3> = Tensor::from_data(TensorData::new(shares, [1, channels, 1]), &device);
    let mut distances = elementwise(model_output.clone(), target.clone(), loss_type);
    if velocity > 0.0 && time > 1 {
        let error = model_output - target;
        let [later, earlier] = [1, 0].map(|first| error.clone().narrow(2, first, time - 1));
        let change = (later - earlier).powi_scalar(2) * velocity;
        // The first frame has no predecessor.
        let first = Tensor::zeros([batch, channels, 1], &device);
        distances = distances + Tensor::cat(vec![first, change], 2);
    }
    let distances = distances * shares;
    // The order is fixed for any number of threads: channels, frames, then the batch.
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

/// The [`denoising_loss`] of a batch of clips, with the distance of [`weighted_masked_loss`]. If
/// `weighted` is true, `diffusion.snr_gamma` weights the samples.
pub fn clip_loss(
    diffusion: &GaussianDiffusion,
    inputs: Inputs,
    draws: RandomInputs,
    channel_weights: &ChannelWeights,
    velocity: f64,
    weighted: bool,
    network: impl FnOnce(Tensor<3>, &[Time], &Conditions, DropoutKey) -> Tensor<3>,
) -> Loss {
    let kind = diffusion.config.loss_type;
    let weighted = weighted && diffusion.config.snr_gamma.is_some();
    let weights = weighted.then(|| diffusion.loss_weights(&draws.timesteps));
    denoising_loss(diffusion, inputs, draws, network, |output, target, mask| {
        let (each, weights) = (channel_weights, weights.as_deref());
        weighted_masked_loss(output, target, mask, each, velocity, weights, kind)
    })
}
