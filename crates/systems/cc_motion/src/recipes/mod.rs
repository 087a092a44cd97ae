//! One file per recipe, with its loss.

pub mod decoder;
pub mod diffusion;
pub mod e2e;
mod rollouts;

pub use decoder::DecoderRecipe;
pub(super) use diffusion::denoising_loss;
pub use diffusion::diffusion_recipe;
pub use e2e::{E2eRandomInputs, E2eRecipe, PendingRollout};
pub use rollouts::Rollouts;
