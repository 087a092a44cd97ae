//! Starting and resuming runs: validation before files are written.

mod context;
mod folder;
mod plan;
mod start;

pub use context::{Outcome, RunContext, TrainingData};
pub use folder::{
    PREVIEWS, REPORTS, SAMPLES, UNFINISHED_SAMPLES, contains_run, is_in_use, must_be_inside,
    preview_page, remove,
};
pub use plan::Plan;
pub use start::{
    Target, TrainRequest, load_config, saved_config, train, train_config, train_distributed,
};
