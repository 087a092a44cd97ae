//! What a run will take, measured without writing anything.

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

/// What a run will take.
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
    /// Items held out.
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
    /// Main memory that training takes, an estimate in bytes.
    pub memory_bytes: u64,
    /// Main memory that is free, where that can be told.
    pub free_memory_bytes: Option<u64>,
    /// Mean time of a step; nothing where none is left.
    pub step_seconds: Option<f64>,
    /// Steps that it is the mean of.
    pub measured_steps: u32,
    /// Time of the steps that are left. Validations and checkpoints are not counted.
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

/// What a plan is made from, beside the networks and what feeds them.
pub(super) struct Planned<'a> {
    pub config: &'a Config,
    pub summary: &'a RunSummary,
    pub memory: u64,
    pub channels: usize,
    pub nothing_left: bool,
}

impl Plan {
    /// Measures some steps of a run.
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
            channels,
            nothing_left,
        } = *planned;
        let mut times = Vec::new();
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
        let frames = config.data.target_frames;
        // The motion, and the raw output or the features beside it.
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
            training_seconds: step_seconds.unwrap_or_default() * left as f64,
            checkpoint_bytes,
            checkpoints,
            samples_bytes,
            disk_bytes: checkpoints * checkpoint_bytes + samples_bytes,
        })
    }
}

/// An observer that hears nothing of steps which do not count.
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
