//! Evaluation of position control and of text-motion alignment.

mod goals;
mod run;
mod task;
mod text_motion;

pub(super) use goals::embedding;
pub use goals::{GoalEvaluation, GoalSettings, evaluate_goals};
pub(super) use run::prepare;
pub use task::{GoalTask, KeyframePlacement};
pub use text_motion::{TextMotion, TextMotionReports};
