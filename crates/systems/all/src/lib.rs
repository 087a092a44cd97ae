//! The list of systems: one crate per generative method, each in a folder beside this one.
//!
//! A [`System`](kinegrad_train::System) defines its name, its recipes, its config tables, and how
//! to validate, train, sample, evaluate and import weights. No other crate refers to a system by
//! name: entry points take a list of [`Systems`] and find the system of a run by its recipe.
//!
//! Generating motion from a trained run:
//!
//! ```no_run
//! use std::ops::ControlFlow;
//! use std::path::Path;
//!
//! use kinegrad_train::Error;
//! use kinegrad_train::checkpoint::{Weights, resolve_checkpoint};
//! use kinegrad_systems::BUILT_IN;
//! use kinegrad_cc_motion::generate::Generator;
//!
//! fn main() -> Result<(), Error> {
//!     let saved = resolve_checkpoint(Path::new("runs/phrases"), |damaged| eprintln!("{damaged}"))?;
//!     let trained = BUILT_IN.trained(saved, &[], Weights::Ema, Some("cpu"), 0)?;
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

use kinegrad_train::Systems;

/// The systems of kinegrad.
pub const BUILT_IN: Systems<'static> = Systems(&[
    &kinegrad_cc_motion::CcMotion,
    &kinegrad_gmd::Gmd,
    &kinegrad_flow::Flow,
    &kinegrad_bpe_transformer::BpeTransformer,
    &kinegrad_text_motion::TextMotionSystem,
]);

// The README's Rust is compiled as a doctest.
#[cfg(doctest)]
#[doc = include_str!("../../../../README.md")]
struct Readme;

#[cfg(test)]
mod tests;
