//! Evaluation of position control and of text-motion alignment.

mod goals;
mod replications;
mod run;
mod task;
mod variety;

pub use goals::{GoalEvaluation, GoalSettings, Models, evaluate_goals};
pub use replications::Replicated;
pub(super) use run::prepare;
pub use task::{GoalTask, KeyframePlacement};
pub use variety::VarietyReport;
