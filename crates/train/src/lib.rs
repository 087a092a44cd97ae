//! Configs, systems, the training loop, checkpoints and telemetry.
//!
//! [`run::train`] validates a request, sets up the run and passes it to its [system](systems).
//! [`Trainer`] then loads a batch, computes the loss of the [recipe](Recipe), clips gradients,
//! updates the weights ([`optim`], [`ema`]) and records ([`checkpoint`], [`telemetry`]).
//!
//! Generating motion from a trained run:
//!
//! ```no_run
//! use std::ops::ControlFlow;
//! use std::path::Path;
//!
//! use kinegrad_train::Error;
//! use kinegrad_train::checkpoint::{Weights, resolve_checkpoint};
//! use kinegrad_train::systems::BUILT_IN;
//! use kinegrad_train::systems::cc_motion::generate::Generator;
//!
//! fn main() -> Result<(), Error> {
//!     let saved = resolve_checkpoint(Path::new("runs/phrases"), |damaged| eprintln!("{damaged}"))?;
//!     let trained = BUILT_IN.trained(saved, &[], Weights::Ema, Some("cpu"))?;
//!     let generator = Generator::load(&trained)?;
//!
//!     let layout = generator.config().data.audio_layout();
//!     let audio = kinegrad_data::load_audio(Path::new("features.npz"), layout)?;
//!     let mut sampling = generator.config().sampling.clone();
//!     sampling.sampler.num_inference_steps = 50;
//!     let samples = generator.sample(&[audio], &sampling, 0, &mut |_, _| ControlFlow::Continue(()))?;
//!     println!("{} frames", samples[0].motion.frames());
//!     Ok(())
//! }
//! ```

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
pub mod published;
mod recipe;
pub mod run;
pub mod sampling;
pub mod song;
pub mod start;
pub mod system;
pub mod systems;
pub mod telemetry;
pub mod text_encoder;
mod together;
mod trained_model;
mod trainer;

pub use config::Config;
pub use error::Error;
pub use observer::{Observer, Preview, Reading, RunSummary, StepReport};
pub use parameter_count::ParameterCount;
pub use recipe::{Loss, Measured, Recipe, StepKey};
pub use together::Together;
pub use trained_model::TrainedModel;
pub use trainer::{Ending, Trainer, TrainerParts};
