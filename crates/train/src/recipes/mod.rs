//! One file per kind of training: its loss, from top to bottom.
//!
//! A recipe turns a batch into a loss and knows nothing of files, steps or devices' names; the
//! [`crate::Trainer`] does the rest.

pub mod diffusion;

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use kinegrad_data::Batch;
use kinegrad_random::{Key, Purpose};

pub use diffusion::DiffusionRecipe;

/// Which draws a training step uses.
#[derive(Clone, Copy, Debug)]
pub struct StepKey {
    /// Seed of the run.
    pub seed: u64,
    /// Optimiser step, from 0.
    pub step: u64,
    /// Micro-batch within the step, from 0.
    pub micro_batch: u64,
}

impl StepKey {
    /// The stream of `purpose` in this micro-batch.
    pub fn of(self, purpose: Purpose) -> Key {
        Key::new(self.seed, purpose)
            .at(self.step)
            .at(self.micro_batch)
    }
}

/// The loss of one batch.
#[derive(Debug)]
pub struct Loss {
    /// What is minimised.
    pub total: Tensor<1>,
    /// The weighted terms it is the sum of, by name.
    pub terms: Vec<(&'static str, Tensor<1>)>,
    /// Tensors on the way, in the order of computation: where a NaN is looked for.
    pub probes: Vec<(&'static str, Tensor<3>)>,
}

/// A kind of training.
pub trait Recipe {
    /// The networks that are trained.
    type Model: Module;

    /// Name of the optimiser group, as in the metric `lr_<group>`.
    fn group(&self) -> &'static str;

    /// The loss of a training batch.
    fn loss(&self, model: &Self::Model, batch: &Batch, key: StepKey, device: &Device) -> Loss;

    /// The mean loss over held-out phrases, with fixed noise so that runs compare; `model` is on
    /// the plain `device`.
    fn validation_loss(&self, model: &Self::Model, device: &Device) -> f64;
}
