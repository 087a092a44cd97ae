//! The recipe of both models, and its loss.

mod clips;
pub mod loss;

pub use clips::clip_recipe;
