//! One file per kind of training: its loss, from top to bottom.

pub mod loss;
pub mod motion;
pub mod trajectory;

pub use motion::GmdMotionRecipe;
pub use trajectory::GmdTrajectoryRecipe;
