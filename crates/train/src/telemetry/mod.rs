//! Telemetry of a run: metrics as JSON lines and TensorBoard events, and loading statistics.

mod appended;
mod loader_log;
mod metrics;
mod tensorboard;

pub use loader_log::LoaderLog;
pub use metrics::{Metrics, Record, read_metrics};
pub use tensorboard::EventFile;
