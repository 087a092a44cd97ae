//! Configs, systems, the training loop, checkpoints and telemetry.
//!
//! [`run::train`] validates a request, sets up the run and passes it to its [`System`].
//! The trainer then loads a batch, computes the loss of the [recipe](Recipe), clips gradients,
//! updates the weights ([`optim`], [`ema`]) and records ([`checkpoint`], [`telemetry`]).

pub mod checkpoint;
pub mod clips;
pub mod config;
pub mod denoising;
pub mod device;
pub mod ema;
mod error;
pub mod evaluation;
pub mod import;
pub mod memory;
mod observer;
pub mod optim;
mod parameter_count;
mod process_group;
pub mod published;
mod recipe;
pub mod run;
pub mod sampling;
pub mod song;
pub mod start;
pub mod system;
pub mod telemetry;
pub mod text_encoder;
mod trained_model;
mod trainer;

pub use config::Config;
pub use error::Error;
pub use observer::{Observer, Preview, Reading, RunSummary, StepReport};
pub use parameter_count::{ParameterCount, is_adapter};
pub use process_group::ProcessGroup;
pub use recipe::{Loss, Measured, Recipe, RecipeInfo, Score, StepKey};
pub use system::{System, Systems};
pub use trained_model::TrainedModel;
pub use trainer::Ending;
