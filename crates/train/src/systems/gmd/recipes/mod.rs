//! One file per recipe, with its loss.

pub mod loss;
pub mod motion;
pub mod trajectory;

pub use motion::GmdMotionRecipe;
pub use trajectory::GmdTrajectoryRecipe;
