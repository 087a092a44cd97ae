//! How well models reach goals, and how their motion matches its captions.

mod goals;
mod text_motion;

pub use goals::{GoalEvaluation, GoalSettings, GoalTask, evaluate_goals};
pub use text_motion::{EvaluatorFiles, TextMotion, TextMotionReports};
