//! What a run reports: metrics as JSON lines, the same scalars for TensorBoard, and
//! what loading cost.

mod appended;
mod loader_log;
mod metrics;
mod tensorboard;

pub use loader_log::LoaderLog;
pub use metrics::{Metrics, Record, read_metrics};
pub use tensorboard::EventFile;
