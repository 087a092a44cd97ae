//! Training a denoiser on noised motion, shared by the recipes of all systems: batches, random
//! inputs, loss and validation.

use std::cell::OnceCell;
use std::ops::Range;
use std::rc::Rc;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_data::{Batch, LABEL, STYLE, Samples};
use kinegrad_diffusion::{GaussianDiffusion, Time};
use kinegrad_kernels::Lengths;
use kinegrad_models::DropoutKey;
use kinegrad_random::{Key, Purpose};

use crate::config::ValidationConfig;
use crate::process_group::{ProcessGroup, Tag};
use crate::recipe::{Loss, Measured, Recipe, StepKey};

/// A batch on the device.
#[derive(Clone, Debug)]
pub struct Inputs {
    /// `[batch, channels, time]`, normalized.
    pub x_start: Tensor<3>,
    /// The condition of each sample.
    pub cond: Conditions,
    /// `[batch, time]`, 1 for valid frames.
    pub mask: Tensor<2>,
    /// Valid frames of each sample; `None` if all are valid.
    pub lengths: Option<Lengths>,
}

impl Inputs {
    /// Copies `batch` to `device`.
    pub fn new(batch: &Batch, device: &Device) -> Self {
        let (size, time) = (batch.batch_size, batch.frames);
        let on_device = |values: &[f32], shape: [usize; 3]| -> Tensor<3> {
            Tensor::from_data(TensorData::new(values.to_vec(), shape), device)
        };
        let named = batch.conditions.iter().map(|condition| {
            let shape = [size, condition.channels, condition.frames];
            (condition.name, on_device(&condition.values, shape))
        });
        let real = |mask: &[f32]| mask.iter().filter(|&&m| m > 0.0).count();
        let lengths: Vec<usize> = batch.mask.chunks(time).map(real).collect();
        let padded = lengths.iter().any(|&length| length < time);
        Self {
            x_start: on_device(&batch.x_start, [size, batch.channels, time]),
            cond: Conditions::new(named),
            mask: Tensor::from_data(TensorData::new(batch.mask.clone(), [size, time]), device),
            lengths: padded.then(|| Lengths::new(lengths)),
        }
    }
}

/// The conditions of a batch by name: `[batch, channels, time]` each, with time 1 for constant
/// conditions. Samples without a condition have zeros.
#[derive(Clone, Debug)]
pub struct Conditions(Vec<(&'static str, Tensor<3>)>);

impl Conditions {
    /// Conditions by their names.
    pub fn new(named: impl IntoIterator<Item = (&'static str, Tensor<3>)>) -> Self {
        Self(named.into_iter().collect())
    }

    /// The condition of that name.
    ///
    /// # Panics
    /// Panics if the dataset does not provide the condition.
    pub fn get(&self, name: &str) -> &Tensor<3> {
        let found = self.find(name);
        found.unwrap_or_else(|| panic!("no condition `{name}`"))
    }

    /// The condition of that name, if present.
    pub fn find(&self, name: &str) -> Option<&Tensor<3>> {
        let found = self.0.iter().find(|(known, _)| *known == name);
        found.map(|(_, cond)| cond)
    }

    /// The conditions multiplied by their dropout masks.
    fn with_dropout(self, mask: Option<Tensor<3>>, style: Option<StyleDropoutMask>) -> Self {
        let (numbers, label) = style.map(|style| (style.numbers, style.label)).unzip();
        let named = self.0.into_iter().map(|(name, cond)| {
            let mask = match name {
                STYLE => &numbers,
                LABEL => &label,
                _ => &mask,
            };
            match mask {
                Some(mask) => (name, cond * mask.clone()),
                None => (name, cond),
            }
        });
        Self::new(named)
    }
}

/// The dropout masks of the style, `[batch, 1, 1]` each: 0 drops the style.
#[derive(Clone, Debug)]
pub struct StyleDropoutMask {
    /// The eight numbers.
    pub numbers: Tensor<3>,
    /// The label.
    pub label: Tensor<3>,
}

impl StyleDropoutMask {
    /// The masks for the style in `cond`. The cases "drop everything", "drop the numbers" and "drop
    /// the label" have this `probability` each. `None` drops nothing.
    fn sample(cond: &Conditions, probability: f64, key: Key, device: &Device) -> Option<Self> {
        let parts = [STYLE, LABEL].map(|name| cond.find(name));
        let batch = parts.into_iter().flatten().next()?.dims()[0];
        if probability <= 0.0 {
            return None;
        }
        // The kinds drop everything, the numbers, the label, or nothing. A style of one part is
        // dropped entirely or not at all.
        let kinds = 1 + 2 * usize::from(parts.iter().all(Option::is_some));
        let kind = |u| Some((f64::from(u) / probability) as usize).filter(|kind| *kind < kinds);
        let dropped: Vec<usize> = key
            .uniforms(batch)
            .into_iter()
            .map(|u| kind(u).unwrap_or(3))
            .collect();
        let mask = |kinds: [usize; 2]| {
            let mask = dropped.iter().map(|kind| f32::from(!kinds.contains(kind)));
            Tensor::from_data(TensorData::new(mask.collect(), [batch, 1, 1]), device)
        };
        Some(Self {
            numbers: mask([0, 1]),
            label: mask([0, 2]),
        })
    }
}

/// The random inputs of one batch's loss.
#[derive(Clone, Debug)]
pub struct RandomInputs {
    /// One timestep per sample.
    pub timesteps: Vec<usize>,
    /// Standard normal: `[batch, channels, time]`.
    pub noise: Tensor<3>,
    /// 0 drops the condition, 1 keeps the condition: `[batch, 1, 1]`. `None` drops nothing.
    pub condition_dropout_mask: Option<Tensor<3>>,
    /// The dropout mask of the style. `None` drops nothing.
    pub style_dropout_mask: Option<StyleDropoutMask>,
    /// The network's dropout.
    pub dropout: DropoutKey,
}

impl RandomInputs {
    /// The random inputs of `key` for a batch.
    pub fn new(
        diffusion: &GaussianDiffusion,
        inputs: &Inputs,
        key: StepKey,
        device: &Device,
    ) -> Self {
        let (config, timesteps) = (&diffusion.config, key.of(Purpose::Timesteps));
        let shape @ [batch, ..] = inputs.x_start.dims();
        let condition_dropout_mask = (config.cond_drop_prob > 0.0).then(|| {
            let uniforms = key.of(Purpose::CondDropout).uniforms(batch).into_iter();
            let mask = uniforms.map(|u| f32::from(f64::from(u) >= config.cond_drop_prob));
            Tensor::from_data(TensorData::new(mask.collect(), [batch, 1, 1]), device)
        });
        Self {
            timesteps: timesteps.integers(batch, config.num_train_timesteps),
            noise: noise(key.of(Purpose::Noise), shape, device),
            condition_dropout_mask,
            style_dropout_mask: {
                let key = key.of(Purpose::StyleDropout);
                StyleDropoutMask::sample(&inputs.cond, config.style_drop_prob(), key, device)
            },
            dropout: Some(key.of(Purpose::Dropout)),
        }
    }
}

/// Standard normal noise of `key`.
pub fn noise(key: Key, shape: [usize; 3], device: &Device) -> Tensor<3> {
    let values = key.normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// The loss of a network on noised motion:
///
/// ```text
/// L = distance(target, f(x_t, t, cond))     x_t = sqrt(abar_t) x_start + sqrt(1 - abar_t) noise
/// ```
///
/// `diffusion.prediction_type` selects the target. A dropped condition is zero. `distance` is
/// called with output, target and mask.
pub fn denoising_loss(
    diffusion: &GaussianDiffusion,
    inputs: Inputs,
    random: RandomInputs,
    network: impl FnOnce(Tensor<3>, &[Time], &Conditions, DropoutKey) -> Tensor<3>,
    distance: impl FnOnce(Tensor<3>, Tensor<3>, Tensor<2>) -> Tensor<1>,
) -> Loss {
    let Inputs {
        x_start,
        cond,
        mask,
        lengths: _,
    } = inputs;
    let RandomInputs {
        timesteps,
        noise,
        condition_dropout_mask,
        style_dropout_mask,
        dropout,
    } = random;
    let x_t = diffusion.add_noise(x_start.clone(), noise.clone(), &timesteps);
    let cond = cond.with_dropout(condition_dropout_mask, style_dropout_mask);
    let model_output = network(x_t.clone(), &Time::of(&timesteps), &cond, dropout);
    let target = diffusion.target(x_start.clone(), noise, &timesteps);
    let total = distance(model_output.clone(), target, mask);
    Loss {
        terms: vec![("diffusion", total.clone())],
        probes: [("x_start", x_start)]
            .into_iter()
            .chain(cond.0)
            .chain([("x_t", x_t), ("model_output", model_output)])
            .collect(),
        total,
        pending: (),
    }
}

/// The training recipe of a denoiser.
pub struct DenoisingRecipe<M> {
    diffusion: GaussianDiffusion,
    held_out: HeldOut,
    loss: Box<BatchLoss<M>>,
    averages_samples: bool,
    measures_first: bool,
}

/// The loss of a network on a batch with random inputs; the flag is true in training.
pub type BatchLoss<M> = dyn Fn(&GaussianDiffusion, &M, Inputs, RandomInputs, bool) -> Loss;

impl<M> DenoisingRecipe<M> {
    /// A recipe over `diffusion`, validated on `held_out` without the weights of timesteps.
    pub fn new(
        diffusion: GaussianDiffusion,
        held_out: HeldOut,
        loss: impl Fn(&GaussianDiffusion, &M, Inputs, RandomInputs, bool) -> Loss + 'static,
    ) -> Self {
        Self {
            diffusion,
            held_out,
            loss: Box::new(loss),
            averages_samples: false,
            measures_first: false,
        }
    }

    /// The recipe with a loss averaged over the samples of a batch instead of its frames.
    #[must_use]
    pub fn averaging_samples(self) -> Self {
        Self {
            averages_samples: true,
            ..self
        }
    }

    /// The recipe that validates before the first step, because training starts from trained
    /// weights.
    #[must_use]
    pub fn measuring_first(self, measures_first: bool) -> Self {
        Self {
            measures_first,
            ..self
        }
    }

    /// The loss for given random inputs.
    pub fn loss_of(&self, model: &M, inputs: Inputs, random: RandomInputs) -> Loss {
        (self.loss)(&self.diffusion, model, inputs, random, true)
    }
}

impl<M: Module> Recipe for DenoisingRecipe<M> {
    type Model = M;
    type Pending = ();

    fn measures_first(&self) -> bool {
        self.measures_first
    }

    fn weight(&self, batch: &Batch) -> f64 {
        match self.averages_samples {
            true => batch.batch_size as f64,
            false => batch.mask.iter().map(|&valid| f64::from(valid)).sum(),
        }
    }

    fn loss(&self, model: &M, batch: &Batch, key: StepKey, device: &Device) -> Loss {
        let inputs = Inputs::new(batch, device);
        let random = RandomInputs::new(&self.diffusion, &inputs, key, device);
        self.loss_of(model, inputs, random)
    }

    fn validation_loss(&self, model: &M, device: &Device) -> Measured {
        let diffusion = &self.diffusion;
        let loss = |inputs, random| (self.loss)(diffusion, model, inputs, random, false).total;
        Measured {
            total: self.held_out.mean_loss(diffusion, device, loss),
            terms: Vec::new(),
        }
    }
}

/// The held-out data of a recipe.
pub struct HeldOut {
    ids: Vec<String>,
    /// The batch of a range of items.
    collate: Box<dyn Fn(Range<usize>) -> Batch>,
    draws: usize,
    batch_size: usize,
    /// The processes that share validation.
    group: Rc<ProcessGroup>,
}

impl HeldOut {
    /// The items of `samples`. Validation panics if the items are not in memory.
    pub fn new(samples: impl Samples, validation: &ValidationConfig) -> Self {
        Self {
            ids: samples.items().ids().map(String::from).collect(),
            collate: Box::new(move |range| samples.collate(range).expect("items in memory")),
            draws: validation.draws,
            batch_size: validation.batch_size,
            group: ProcessGroup::alone(),
        }
    }

    /// The held-out data, of which each rank of `group` validates a part.
    #[must_use]
    pub fn among(self, group: &Rc<ProcessGroup>) -> Self {
        Self {
            group: group.clone(),
            ..self
        }
    }

    /// No items, for a recipe that is never validated.
    pub fn nothing() -> Self {
        Self {
            ids: Vec::new(),
            collate: Box::new(|_| unreachable!("nothing is held out")),
            draws: 1,
            batch_size: 1,
            group: ProcessGroup::alone(),
        }
    }

    /// Number of items.
    pub fn len(&self) -> usize {
        self.ids.len()
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// Noise samples per item in a validation loss.
    pub fn draws(&self) -> usize {
        self.draws
    }

    /// The range of items of each batch.
    fn ranges(&self) -> impl Iterator<Item = Range<usize>> {
        let starts = (0..self.len()).step_by(self.batch_size);
        starts.map(|start| start..(start + self.batch_size).min(self.len()))
    }

    /// Noise that depends on item and draw only, so that runs with other seeds are comparable.
    pub fn noise(&self, range: Range<usize>, draw: u64, like: &Tensor<3>) -> Tensor<3> {
        let [_, channels, time] = like.dims();
        let values: Vec<f32> = self.ids[range]
            .iter()
            .flat_map(|id| {
                let key = Key::new(0, Purpose::Validation).named(id);
                key.at(draw).normals(channels * time)
            })
            .collect();
        Tensor::from_data(TensorData::new(values, like.dims()), &like.device())
    }

    /// The mean of a loss over all items and draws, without dropout, at fixed timesteps. Draw k of
    /// item p of P has timestep `floor((k P + p + 0.5) T / (draws P))`, so that the timesteps cover
    /// `[0, T)` evenly.
    pub fn mean_loss(
        &self,
        diffusion: &GaussianDiffusion,
        device: &Device,
        loss: impl Fn(Inputs, RandomInputs) -> Tensor<1>,
    ) -> f64 {
        let (all, draws) = (self.len(), self.draws);
        let num_train_timesteps = diffusion.config.num_train_timesteps;
        self.mean(device, |draw, range, inputs| {
            let timestep = |p| {
                let twice = 2 * (draw * all + p) + 1;
                twice * num_train_timesteps / (2 * draws * all)
            };
            let random = RandomInputs {
                timesteps: range.clone().map(timestep).collect(),
                noise: self.noise(range, draw as u64, &inputs.x_start),
                condition_dropout_mask: None,
                style_dropout_mask: None,
                dropout: None,
            };
            loss(inputs, random)
        })
    }

    /// The mean of a loss over all items and draws, added in a fixed order. Ranks share the
    /// batches.
    pub fn mean(
        &self,
        device: &Device,
        loss: impl Fn(usize, Range<usize>, Inputs) -> Tensor<1>,
    ) -> f64 {
        let ranges: Vec<Range<usize>> = self.ranges().collect();
        let draws = 0..self.draws;
        let jobs = draws.flat_map(|draw| ranges.iter().map(move |range| (draw, range.clone())));
        let jobs: Vec<(usize, Range<usize>)> = jobs.collect();
        let losses = self.measured(&jobs, |(draw, range)| {
            let inputs = Inputs::new(&(self.collate)(range.clone()), device);
            vec![loss(*draw, range.clone(), inputs)]
        });
        let of_items = jobs.iter().zip(losses);
        let of_items = of_items.map(|((_, range), loss)| f64::from(loss[0]) * range.len() as f64);
        of_items.sum::<f64>() / (self.draws * self.len()) as f64
    }

    /// The means of several terms over all items; `terms` gets the range and batch of items. Ranks
    /// share the batches, as in [`mean`](Self::mean).
    pub fn mean_terms(
        &self,
        terms: impl Fn(Range<usize>, Batch) -> Vec<(&'static str, Tensor<1>)>,
    ) -> Measured {
        let ranges: Vec<Range<usize>> = self.ranges().collect();
        let terms = |range: &Range<usize>| terms(range.clone(), (self.collate)(range.clone()));
        let names = OnceCell::new();
        let losses = self.measured(&ranges, |range| {
            let (own, terms) = terms(range).into_iter().unzip();
            let _: Result<_, Vec<_>> = names.set(own);
            terms
        });
        // With more ranks than batches, the last ranks have measured nothing.
        let names = names.get_or_init(|| {
            let terms = terms(&ranges[0]).into_iter();
            terms.map(|(name, _)| name).collect()
        });
        let mut measured = Measured::default();
        for (range, losses) in ranges.iter().zip(losses) {
            let share = range.len() as f64 / self.len() as f64;
            for (name, loss) in names.iter().zip(losses) {
                measured.add(name, f64::from(loss) * share);
            }
        }
        measured
    }

    /// The losses of each job, in order, shared among the ranks. Collective.
    fn measured<J>(&self, jobs: &[J], measure: impl Fn(&J) -> Vec<Tensor<1>>) -> Vec<Vec<f32>> {
        let ranks = self.group.ranks();
        let (own, size) = (ranks.rank(), ranks.size());
        let mut measured = Vec::new();
        for job in jobs.iter().skip(own).step_by(size) {
            let losses = measure(job).into_iter();
            measured.extend(losses.flat_map(|loss| loss.into_scalar::<f32>().to_le_bytes()));
        }
        let all = self.group.gather(Tag::Losses, &measured);
        // The first rank always has a job.
        let count = all[0].len() / 4 / jobs.len().div_ceil(size).max(1);
        let of = |job: usize| {
            let (losses, _) = all[job % size].as_chunks::<4>();
            let losses = losses.iter().skip(job / size * count).take(count);
            losses.map(|loss| f32::from_le_bytes(*loss)).collect()
        };
        (0..jobs.len()).map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Conditions of `batch` samples with these names, all ones.
    fn conditions(batch: usize, names: &[&'static str]) -> Conditions {
        let ones = Tensor::ones([batch, 2, 1], &Device::flex());
        Conditions::new(names.iter().map(|&name| (name, ones.clone())))
    }

    /// Shares of samples that keep both parts, the numbers, the label, and neither part.
    fn shares(names: &[&'static str], probability: f64) -> [f64; 4] {
        let (batch, key) = (4000, Key::new(7, Purpose::StyleDropout));
        let cond = conditions(batch, names);
        let mask =
            StyleDropoutMask::sample(&cond, probability, key, &Device::flex()).expect("a style");
        let host = |x: Tensor<3>| x.try_into_vec_as::<f32>().expect("float32");
        let (numbers, label) = (host(mask.numbers.clone()), host(mask.label.clone()));
        let mut counts = [0.0; 4];
        for (numbers, label) in numbers.iter().zip(&label) {
            let place = match (*numbers > 0.0, *label > 0.0) {
                (true, true) => 0,
                (true, false) => 1,
                (false, true) => 2,
                (false, false) => 3,
            };
            counts[place] += 1.0 / batch as f64;
        }
        // Dropped values are zero, the others and the audio are unchanged.
        let masked = cond.with_dropout(None, Some(mask));
        for (name, values) in masked.0 {
            let sum = values.sum().into_scalar::<f32>() / 2.0;
            let expected: f32 = match name {
                STYLE => numbers.iter().sum(),
                LABEL => label.iter().sum(),
                _ => batch as f32,
            };
            assert_eq!(sum, expected, "{name}");
        }
        counts
    }

    #[test]
    fn a_style_is_dropped_as_a_whole_and_in_parts() {
        let near = |found: [f64; 4], expected: [f64; 4]| {
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((found - expected).abs() < 0.02, "{found} {expected}");
            }
        };
        near(shares(&["audio", STYLE, LABEL], 0.2), [0.4, 0.2, 0.2, 0.2]);
        near(
            shares(&["audio", STYLE, LABEL], 0.05),
            [0.85, 0.05, 0.05, 0.05],
        );
        // A style of one part is dropped with the same probability.
        near(shares(&["audio", STYLE], 0.2), [0.8, 0.0, 0.0, 0.2]);
        near(shares(&["audio", LABEL], 0.3), [0.7, 0.0, 0.0, 0.3]);
        let (key, device) = (Key::new(7, Purpose::StyleDropout), Device::flex());
        assert!(StyleDropoutMask::sample(&conditions(3, &["audio"]), 0.2, key, &device).is_none());
        assert!(StyleDropoutMask::sample(&conditions(3, &[STYLE]), 0.0, key, &device).is_none());
    }

    #[test]
    fn dropped_audio_leaves_the_style() {
        let cond = conditions(3, &["audio", STYLE, LABEL]);
        let masked = cond.with_dropout(Some(Tensor::zeros([3, 1, 1], &Device::flex())), None);
        let sum = |name| masked.get(name).clone().sum().into_scalar::<f32>();
        assert_eq!([sum("audio"), sum(STYLE), sum(LABEL)], [0.0, 6.0, 6.0]);
    }
}
