//! The gradient of a step: that of its micro-batches, of which each rank takes a share.

use std::ops::Range;

use kinegrad_data::Batch;
use kinegrad_ranks::{add, split};

use super::Trainer;
use super::not_finite::find_not_finite;
use crate::error::Error;
use crate::observer::Observer;
use crate::recipe::{Loss, Recipe, StepKey};

/// A step's loss and its gradient, averaged over the micro-batches by their weight.
pub(super) struct Averaged {
    pub gradients: Vec<Vec<f32>>,
    pub loss: f64,
    pub terms: Vec<(&'static str, f64)>,
}

/// What is known of the micro-batches so far.
#[derive(Default)]
struct Measured {
    /// What the first micro-batch of the step weighs. One batch at a time is held, so what all of them
    /// weigh is known after the last; until then a batch counts relative to the first.
    first_weight: f64,
    /// Names of the terms of the loss.
    names: Vec<&'static str>,
    /// Of each micro-batch: weight, loss, terms.
    numbers: Vec<f64>,
}

impl<R: Recipe> Trainer<R> {
    /// The gradient of the next step; none if a rank was asked to stop while waiting for data or between
    /// its batches.
    ///
    /// # Errors
    /// If a number stops being one, or the data fails, on any rank.
    pub(super) fn averaged(
        &mut self,
        observer: &mut dyn Observer,
    ) -> Result<Option<Averaged>, Error> {
        let together = self.parts.together.clone();
        let count = self.parts.config.train.gradient_accumulation_steps;
        let share = together.ranks().share(count);
        let stop = || observer.stop_requested();
        let batch = self.parts.loader.next_unless(&stop).map_err(Error::from);
        let weight = match &batch {
            Ok(Some(batch)) => self.parts.recipe.weight(batch),
            _ => 0.0,
        };
        let Some((batch, weights)) = together.agree(batch, &[weight])? else {
            return Ok(None);
        };
        let first = weights[0][0];
        let mut measured = Measured {
            first_weight: if first > 0.0 { first } else { 1.0 },
            ..Measured::default()
        };
        let gradients = self.summed(share, Some(batch), &mut measured, observer);
        let Some((gradients, numbers)) = together.agree(gradients, &measured.numbers)? else {
            return Ok(None);
        };
        let mut gradients = self.over_ranks(gradients);
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
            let sums = gradients.iter_mut().flatten();
            sums.for_each(|sum| *sum = (f64::from(*sum) / divisor) as f32);
        }
        Ok(Some(Averaged {
            gradients,
            loss,
            terms,
        }))
    }

    /// The weighted gradients of some micro-batches, added as [`split`] says; `batch` is the first of
    /// them where it is loaded already. None if a stop was requested before the last.
    fn summed(
        &mut self,
        range: Range<u64>,
        batch: Option<Batch>,
        measured: &mut Measured,
        observer: &mut dyn Observer,
    ) -> Result<Option<Vec<Vec<f32>>>, Error> {
        let [first, second] = split(range.end - range.start);
        if second == 0 {
            let batch = match batch {
                Some(batch) => batch,
                None => {
                    let stop = || observer.stop_requested();
                    // A step of many batches is not waited for; it is done again on resuming.
                    if stop() {
                        return Ok(None);
                    }
                    match self.parts.loader.next_unless(&stop)? {
                        Some(batch) => batch,
                        None => return Ok(None),
                    }
                }
            };
            return self.gradient(range.start, &batch, measured).map(Some);
        }
        let middle = range.start + first;
        let Some(mut sum) = self.summed(range.start..middle, batch, measured, observer)? else {
            return Ok(None);
        };
        let Some(other) = self.summed(middle..range.end, None, measured, observer)? else {
            return Ok(None);
        };
        sum.iter_mut()
            .zip(&other)
            .for_each(|(sum, other)| add(sum, other));
        Ok(Some(sum))
    }

    /// The weighted gradient of a micro-batch.
    fn gradient(
        &self,
        micro_batch: u64,
        batch: &Batch,
        measured: &mut Measured,
    ) -> Result<Vec<Vec<f32>>, Error> {
        let recipe = &self.parts.recipe;
        let weight = recipe.weight(batch) / measured.first_weight;
        let key = StepKey {
            seed: self.parts.config.run.seed,
            step: self.step,
            micro_batch,
        };
        let model = self.model.as_ref().expect("held between updates");
        let computed = recipe.loss(model, batch, key, &self.parts.device);
        let value = f64::from(computed.total.clone().into_scalar::<f32>());
        if !value.is_finite() {
            let tensor = find_not_finite(model, batch, computed);
            return Err(self.not_finite(self.step + 1, tensor));
        }
        measured.names = computed.terms.iter().map(|(name, _)| *name).collect();
        let terms = computed.terms.iter();
        let terms = terms.map(|(_, term)| f64::from(term.clone().into_scalar::<f32>()));
        measured.numbers.extend([weight, value]);
        measured.numbers.extend(terms);
        let share = Loss {
            total: computed.total.mul_scalar(weight),
            terms: Vec::new(),
            probes: Vec::new(),
            pending: computed.pending,
        };
        drop((computed.terms, computed.probes));
        Ok(recipe.backward(model, share))
    }

    /// The sums of the gradients of all ranks, of the parameters whose states this one keeps.
    fn over_ranks(&self, gradients: Vec<Vec<f32>>) -> Vec<Vec<f32>> {
        let ranks = self.parts.together.ranks();
        if ranks.size() == 1 {
            return gradients;
        }
        if let Some(owners) = &self.owners {
            return owners.sums(ranks, gradients);
        }
        let lengths: Vec<usize> = gradients.iter().map(Vec::len).collect();
        let mut all = gradients.concat();
        ranks.sum(&mut all);
        let mut rest = &all[..];
        let taken = lengths.into_iter().map(|length| {
            let (gradient, behind) = rest.split_at(length);
            rest = behind;
            gradient.to_vec()
        });
        taken.collect()
    }
}
