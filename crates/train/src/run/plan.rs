//! The estimated resources of a run (`--dry-run`).

use std::path::PathBuf;
use std::time::{Duration, Instant};

use kinegrad_output::path_text;
use serde::Serialize;

use crate::checkpoint::Checkpoint;
use crate::error::Error;
use crate::memory;
use crate::observer::{Observer, RunSummary};
use crate::parameter_count::ParameterCount;
use crate::recipe::Recipe;
use crate::trainer::{Trainer, TrainerParts};

/// Bytes per number.
const NUMBER: u64 = 4;

/// Number of measured steps after the first, which is not measured.
const STEPS: usize = 5;

/// Time after which no further step starts.
const LONG_ENOUGH: Duration = Duration::from_secs(10);

/// The estimated resources of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Plan {
    /// Name of the run.
    pub run: String,
    /// Its folder.
    #[serde(serialize_with = "path_text")]
    pub folder: PathBuf,
    /// Its recipe.
    pub recipe: String,
    /// Name of the device.
    pub device: String,
    /// Its parameters.
    pub parameters: ParameterCount,
    /// Number of training items.
    pub train_items: usize,
    /// Number of held-out items.
    pub validation_items: usize,
    /// Number of skipped unusable items.
    pub skipped_items: usize,
    /// Items per batch.
    pub batch_size: usize,
    /// Frames per item.
    pub frames: usize,
    /// Steps already done.
    pub step: u64,
    /// Steps in total.
    pub max_steps: u64,
    /// Peak main memory, bytes: the measured peak plus estimates for checkpoints and final samples.
    /// Without a measurement, the value is an estimate for training alone.
    pub memory_bytes: u64,
    /// Free main memory, if known.
    pub free_memory_bytes: Option<u64>,
    /// Mean time of a step; `None` if no step is left.
    pub step_seconds: Option<f64>,
    /// Number of measured steps.
    pub measured_steps: u32,
    /// Time of a validation; `None` without validation, or if measuring would take too long.
    pub validation_seconds: Option<f64>,
    /// Remaining validations.
    pub validations: u64,
    /// Time of the remaining steps, and of the validations if measured; without checkpoints.
    pub training_seconds: f64,
    /// Size of a checkpoint.
    pub checkpoint_bytes: u64,
    /// Maximum number of checkpoints in the folder.
    pub checkpoints: u64,
    /// Size of the samples at the end.
    pub samples_bytes: u64,
    /// Total size on disk.
    pub disk_bytes: u64,
}

impl Plan {
    /// Measures some steps and a validation of a run; `memory` is the estimate for training and for
    /// the samples at the end, bytes.
    pub(super) fn measure<R: Recipe>(
        parts: TrainerParts<R>,
        model: R::Model,
        checkpoint: Option<Checkpoint>,
        summary: &RunSummary,
        [memory, memory_of_samples]: [u64; 2],
        nothing_left: bool,
        observer: &mut dyn Observer,
    ) -> Result<Self, Error> {
        let config = parts.config.clone();
        let length = config.length(parts.steps_per_epoch);
        let statistics = parts.network_statistics.as_ref();
        let channels = statistics.unwrap_or(&parts.statistics).channels();
        let before = memory::taken();
        let mut times = Vec::new();
        let mut validation = None;
        let mut validations = 0;
        if !nothing_left {
            let measures_first = parts.recipe.measures_first();
            let mut trainer = Trainer::unrecorded(parts, model, checkpoint);
            let began = Instant::now();
            while times.len() <= STEPS && began.elapsed() <= LONG_ENOUGH {
                let began = Instant::now();
                let done = trainer.train_step(observer)?;
                done.ok_or(Error::Interrupted)?;
                times.push(began.elapsed());
            }
            if times.len() > 1 {
                // The first step allocates memory and reads files that are cached afterwards.
                times.remove(0);
            }
            let every = length.validate_every;
            if every > 0 && summary.validation_phrases > 0 {
                let (done, all) = (summary.step, summary.max_steps);
                // Validation runs every `every` steps and after the last.
                validations = all / every - done / every + u64::from(!all.is_multiple_of(every));
                validations += u64::from(done == 0 && measures_first);
                // A validation consists of this many forward passes.
                let items = summary.validation_phrases * config.validation.draws;
                let step = times.iter().sum::<Duration>() / times.len() as u32;
                let expected = step * items.div_ceil(config.data.batch_size) as u32;
                if expected < 2 * LONG_ENOUGH {
                    let began = Instant::now();
                    trainer.measure()?;
                    validation = Some(began.elapsed());
                }
            }
        }
        let measured = times.len() as u32;
        let mean = (measured > 0).then(|| times.iter().sum::<Duration>() / measured);
        let step_seconds = mean.map(|mean| mean.as_secs_f64());
        let left = summary.max_steps.saturating_sub(summary.step);
        let parameters = &summary.parameters;
        let best = u64::from(config.validation.is_enabled());
        // Two moments of trained parameters; weights and average of all parameters.
        let checkpoint_bytes = NUMBER * (2 * parameters.all + 2 * parameters.trained) as u64;
        let written = left.div_ceil(length.checkpoint_every.max(1)) + 1;
        let checkpoints = (config.checkpoint.keep_last as u64 + best).min(written);
        // The copy of the weights for a checkpoint.
        let writing = NUMBER * parameters.all as u64;
        let memory = match (before, memory::taken()) {
            (Some(before), Some(after)) if measured > 0 => {
                (after.most + writing).max(before.now.saturating_add(memory_of_samples))
            }
            _ => memory,
        };
        let validation = validation.map(|time| time.as_secs_f64());
        let frames = config.data.target_frames;
        // The motion and the raw output or the features.
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
