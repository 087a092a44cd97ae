//! The trajectory model of Guided Motion Diffusion (appendix A and E): the root's rotation, x, z and
//! height, normalised and not projected, predicting the noise:
//!
//! ```text
//! L = clip_loss(x_start[rot, x, z, y])
//! ```
//!
//! A model of four channels overfits quickly and then responds poorly to guidance, so this recipe
//! uses early stopping on held-out paths (`train.patience`).

use burn::tensor::Device;
use kinegrad_data::Batch;
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_models::TextDenoiser;
use kinegrad_motion::goal::TRAJECTORY_CHANNELS;

use super::loss::clip_loss;
use crate::denoising::{Draws, HeldOut, Inputs};
use crate::recipe::{Loss, Measured, Recipe, StepKey};

/// Trains a [`TextDenoiser`] on the root's way.
pub struct GmdTrajectoryRecipe {
    diffusion: GaussianDiffusion,
    held_out: HeldOut,
}

impl GmdTrajectoryRecipe {
    /// A recipe over `diffusion`, validated on `held_out`.
    pub fn new(diffusion: GaussianDiffusion, held_out: HeldOut) -> Self {
        Self {
            diffusion,
            held_out,
        }
    }

    /// The loss of given draws.
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
        let weights = [1.0; TRAJECTORY_CHANNELS];
        clip_loss(&self.diffusion, model, inputs, draws, &weights, weighted)
    }
}

impl Recipe for GmdTrajectoryRecipe {
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
