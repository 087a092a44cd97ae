//! The recipe of both models and its losses.

mod clips;
mod joint_motion;

pub use clips::clip_recipe;
pub use joint_motion::JointMotion;
