//! What a run reports: metrics as JSON lines, and the same scalars for TensorBoard.

mod metrics;
mod tensorboard;

pub use metrics::{Metrics, Record, read_metrics};
pub use tensorboard::EventFile;
