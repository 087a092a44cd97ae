//! Training: the config, the recipes, the trainer's loop, checkpoints and telemetry.
//!
//! One training step, down one path: [`run::train`] checks and sets up; [`Trainer`] takes a batch,
//! asks the recipe ([`recipes`]) for its loss, clips, updates ([`optim`], [`ema`]) and records
//! ([`checkpoint`], [`telemetry`]). [`generate`] goes from a checkpoint to motion, [`evaluate`]
//! measures that motion.

pub mod checkpoint;
pub mod clips;
pub mod config;
pub mod device;
pub mod ema;
mod error;
pub mod evaluate;
pub mod generate;
pub mod losses;
pub mod merge;
mod observer;
pub mod optim;
pub mod recipes;
pub mod run;
mod start;
pub mod telemetry;
pub mod trained;
mod trainer;

pub use config::Config;
pub use error::Error;
pub use observer::{Observer, RunSummary, StepReport};
pub use trainer::{Ending, Trainer, TrainerParts};
