//! Starting and resuming a run: validation before anything is written.

mod folder;
mod plan;
mod setup;
mod start;

pub use folder::has_begun;
pub use folder::{PREVIEWS, SAMPLES, UNFINISHED_SAMPLES, is_in_use, preview_page, remove};
pub use plan::Plan;
pub use setup::{Material, Outcome, Setup};
pub use start::{Target, TrainRequest, load_config, train, train_config, train_together};
