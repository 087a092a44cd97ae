//! The interface between a training recipe and the trainer.
//!
//! A recipe computes the loss of a batch; the trainer does the rest.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use kinegrad_data::Batch;
use kinegrad_models::GradientSum;
use kinegrad_random::{Key, Purpose};

use crate::error::Error;

/// A training recipe of a system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecipeInfo {
    /// Name of the recipe, the value of `train.recipe`, unique across systems.
    pub name: &'static str,
    /// Parameter groups, each with its own learning rate (`optim.groups`).
    pub groups: &'static [&'static str],
}

/// The random inputs of a training step.
#[derive(Clone, Copy, Debug)]
pub struct StepKey {
    /// Seed of the run.
    pub seed: u64,
    /// Optimizer step, from 0.
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

/// The loss of one batch. `P` is the state with which the backward pass continues.
#[derive(Debug)]
pub struct Loss<P = ()> {
    /// The minimized loss.
    pub total: Tensor<1>,
    /// The weighted terms of the sum, by name.
    pub terms: Vec<(&'static str, Tensor<1>)>,
    /// Intermediate tensors in the order of computation, to locate a NaN.
    pub probes: Vec<(&'static str, Tensor<3>)>,
    /// The state with which [`Recipe::backward`] continues.
    pub pending: P,
}

/// A loss measured on held-out phrases.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// The total loss.
    pub total: f64,
    /// The weighted terms of the sum, if several.
    pub terms: Vec<(&'static str, f64)>,
}

impl Measured {
    /// Adds to the term `name` and to the total.
    pub fn add(&mut self, name: &'static str, value: f64) {
        self.total += value;
        match self.terms.iter_mut().find(|(known, _)| *known == name) {
            Some((_, sum)) => *sum += value,
            None => self.terms.push((name, value)),
        }
    }
}

/// The sample quality of the weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// The criterion of the best step, lower is better; infinite if undefined.
    pub value: f64,
    /// The metrics, by name.
    pub metrics: Vec<(&'static str, f64)>,
}

/// A kind of training.
pub trait Recipe {
    /// The networks that are trained.
    type Model: Module;

    /// The state for continuing the backward pass beyond the loss; usually `()`.
    type Pending;

    /// The optimizer group of a parameter, an index into [`RecipeInfo::groups`].
    fn group_of(&self, _parameter: &str) -> usize {
        0
    }

    /// True to validate before the first step too, because training starts from trained weights.
    fn measures_first(&self) -> bool {
        false
    }

    /// The weight of `batch` in the gradient average of a step, by default the number of valid
    /// frames.
    fn weight(&self, batch: &Batch) -> f64 {
        batch.mask.iter().map(|&valid| f64::from(valid)).sum()
    }

    /// The loss of a training batch.
    fn loss(
        &self,
        model: &Self::Model,
        batch: &Batch,
        key: StepKey,
        device: &Device,
    ) -> Loss<Self::Pending>;

    /// The gradients of a loss, without frozen parameters.
    fn backward(&self, model: &Self::Model, loss: Loss<Self::Pending>) -> GradientSum {
        let mut sum = GradientSum::default();
        sum.add(model, &mut loss.total.backward());
        sum
    }

    /// The mean loss over held-out items, with fixed noise; `model` is on the plain `device`.
    fn validation_loss(&self, model: &Self::Model, device: &Device) -> Measured;

    /// The criterion of the best step, if other than the validation loss.
    ///
    /// # Errors
    /// If sampling fails.
    fn score(&self, _model: &Self::Model, _device: &Device) -> Result<Option<Score>, Error> {
        Ok(None)
    }

    /// A warning about trained weights, after the last validation. Collective.
    ///
    /// # Errors
    /// If sampling fails.
    fn warning(&self, _model: &Self::Model, _device: &Device) -> Result<Option<String>, Error> {
        Ok(None)
    }
}
