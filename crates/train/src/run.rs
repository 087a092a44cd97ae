//! Starting and resuming a run: validation before anything is written.

mod folder;
mod setup;
mod start;

pub use setup::{Material, Outcome, Setup};
pub use start::{TrainRequest, load_config, train, train_config};
