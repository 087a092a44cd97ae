//! The estimated resources of a run; nothing is written.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::checkpoint::Checkpoint;
use crate::config::Config;
use crate::error::Error;
use crate::memory;
use crate::observer::{Observer, RunSummary, StepReport};
use crate::parameter_count::ParameterCount;
use crate::recipe::Recipe;
use crate::trainer::{Trainer, TrainerParts};

/// Bytes of a number.
const NUMBER: u64 = 4;

/// Most steps that are measured, after a first one that is not.
const STEPS: u32 = 5;

/// No further step is begun after this time.
const LONG_ENOUGH: Duration = Duration::from_secs(10);

/// The estimated resources of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Plan {
    /// Name of the run.
    pub run: String,
    /// The folder that it would write.
    pub folder: PathBuf,
    /// Its recipe.
    pub recipe: String,
    /// Name of the device.
    pub device: String,
    /// Its parameters.
    pub parameters: ParameterCount,
    /// Items to train on.
    pub train_items: usize,
    /// Number of held-out items.
    pub validation_items: usize,
    /// Unusable items that are skipped.
    pub skipped_items: usize,
    /// Items in a batch.
    pub batch_size: usize,
    /// Frames of each.
    pub frames: usize,
    /// Steps already done.
    pub step: u64,
    /// Steps in all.
    pub max_steps: u64,
    /// Main memory that the process takes at its most, in bytes: what it has taken for the steps
    /// and the validation measured, code and stacks included, and estimates of checkpoints and of
    /// the samples at the end. Where nothing is measured, an estimate of the training alone.
    pub memory_bytes: u64,
    /// Free main memory, if known.
    pub free_memory_bytes: Option<u64>,
    /// Mean time of a step; nothing where none is left.
    pub step_seconds: Option<f64>,
    /// Steps that it is the mean of.
    pub measured_steps: u32,
    /// Time of a validation; nothing where there is none, or where it would take so long that it is
    /// not measured.
    pub validation_seconds: Option<f64>,
    /// Validations that are left.
    pub validations: u64,
    /// Time of the steps that are left, and of the validations if one was measured. Checkpoints are
    /// not counted.
    pub training_seconds: f64,
    /// Size of a checkpoint.
    pub checkpoint_bytes: u64,
    /// Most checkpoints in the folder at a time.
    pub checkpoints: u64,
    /// Size of the samples at the end.
    pub samples_bytes: u64,
    /// All of that.
    pub disk_bytes: u64,
}

/// The inputs of an estimate, in addition to networks and data.
pub(super) struct Planned<'a> {
    pub config: &'a Config,
    pub summary: &'a RunSummary,
    /// Estimate of what training takes.
    pub memory: u64,
    /// Estimate of what the samples at the end take.
    pub memory_of_samples: u64,
    pub channels: usize,
    pub nothing_left: bool,
}

impl Plan {
    /// Measures some steps of a run, and a validation.
    ///
    /// # Errors
    /// As a training step, and [`Error::Interrupted`].
    pub(super) fn measure<R: Recipe>(
        planned: &Planned<'_>,
        parts: TrainerParts<R>,
        model: R::Model,
        checkpoint: Option<Checkpoint>,
        observer: &mut dyn Observer,
    ) -> Result<Self, Error> {
        let Planned {
            config,
            summary,
            memory,
            memory_of_samples,
            channels,
            nothing_left,
        } = *planned;
        let before = memory::taken();
        let mut times = Vec::new();
        let mut validation = None;
        let mut validations = 0;
        if !nothing_left {
            let mut trainer = Trainer::unrecorded(parts, model, checkpoint);
            let began = Instant::now();
            let mut first = None;
            while times.len() < STEPS as usize {
                let Some(time) = trainer.time_step(&mut Silent(observer))? else {
                    return Err(Error::Interrupted);
                };
                // The first one allocates, and may read files that the others find in memory.
                match first {
                    None => first = Some(time),
                    Some(_) => times.push(time),
                }
                if began.elapsed() > LONG_ENOUGH {
                    break;
                }
            }
            if times.is_empty() {
                times.extend(first);
            }
            let every = config.validation.every_steps;
            if every > 0 && summary.validation_phrases > 0 {
                let (done, all) = (summary.step, summary.max_steps);
                // One in every so many steps, and one after the last.
                validations = all / every - done / every + u64::from(!all.is_multiple_of(every));
                validations += u64::from(done == 0 && trainer.measures_first());
                // Forward passes of as many items.
                let items = summary.validation_phrases * config.validation.draws;
                let step = times.iter().sum::<Duration>() / times.len() as u32;
                let expected = step * items.div_ceil(config.data.batch_size) as u32;
                if expected < 2 * LONG_ENOUGH {
                    validation = Some(trainer.time_validation()?);
                }
            }
        }
        let measured = times.len() as u32;
        let mean = (measured > 0).then(|| times.iter().sum::<Duration>() / measured);
        let step_seconds = mean.map(|mean| mean.as_secs_f64());
        let left = summary.max_steps.saturating_sub(summary.step);
        let parameters = &summary.parameters;
        let best = u64::from(config.validation.every_steps > 0);
        // Of trained parameters there are two moments, and of all the average.
        let checkpoint_bytes = NUMBER * (2 * parameters.all + 2 * parameters.trained) as u64;
        let written = left.div_ceil(config.checkpoint.every_steps.max(1)) + 1;
        let checkpoints = (config.checkpoint.keep_last as u64 + best).min(written);
        // A copy of the weights.
        let writing = NUMBER * parameters.all as u64;
        let memory = match (before, memory::taken()) {
            (Some(before), Some(after)) if measured > 0 => {
                (after.most + writing).max(before.now.saturating_add(memory_of_samples))
            }
            _ => memory,
        };
        let validation = validation.map(|time| time.as_secs_f64());
        let frames = config.data.target_frames;
        // The motion, and the raw output or the features.
        let sample = 2 * NUMBER * (frames * channels) as u64;
        let samples_bytes = config.sampling.count_at_end as u64 * sample;
        Ok(Self {
            run: summary.name.clone(),
            folder: summary.folder.clone(),
            recipe: config.train.recipe.clone(),
            device: summary.device.clone(),
            parameters: parameters.clone(),
            train_items: summary.train_phrases,
            validation_items: summary.validation_phrases,
            skipped_items: summary.skipped.len(),
            batch_size: config.data.batch_size,
            frames,
            step: summary.step,
            max_steps: summary.max_steps,
            memory_bytes: memory,
            free_memory_bytes: memory::available(),
            step_seconds,
            measured_steps: measured,
            validation_seconds: validation,
            validations,
            training_seconds: step_seconds.unwrap_or_default() * left as f64
                + validation.unwrap_or_default() * validations as f64,
            checkpoint_bytes,
            checkpoints,
            samples_bytes,
            disk_bytes: checkpoints * checkpoint_bytes + samples_bytes,
        })
    }
}

/// An observer that ignores the steps of an estimate.
struct Silent<'a>(&'a mut dyn Observer);

impl Observer for Silent<'_> {
    fn started(&mut self, _: &RunSummary) {}
    fn stepped(&mut self, _: &StepReport) {}
    fn validated(&mut self, _: u64, _: f64, _: bool) {}
    fn saved(&mut self, _: &std::path::Path) {}
    fn note(&mut self, _: &str) {}
    fn warning(&mut self, text: &str) {
        self.0.warning(text);
    }
    fn stop_requested(&self) -> bool {
        self.0.stop_requested()
    }
}
