//! The gradient of a step, averaged over the micro-batches of all ranks.

use std::ops::Range;

use burn::tensor::Tensor;
use kinegrad_data::Batch;
use kinegrad_ranks::split;

use super::Trainer;
use super::gradients::StepGradients;
use super::not_finite::find_not_finite;
use crate::error::Error;
use crate::observer::Observer;
use crate::recipe::{Loss, Recipe, StepKey};

/// A step's loss and gradient, averaged over the micro-batches by weight.
pub(super) struct Averaged {
    pub gradients: StepGradients,
    pub loss: f64,
    pub terms: Vec<(&'static str, f64)>,
}

/// Measurements of the micro-batches.
#[derive(Default)]
struct Measured {
    /// The weight of the first micro-batch of the step. One batch is in memory at a time, so the
    /// total weight is known after the last batch. Until then weights are relative to the first
    /// batch.
    first_weight: f64,
    /// Names of the terms of the loss.
    names: Vec<&'static str>,
    /// Weight, loss and terms of each micro-batch.
    numbers: Vec<f64>,
}

impl<R: Recipe> Trainer<R> {
    /// The gradient of the next step; `None` if a rank was interrupted.
    pub(super) fn averaged(
        &mut self,
        observer: &mut dyn Observer,
    ) -> Result<Option<Averaged>, Error> {
        let group = self.parts.group.clone();
        let count = self.parts.config.train.gradient_accumulation_steps;
        let share = group.ranks().share(count);
        let stop = || observer.stop_requested();
        let batch = self.parts.loader.next_unless(&stop).map_err(Error::from);
        let weight = match &batch {
            Ok(Some(batch)) => self.parts.recipe.weight(batch),
            _ => 0.0,
        };
        let Some((batch, weights)) = group.agree(batch, &[weight])? else {
            return Ok(None);
        };
        let first = weights[0][0];
        let mut measured = Measured {
            first_weight: if first > 0.0 { first } else { 1.0 },
            ..Measured::default()
        };
        let gradients = self.summed(share, Some(batch), &mut measured, observer);
        let Some((mut gradients, numbers)) = group.agree(gradients, &measured.numbers)? else {
            return Ok(None);
        };
        let (mut loss, mut divisor) = (0.0, 0.0);
        let mut terms: Vec<(&'static str, f64)> = Vec::new();
        let numbers = numbers.concat();
        for numbers in numbers.chunks(2 + measured.names.len()) {
            let weight = numbers[0];
            divisor += weight;
            loss += numbers[1] * weight;
            for (index, name) in measured.names.iter().enumerate() {
                let value = numbers[2 + index] * weight;
                match terms.get_mut(index) {
                    Some((_, sum)) => *sum += value,
                    None => terms.push((name, value)),
                }
            }
        }
        if count > 1 {
            loss /= divisor;
            terms.iter_mut().for_each(|(_, sum)| *sum /= divisor);
        }
        match (self.exchange.take(), gradients) {
            (Some(mut exchange), StepGradients::Host(own)) => {
                exchange.sum(group.ranks(), own, divisor);
                gradients = StepGradients::Ranks(exchange);
            }
            (_, own) => {
                gradients = own;
                if count > 1 {
                    gradients.divide(divisor);
                }
            }
        }
        Ok(Some(Averaged {
            gradients,
            loss,
            terms,
        }))
    }

    /// The weighted gradients of a range of micro-batches, added according to [`split`]; `batch` is
    /// the first micro-batch if already loaded. `None` if a stop was requested before the last
    /// micro-batch.
    fn summed(
        &mut self,
        range: Range<u64>,
        batch: Option<Batch>,
        measured: &mut Measured,
        observer: &mut dyn Observer,
    ) -> Result<Option<StepGradients>, Error> {
        let [first, second] = split(range.end - range.start);
        if second == 0 {
            let stop = || observer.stop_requested();
            let batch = match batch {
                Some(batch) => Some(batch),
                // A stop abandons a long step; resuming repeats the step.
                None if stop() => None,
                None => self.parts.loader.next_unless(&stop)?,
            };
            let gradient = batch.map(|batch| self.gradient(range.start, &batch, measured));
            return gradient.transpose();
        }
        let middle = range.start + first;
        let Some(mut sum) = self.summed(range.start..middle, batch, measured, observer)? else {
            return Ok(None);
        };
        let Some(other) = self.summed(middle..range.end, None, measured, observer)? else {
            return Ok(None);
        };
        sum.add(other);
        Ok(Some(sum))
    }

    /// The weighted gradient of a micro-batch. The loss is read after the backward pass.
    fn gradient(
        &self,
        micro_batch: u64,
        batch: &Batch,
        measured: &mut Measured,
    ) -> Result<StepGradients, Error> {
        let recipe = &self.parts.recipe;
        let weight = recipe.weight(batch) / measured.first_weight;
        let key = StepKey {
            seed: self.parts.config.run.seed,
            step: self.step,
            micro_batch,
        };
        let model = self.model.as_ref().expect("present between updates");
        let precision = self.parts.config.train.precision.of_products();
        let (names, values, sum) = precision.scope(|| {
            let Loss {
                total,
                terms,
                pending,
                ..
            } = recipe.loss(model, batch, key, &self.parts.device);
            let (names, terms): (Vec<&'static str>, Vec<Tensor<1>>) = terms.into_iter().unzip();
            let values = std::iter::once(total.clone()).chain(terms);
            let values: Vec<Tensor<1>> = values.map(Tensor::inner).collect();
            let share = Loss {
                total: total.mul_scalar(weight),
                terms: Vec::new(),
                probes: Vec::new(),
                pending,
            };
            (names, values, recipe.backward(model, share))
        });
        let device = self.parts.device.clone().inner();
        let on_device = self.states.on_device();
        let (gradients, values) = StepGradients::of(sum, model, values, on_device, &device);
        if !values[0].is_finite() {
            // The same random inputs reproduce the tensors, which were not stored.
            let again = precision.scope(|| recipe.loss(model, batch, key, &self.parts.device));
            let tensor = find_not_finite(model, batch, again);
            return Err(self.not_finite(self.step + 1, tensor));
        }
        measured.names = names;
        measured.numbers.push(weight);
        measured.numbers.extend(values);
        Ok(gradients)
    }
}
