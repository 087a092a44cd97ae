//! Telemetry of a run: metrics as JSON lines and TensorBoard events, loading statistics, and the
//! environment.

mod appended;
mod environment;
mod loader_log;
mod metrics;
mod tensorboard;

pub(crate) use environment::FILE as ENVIRONMENT;
pub use environment::{BURN, Environment, read_environments};
pub(crate) use loader_log::LoaderLog;
pub(crate) use metrics::Metrics;
pub use metrics::{Record, read_metrics};
use tensorboard::EventFile;
