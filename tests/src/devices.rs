//! A small model of each system on a device.

use std::ops::ControlFlow;
use std::path::Path;

use kinegrad_systems::BUILT_IN;
use kinegrad_train::checkpoint::{Weights, resolve_checkpoint};
use kinegrad_train::run::{Target, TrainRequest, train};
use kinegrad_train::sampling::{Contents, Request, Sample, SampleSink};
use kinegrad_train::{Error, Observer, Reading, RunSummary, StepReport};

use crate::sandbox::{SMALLEST, SMALLEST_WALKS};

const STEPS: u64 = 20;

/// The table `model` and further settings of each system's recipe, beside [`SMALLEST`] or
/// [`SMALLEST_WALKS`].
const SYSTEMS: [(&str, &str, &[&str]); 5] = [
    ("diffusion", "", &["sampling.sampler.num_inference_steps=3"]),
    (
        "gmd_motion",
        "",
        &["sampling.sampler.num_inference_steps=3"],
    ),
    (
        "bpe_motion",
        "kind = \"bpe_transformer\"\nlatent_dim = 24\nnum_layers = 1\nnum_heads = 1\nff_size = 24\n\
         horizon = 12\n",
        &[
            "sampling.sampler.num_inference_steps=3",
            "evaluation.transition_frames=6",
        ],
    ),
    (
        "flow",
        "size = \"tiny\"\njoint_dim = 8\ncontext_dim = 8\ngru_dim = 8\ndecoder_dim = 16\n\
         latent_dim = 16\nff_size = 16\n",
        &[
            "sampling.sampler.num_inference_steps=2",
            "pose.history_frames=4",
        ],
    ),
    (
        "text_motion",
        "size = \"text_motion_tiny\"\nmotion_state = 24\n",
        &["data.target_frames=16"],
    ),
];

/// Collects the losses of all steps.
#[derive(Default)]
struct Losses(Vec<f64>);

impl Observer for Losses {
    fn started(&mut self, _: &RunSummary) {}
    fn stepped(&mut self, report: &StepReport) {
        self.0.push(report.loss);
    }
    fn validated(&mut self, _: u64, _: f64, _: bool) {}
    fn saved(&mut self, _: &Path) {}
    fn note(&mut self, _: &str) {}
    fn warning(&mut self, _: &str) {}
    fn reading(&self) -> Box<Reading> {
        Box::new(|_, _| ControlFlow::Continue(()))
    }
    fn stop_requested(&self) -> bool {
        false
    }
}

/// Keeps the numbers of all samples.
#[derive(Default)]
struct Numbers(Vec<f32>);

impl SampleSink for Numbers {
    fn stepped(&mut self, _: &'static str, _: usize, _: usize) {}
    fn sample(&mut self, sample: Sample) -> Result<(), Error> {
        for (_, contents) in sample.files {
            if let Contents::Array { values, .. } = contents {
                self.0.extend(values);
            }
        }
        Ok(())
    }
}

/// Trains a small model of each system on the device called `name` for 20 steps, of which the last 10
/// are resumed from a checkpoint, and samples it. The losses are those of an uninterrupted training
/// on the CPU, and the samples are finite.
///
/// # Panics
/// Panics if a training fails or a loss differs by more than 1 %.
pub fn assert_systems_run(name: &str) {
    for (recipe, network, settings) in SYSTEMS {
        let folder = tempfile::tempdir().expect("a folder");
        let config = config(recipe, network);
        let path = folder.path().join("c.toml");
        std::fs::write(&path, config).expect("a config");
        let trained = |run: &str, device: &str, target: Target, steps: u64| {
            let mut overrides = vec![format!("train.max_steps={steps}")];
            if !matches!(target, Target::Folder(_)) {
                overrides.push(format!("run.name={run}"));
                overrides.push(format!("run.device={device}"));
                overrides.extend(settings.iter().map(|setting| (*setting).to_owned()));
            }
            let request = TrainRequest {
                overrides,
                target,
                environment: Vec::new(),
                runs_dir: folder.path().join("runs"),
                dry_run: false,
            };
            let mut losses = Losses::default();
            train(BUILT_IN, &request, &mut losses)
                .unwrap_or_else(|error| panic!("{recipe} on {device}: {error}"));
            losses.0
        };
        let whole = trained("whole", "cpu", Target::New(path.clone()), STEPS);
        let mut halves = trained("halves", name, Target::New(path), STEPS / 2);
        let run = folder.path().join("runs/halves");
        halves.extend(trained("halves", name, Target::Folder(run.clone()), STEPS));
        assert_eq!(halves.len() as u64, STEPS);
        for (step, (loss, on_cpu)) in halves.iter().zip(&whole).enumerate() {
            let difference = (loss - on_cpu).abs() / on_cpu.abs();
            assert!(
                difference < 0.01,
                "{recipe}, step {}: loss {loss} on {name}, {on_cpu} on the CPU",
                step + 1
            );
        }
        if recipe != "text_motion" {
            let values = sampled(&run);
            assert!(!values.is_empty() && values.iter().all(|value| value.is_finite()));
        }
    }
}

/// The smallest config of a recipe. The rate is constant, so that a training of half the steps is the
/// first half of the whole.
fn config(recipe: &str, network: &str) -> String {
    let smallest = match recipe {
        "diffusion" => SMALLEST,
        _ => SMALLEST_WALKS,
    };
    let smallest = smallest
        .replace("recipe = \"gmd_motion\"", &format!("recipe = \"{recipe}\""))
        .replace("[optim]", "[optim]\nlr_schedule = \"constant\"");
    if network.is_empty() {
        return smallest;
    }
    let (before, after) = smallest.split_once("[model]\n").expect("a table");
    let (_, after) = after.split_once("[optim]").expect("a table");
    format!("{before}[model]\n{network}[optim]{after}")
}

/// The numbers of a sample for a held-out item.
fn sampled(run: &Path) -> Vec<f32> {
    let saved = resolve_checkpoint(run, |_| {}).expect("a checkpoint");
    let trained = BUILT_IN.trained(saved, &[], Weights::Ema, None);
    let trained = trained.expect("a model");
    let mut numbers = Numbers::default();
    let request = Request::held_out(1, 3);
    BUILT_IN
        .sample(&trained, &request, &mut numbers)
        .expect("a sample");
    numbers.0
}
