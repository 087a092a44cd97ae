//! Training: the config, the systems, the trainer's loop, checkpoints and telemetry.
//!
//! One training step, down one path: [`run::train`] checks and sets up and hands the run to its
//! [system](systems); [`Trainer`] takes a batch, asks the [recipe](Recipe) for its loss, clips,
//! updates ([`optim`], [`ema`]) and records ([`checkpoint`], [`telemetry`]).

pub mod checkpoint;
pub mod config;
pub mod denoising;
pub mod device;
pub mod ema;
mod error;
pub mod evaluation;
pub mod import;
mod observer;
pub mod optim;
pub mod published;
mod recipe;
pub mod run;
pub mod sampling;
pub mod start;
pub mod systems;
pub mod telemetry;
mod trainer;

pub use config::Config;
pub use error::Error;
pub use observer::{Observer, RunSummary, StepReport};
pub use recipe::{Loss, Measured, Recipe, StepKey};
pub use trainer::{Ending, Trainer, TrainerParts};
