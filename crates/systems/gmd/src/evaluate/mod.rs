//! Evaluation of position control and of text-motion alignment.

mod goals;
mod run;
mod task;
mod variety;

pub(super) use run::prepare;
pub use task::KeyframePlacement;

use task::GoalTask;
use variety::VarietyReport;
