//! Losses on decoded motion, in physical units: meters, seconds and radians.
//!
//! Motion is `[batch, 25, time]`, the mask `[batch, time]` with 1 in real frames and 0 in padding.
//! Means are over real frames. Sums run over time, then channels, then the batch, so that a
//! repeated step gives the same bits.

pub mod reconstruction;
pub mod temporal;

use burn::tensor::Tensor;

pub use reconstruction::{ReconstructionLoss, SignMatching};
pub use temporal::{PhaseLoss, TemporalLossConfig, temporal_losses};

/// Sums of `values [batch, channels, time]` over the `mask [batch, 1, time]`: `[batch, 1, 1]`.
fn sum_frames(values: Tensor<3>, mask: &Tensor<3>) -> Tensor<3> {
    (values * mask.clone()).sum_dim(2).sum_dim(1)
}

/// Mean of `values [batch, channels, time]` over channels and `mask [batch, 1, time]`; 0 if empty.
fn mean_frames(values: Tensor<3>, mask: &Tensor<3>) -> Tensor<1> {
    let channels = values.dims()[1] as f64;
    let frames = mask.clone().sum_dim(2).sum_dim(0);
    let mean = sum_frames(values, mask).sum_dim(0) / (frames * channels).clamp_min(1.0);
    mean.reshape([1])
}
