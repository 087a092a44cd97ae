//! The interface between a training recipe and the trainer.
//!
//! A recipe computes the loss of a batch, independently of files, step counts and device names;
//! the [`crate::Trainer`] does the rest.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use kinegrad_data::Batch;
use kinegrad_models::GradientSum;
use kinegrad_random::{Key, Purpose};

use crate::error::Error;

/// A training recipe of a system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecipeInfo {
    /// Its name, the value of `train.recipe`, unique across systems.
    pub name: &'static str,
    /// The parameter groups it trains, each with its own learning rate (`optim.groups`).
    pub groups: &'static [&'static str],
}

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

/// The loss of one batch. `P` is what the backward pass goes on with where that of `total` ends.
#[derive(Debug)]
pub struct Loss<P = ()> {
    /// What is minimised.
    pub total: Tensor<1>,
    /// The weighted terms it is the sum of, by name.
    pub terms: Vec<(&'static str, Tensor<1>)>,
    /// Tensors on the way, in the order of computation: where a NaN is looked for.
    pub probes: Vec<(&'static str, Tensor<3>)>,
    /// What [`Recipe::backward`] goes on with.
    pub pending: P,
}

/// A loss measured on held-out phrases.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// The whole.
    pub total: f64,
    /// The weighted terms it is the sum of, where there are several.
    pub terms: Vec<(&'static str, f64)>,
}

impl Measured {
    /// Adds to the term `name`, and to the whole.
    pub fn add(&mut self, name: &'static str, value: f64) {
        self.total += value;
        match self.terms.iter_mut().find(|(known, _)| *known == name) {
            Some((_, sum)) => *sum += value,
            None => self.terms.push((name, value)),
        }
    }
}

/// How good the samples of the weights are, by metrics of samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// What the best step is selected by, the less the better; infinite where it cannot be told.
    pub value: f64,
    /// The metrics, by name.
    pub metrics: Vec<(&'static str, f64)>,
}

/// A kind of training.
pub trait Recipe {
    /// The networks that are trained.
    type Model: Module;

    /// What the backward pass goes on with where that of the loss ends; mostly nothing.
    type Pending;

    /// The optimiser group of a parameter, an index into [`RecipeInfo::groups`].
    fn group_of(&self, _parameter: &str) -> usize {
        0
    }

    /// Whether the held-out phrases are measured before the first step too, because training
    /// starts from weights that are worth something.
    fn measures_first(&self) -> bool {
        false
    }

    /// How much `batch` counts among those whose gradients are averaged for one step: as much as
    /// the mean that its loss is has terms, so that one batch or several of its parts are the same.
    /// By default its valid frames.
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

    /// The gradients of a loss; none of frozen parameters.
    fn backward(&self, model: &Self::Model, loss: Loss<Self::Pending>) -> GradientSum {
        let mut sum = GradientSum::default();
        sum.add(model, &mut loss.total.backward());
        sum
    }

    /// The mean loss over held-out phrases, with fixed noise so that runs compare; `model` is on
    /// the plain `device`.
    fn validation_loss(&self, model: &Self::Model, device: &Device) -> Measured;

    /// What the best step is selected by, where that is not the validation loss; `model` as in
    /// [`validation_loss`](Self::validation_loss).
    ///
    /// # Errors
    /// If no samples can be drawn.
    fn score(&self, _model: &Self::Model, _device: &Device) -> Result<Option<Score>, Error> {
        Ok(None)
    }
}
