//! The motion model of Guided Motion Diffusion (appendix C and E): clips of joint features with an
//! absolute root, normalised, then projected so that the root's three channels weigh as much as all
//! others:
//!
//! ```text
//! x = ((u - mean) / std) P          P from `emphasis`, stored with the weights
//! L = clip_loss(x)                  sample prediction unless `diffusion.prediction_type` is set
//! ```
//!
//! Without a projection, `loss.trajectory_scale` k weighs the first four channels by k^2 instead
//! (appendix C.1; the height among them, as in the published program).

use burn::tensor::Device;
use kinegrad_data::Batch;
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_models::TextDenoiser;
use kinegrad_motion::goal::TRAJECTORY_CHANNELS;

use super::loss::clip_loss;
use crate::denoising::{Draws, HeldOut, Inputs};
use crate::recipe::{Loss, Measured, Recipe, StepKey};

/// Trains a [`TextDenoiser`] on whole motion.
pub struct GmdMotionRecipe {
    diffusion: GaussianDiffusion,
    channel_weights: Vec<f64>,
    held_out: HeldOut,
}

impl GmdMotionRecipe {
    /// A recipe over `diffusion` for clips of `channels`, validated on `held_out`.
    pub fn new(
        diffusion: GaussianDiffusion,
        channels: usize,
        trajectory_scale: f64,
        held_out: HeldOut,
    ) -> Self {
        let mut channel_weights = vec![1.0; channels];
        channel_weights[..TRAJECTORY_CHANNELS].fill(trajectory_scale.powi(2));
        Self {
            diffusion,
            channel_weights,
            held_out,
        }
    }

    /// The loss of given draws, whose noise is that of the network's space.
    pub fn loss_of(&self, model: &TextDenoiser, inputs: Inputs, draws: Draws) -> Loss {
        self.weighted_loss(model, inputs, draws, true)
    }

    fn weighted_loss(
        &self,
        model: &TextDenoiser,
        inputs: Inputs,
        draws: Draws,
        weighted: bool,
    ) -> Loss {
        let x_start = match model.projection() {
            Some(projection) => projection.forward(inputs.x_start),
            None => inputs.x_start,
        };
        let inputs = Inputs { x_start, ..inputs };
        let weights = &self.channel_weights;
        clip_loss(&self.diffusion, model, inputs, draws, weights, weighted)
    }
}

impl Recipe for GmdMotionRecipe {
    type Model = TextDenoiser;
    type Pending = ();

    fn loss(&self, model: &TextDenoiser, batch: &Batch, key: StepKey, device: &Device) -> Loss {
        let inputs = Inputs::new(batch, device);
        let draws = Draws::new(&self.diffusion, inputs.x_start.dims(), key, device);
        self.loss_of(model, inputs, draws)
    }

    fn validation_loss(&self, model: &TextDenoiser, device: &Device) -> Measured {
        let loss = |inputs, draws| self.weighted_loss(model, inputs, draws, false).total;
        Measured {
            total: self.held_out.mean_loss(&self.diffusion, device, loss),
            terms: Vec::new(),
        }
    }
}
