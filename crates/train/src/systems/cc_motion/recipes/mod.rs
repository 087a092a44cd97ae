//! One file per recipe, with its loss.

pub mod decoder;
pub mod diffusion;
pub mod e2e;
mod rollouts;

use kinegrad_data::AUDIO;
use kinegrad_models::AudioCondition;

use crate::denoising::Inputs;

pub use decoder::DecoderRecipe;
pub(super) use diffusion::denoising_loss;
pub use diffusion::diffusion_recipe;
pub use e2e::{E2eDraws, E2eRecipe, PendingRollout};
pub use rollouts::Rollouts;

/// What the denoiser hears of a batch.
fn heard(inputs: &Inputs) -> AudioCondition {
    AudioCondition {
        features: inputs.cond.get(AUDIO).clone(),
        lengths: inputs.lengths.clone(),
    }
}
