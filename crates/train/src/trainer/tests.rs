use std::path::Path;
use std::sync::Arc;

use burn::tensor::{Device, Tensor};
use kinegrad_data::{Batch, Dataset, PhraseItem, PhraseSamples, synthetic};
use kinegrad_models::Initializer;
use kinegrad_models::layers::Linear;
use kinegrad_motion::{Phrases, phrase_statistics};

use kinegrad_models::parameters;

use super::states::decays;
use super::*;
use crate::config::{OptimConfig, WeightDecayGroups, plain};
use crate::denoising::Inputs;
use crate::observer::RunSummary;
use crate::optim::{AdamW, Moments};
use crate::recipe::{Loss, StepKey};

/// The mean over valid frames of a linear map's square: a loss without random inputs.
struct Squares;

impl Recipe for Squares {
    type Model = Linear;
    type Pending = ();

    fn loss(&self, model: &Linear, batch: &Batch, _: StepKey, device: &Device) -> Loss {
        let inputs = Inputs::new(batch, device);
        let mask: Tensor<3> = inputs.mask.unsqueeze_dim(1);
        let squares = model.forward_frames(inputs.x_start).square() * mask.clone();
        Loss {
            total: (squares.sum() / mask.sum()).reshape([1]),
            terms: Vec::new(),
            probes: Vec::new(),
            pending: (),
        }
    }

    fn validation_loss(&self, _: &Linear, _: &Device) -> Measured {
        Measured::default()
    }
}

/// Requests a stop at once if true.
#[derive(Default)]
struct Watching(bool);

impl Observer for Watching {
    fn started(&mut self, _: &RunSummary) {}
    fn stepped(&mut self, _: &StepReport) {}
    fn validated(&mut self, _: u64, _: f64, _: bool) {}
    fn saved(&mut self, _: &Path) {}
    fn note(&mut self, _: &str) {}
    fn warning(&mut self, _: &str) {}
    fn stop_requested(&self) -> bool {
        self.0
    }
}

/// Report and weights of a step on three phrases of 9, 4 and 12 frames, in `batches` batches.
fn step_in(batches: usize) -> (StepReport, Vec<Vec<f32>>) {
    let mut trainer = trainer(batches);
    let step = trainer.train_step(&mut Watching::default());
    let (report, _) = step.unwrap().expect("a step");
    let weights = parameters::values(trainer.model.as_ref().unwrap());
    (report, weights)
}

/// A trainer whose steps have `batches` batches of three phrases of 9, 4 and 12 frames.
fn trainer(batches: usize) -> Trainer<Squares> {
    trainer_with(batches, "host", true)
}

/// A [`trainer`] with the optimizer's states in a given memory. With `on_host`, its device reports
/// main memory.
fn trainer_with(batches: usize, states: &str, on_host: bool) -> Trainer<Squares> {
    let overrides = [
        format!("data.batch_size={}", 3 / batches),
        format!("train.gradient_accumulation_steps={batches}"),
        format!("optim.offload={states}"),
    ];
    let overrides = overrides.into_iter().chain(
        [
            "data.kind=synthetic",
            "data.target_frames=12",
            "data.num_workers=0",
            "optim.warmup_steps=0",
        ]
        .map(String::from),
    );
    let overrides: Vec<String> = overrides.collect();
    let config = plain("", &overrides);
    let phrase = |(index, frames)| Arc::new(synthetic::phrase(index, frames, 2));
    let phrases: Vec<Arc<PhraseItem>> = [9, 4, 12].into_iter().enumerate().map(phrase).collect();
    let statistics = phrase_statistics(phrases.iter().map(|phrase| &phrase.motion)).unwrap();
    let dataset = Dataset::<PhraseItem>::of_items(phrases, Vec::new(), Phrases);
    let given = Arc::new(statistics.clone());
    let samples = PhraseSamples::new(dataset.train.clone(), given, &config.data, 1);
    let device = Device::flex().autodiff();
    let parts = TrainerParts {
        recipe: Squares,
        groups: &["model"],
        steps_per_epoch: 1,
        loader: Loader::new(samples, &config.data, 1, 0),
        config,
        statistics,
        network_statistics: None,
        device: device.clone(),
        on_host,
        dataset: dataset.digest,
        folder: PathBuf::new(),
        group: ProcessGroup::alone(),
    };
    let model = Linear::new(25, 2, &Initializer::new(3, &device));
    Trainer::unrecorded(parts, model, None)
}

#[test]
fn a_stop_between_the_batches_of_a_step_leaves_the_weights() {
    let weights = |trainer: &Trainer<Squares>| parameters::values(trainer.model.as_ref().unwrap());
    let mut stopped = trainer(3);
    let before = weights(&stopped);
    let step = stopped.train_step(&mut Watching(true)).unwrap();
    assert!(step.is_none() && stopped.step == 0);
    assert_eq!(weights(&stopped), before);
    // A step of one batch is finished despite the stop.
    let mut whole = trainer(1);
    assert!(whole.train_step(&mut Watching(true)).unwrap().is_some());
    assert_ne!(weights(&whole), before);
}

#[test]
fn states_are_moved_alike_in_either_place() {
    let after = |batches, states, on_host| {
        let mut trainer = trainer_with(batches, states, on_host);
        let mut last = None;
        for _ in 0..4 {
            last = trainer.train_step(&mut Watching::default()).unwrap();
            assert!(last.is_some());
        }
        assert_eq!(
            trainer.states.on_device().is_some(),
            states != "host" && !on_host
        );
        let ranks = trainer.parts.group.ranks();
        let moments = trainer.states.moments(ranks, Receivers::All).into_owned();
        let halves = moments.into_iter().map(|m| [m.exp_avg, m.exp_avg_sq]);
        let mut all = parameters::values(trainer.model.as_ref().unwrap());
        all.extend(trainer.states.averages(ranks, Receivers::All).into_owned());
        all.extend(halves.flatten());
        (last.expect("a report").0, all.concat())
    };
    for batches in [1, 3] {
        let (report, reference) = after(batches, "auto", true);
        // The copy in main memory updates weights on another device.
        let (_, copied) = after(batches, "host", false);
        assert_eq!(copied, reference);
        let (other, found) = after(batches, "device", false);
        assert!((other.grad_norm / report.grad_norm - 1.0).abs() < 1e-6);
        assert_eq!(found.len(), reference.len());
        for (found, expected) in found.iter().zip(&reference) {
            let error = (found - expected).abs();
            assert!(
                error <= 1e-6 * expected.abs().max(1e-3),
                "{found} {expected}"
            );
        }
    }
}

#[test]
fn batches_of_unequal_lengths_accumulate_to_what_one_batch_is() {
    let ((whole, weights), (parts, in_parts)) = (step_in(1), step_in(3));
    let near = |a: f64, b: f64| (a - b).abs() <= 1e-5 * a.abs();
    assert!(
        near(whole.loss, parts.loss),
        "{} {}",
        whole.loss,
        parts.loss
    );
    assert!(
        near(whole.grad_norm, parts.grad_norm),
        "{} {}",
        whole.grad_norm,
        parts.grad_norm
    );
    for (whole, parts) in weights.iter().flatten().zip(in_parts.iter().flatten()) {
        assert!((whole - parts).abs() < 1e-6, "{whole} {parts}");
    }
}

#[test]
fn decay_may_leave_norms_biases_and_adapters_alone() {
    let optim = |weight_decay_groups| OptimConfig {
        weight_decay_groups,
        ..OptimConfig::default()
    };
    for (name, shape, is_matrix) in [
        ("conv.weight", vec![4, 3, 3], true),
        ("conv.bias", vec![4], false),
        ("norm.weight", vec![4], false),
        ("time.embedding.weight", vec![4, 8], true),
        ("conv.lora.down", vec![2, 3, 3], false),
    ] {
        let info = ParameterInfo {
            name: name.into(),
            shape,
        };
        assert!(decays(&optim(WeightDecayGroups::All), &info), "{name}");
        let matrices = optim(WeightDecayGroups::Matrices);
        assert_eq!(decays(&matrices, &info), is_matrix, "{name}");
    }
}

#[test]
fn parameters_without_decay_stay_where_nothing_pulls() {
    let config = OptimConfig {
        weight_decay: 0.5,
        ..OptimConfig::default()
    };
    let mut adamw = AdamW::new(&config, 0).with_decay_on(vec![true, false]);
    adamw.begin_step();
    let mut values = [[3.0f32; 2]; 2];
    for (index, values) in values.iter_mut().enumerate() {
        Moments::zeros(2).update(adamw.step(index, 1.0, 0.1), values, &[0.0; 2], None);
    }
    assert!((values[0][0] - 2.85).abs() < 1e-6, "{values:?}");
    assert_eq!(values[1], [3.0; 2]);
}
