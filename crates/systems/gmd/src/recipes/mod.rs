//! The recipe of both models, and its loss.

mod clips;
mod joint_motion;
pub mod loss;

pub use clips::clip_recipe;
pub use joint_motion::JointMotion;
