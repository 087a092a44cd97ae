//! A validated run: its device, folder and checkpoint, and its training.

use std::fs::{self, File};
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;

use burn::tensor::Device;
use kinegrad_data::{BatchShare, Dataset, Digest, Item, ItemSet, Loader, Samples};
use kinegrad_models::parameters;
use kinegrad_motion::Statistics;

use super::folder::{UNFINISHED_SAMPLES, contains_run, exists_already, remove, write_config};
use super::plan::Plan;
use crate::checkpoint::{Checkpoint, Checkpoints, Progress};
use crate::config::Config;
use crate::denoising::HeldOut;
use crate::error::Error;
use crate::observer::{Observer, RunSummary};
use crate::parameter_count::ParameterCount;
use crate::process_group::ProcessGroup;
use crate::recipe::{Recipe, RecipeInfo};
use crate::system::longer_warmup;
use crate::telemetry::Environment;
use crate::trainer::restore::check_moments;
use crate::trainer::{Ending, Trainer, TrainerParts};

/// Result of a training request.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The run's folder.
    pub folder: PathBuf,
    /// The outcome of training; `None` if the run was already finished.
    pub ending: Option<Ending>,
    /// Steps done.
    pub step: u64,
    /// Steps in total.
    pub max_steps: u64,
    /// Best validation.
    pub progress: Progress,
    /// The resolved config.
    pub config: Config,
    /// The estimate, for a dry run.
    pub plan: Option<Box<Plan>>,
    /// The run's lock, which excludes other processes from the run's folder.
    pub lock: Option<Arc<File>>,
}

/// A run whose request has been checked.
pub struct RunContext {
    /// The resolved config.
    pub config: Config,
    /// Its recipe.
    pub recipe: &'static RecipeInfo,
    /// The run's folder.
    pub folder: PathBuf,
    /// A dry run, which writes nothing.
    pub dry_run: bool,
    /// The checkpoint of a resumed run.
    pub checkpoint: Option<Checkpoint>,
    /// The device, with gradients after [`with_gradients`](Self::with_gradients).
    pub device: Device,
    pub(super) device_name: String,
    /// Estimated main memory for training, bytes.
    pub(super) memory: u64,
    /// Estimated main memory for the samples at the end, bytes.
    pub(super) memory_of_samples: u64,
    /// The lock of an existing run.
    pub(super) lock: Option<Arc<File>>,
    /// The processes that train it.
    pub group: Rc<ProcessGroup>,
}

/// The training data of a run.
pub struct TrainingData {
    /// Number of training items.
    pub train: usize,
    /// Number of held-out items.
    pub validation: usize,
    /// Id and reason of each skipped unusable item.
    pub skipped: Vec<(String, String)>,
    /// The contents of the dataset.
    pub digest: Digest,
    /// The statistics stored in checkpoints.
    pub statistics: Statistics,
    /// The statistics of the networks' channels, if different.
    pub network_statistics: Option<Statistics>,
    /// Creates the stream of batches, or a share of it.
    pub loader: Box<MakeLoader>,
}

/// Creates the stream of batches of a config, or a share of it.
pub type MakeLoader = dyn FnOnce(&Config, BatchShare) -> Loader;

/// The batches of a rank after `step` steps.
fn batches(config: &Config, step: u64, group: &ProcessGroup) -> BatchShare {
    let of = config.train.gradient_accumulation_steps;
    let share = group.ranks().share(of);
    let each = share.end - share.start;
    BatchShare {
        done: step * each,
        offset: share.start,
        each,
        of,
    }
}

impl RunContext {
    /// The context with gradients; checkpointing recomputes cheap activations in the backward pass.
    #[must_use]
    pub fn with_gradients(self, activation_checkpointing: bool) -> Self {
        let device = self.device.autodiff();
        Self {
            device: match activation_checkpointing {
                true => device.gradient_checkpointing(),
                false => device,
            },
            ..self
        }
    }

    /// Shows the warnings of the run's dataset.
    ///
    /// # Errors
    /// If the dataset differs from that of earlier steps.
    pub fn check_dataset<T: Item>(
        &self,
        dataset: &Dataset<T>,
        observer: &mut dyn Observer,
    ) -> Result<(), Error> {
        for warning in &dataset.warnings {
            observer.warning(warning);
        }
        self.must_be_same_dataset(dataset.digest)
    }

    /// The training data of `dataset`, and the held-out items, loaded into memory.
    ///
    /// # Errors
    /// If a held-out item cannot be read, or `sampling.clip` does not fit the data.
    pub fn training_data<T: Item, S: Samples>(
        &self,
        dataset: Dataset<T>,
        statistics: Statistics,
        samples: impl Fn(ItemSet<T>, &Config) -> S + 'static,
    ) -> Result<(TrainingData, HeldOut), Error> {
        let config = &self.config;
        if config.sampling.count_at_end > 0 || config.sampling.preview_every_steps > 0 {
            let channels = statistics.channels();
            config.sampling.clip_bounds(&statistics, channels)?;
        }
        let held_out = samples(dataset.validation.load()?.into(), config);
        let training_data = TrainingData {
            train: dataset.train.len(),
            validation: dataset.validation.len(),
            skipped: dataset.skipped,
            digest: dataset.digest,
            statistics,
            network_statistics: None,
            loader: Box::new(move |config, share| {
                let samples = samples(dataset.train, config);
                Loader::of_share(samples, &config.data, config.run.seed, share)
            }),
        };
        let held_out = HeldOut::new(held_out, &config.validation);
        Ok((training_data, held_out.among(&self.group)))
    }

    /// Rejects a dataset that differs from that of earlier steps.
    ///
    /// # Errors
    /// With both digests.
    pub fn must_be_same_dataset(&self, digest: Digest) -> Result<(), Error> {
        let found = digest.to_string();
        let saved = self.checkpoint.as_ref();
        match saved.and_then(|checkpoint| checkpoint.state.dataset_sha256.as_ref()) {
            Some(saved) if *saved != found => Err(Error::usage(
                format!(
                    "the dataset is not the one trained on so far: sha256 {found}, before {saved}"
                ),
                "phrases were added, removed or changed: restore them to continue, or start a new \
                 run, from this one's weights with `init.*`",
            )),
            _ => Ok(()),
        }
    }

    /// Trains `model`, which is on the device with gradients, to the end or until stopped.
    ///
    /// # Errors
    /// If the checkpoint does not fit the model, or the run fails.
    pub fn train<R: Recipe>(
        self,
        training_data: TrainingData,
        recipe: R,
        mut model: R::Model,
        observer: &mut dyn Observer,
    ) -> Result<Outcome, Error> {
        if let Some(checkpoint) = &self.checkpoint {
            model = parameters::load(model, checkpoint.model.clone())?;
            let path = Checkpoints::of(&self.folder).step_path(checkpoint.state.step);
            check_moments(&model, checkpoint, &path)?;
        }
        // Nothing is written before all ranks reach this point.
        let group = self.group;
        group.done(Ok(()))?;
        group.must_match(&[("dataset", &training_data.digest.to_string())])?;
        let (info, checkpoint) = (self.recipe, self.checkpoint);
        let state = checkpoint.as_ref().map(|checkpoint| &checkpoint.state);
        let mut outcome = Outcome {
            folder: self.folder,
            ending: None,
            step: state.map_or(0, |state| state.step),
            max_steps: 0,
            progress: state.map_or_else(Progress::default, |state| state.progress.clone()),
            config: self.config,
            plan: None,
            lock: self.lock,
        };
        let on_host = crate::device::is_host(&self.device_name);
        let steps_per_epoch = outcome.config.steps_per_epoch(training_data.train);
        let max_steps = outcome.config.length(steps_per_epoch).max_steps;
        outcome.max_steps = max_steps;
        if outcome.config.train.epochs.is_some() {
            let warning = longer_warmup(&outcome.config, max_steps);
            warning.iter().for_each(|text| observer.warning(text));
        }
        let summary = RunSummary {
            name: outcome.config.run.name.clone(),
            folder: outcome.folder.clone(),
            device: self.device_name,
            parameters: {
                let trained = parameters::trainable(&model);
                let infos = parameters::infos(&model);
                // Names of a single network's parameters do not start with its name.
                let networks: &[&str] = match info.groups {
                    [_] => &[],
                    several => several,
                };
                ParameterCount::of(&infos, networks, |index, _| trained[index])
            },
            train_phrases: training_data.train,
            validation_phrases: training_data.validation,
            skipped: training_data.skipped,
            step: outcome.step,
            max_steps,
        };
        let patience = outcome.config.train.patience;
        let stopped = patience > 0 && outcome.progress.validations_since_best >= patience;
        let nothing_left = outcome.step > 0 && (outcome.step >= max_steps || stopped);
        if !self.dry_run {
            let written = match group.writes() {
                true => write_start(
                    &outcome,
                    &summary,
                    &self.device,
                    state.is_some(),
                    nothing_left,
                ),
                false => Ok(None),
            };
            outcome.lock = group.done(written)?;
            observer.started(&summary);
            if nothing_left {
                return Ok(outcome);
            }
            let validation = &mut outcome.config.validation;
            if validation.is_enabled() && training_data.validation == 0 {
                observer.warning("nothing is held out: there is no validation and no best step");
                validation.disable();
            }
        }
        let config = &outcome.config;
        let parts = TrainerParts {
            recipe,
            groups: info.groups,
            steps_per_epoch,
            statistics: training_data.statistics,
            network_statistics: training_data.network_statistics,
            device: self.device,
            on_host,
            loader: (training_data.loader)(config, batches(config, outcome.step, &group)),
            dataset: training_data.digest,
            folder: outcome.folder.clone(),
            group: group.clone(),
            config: config.clone(),
        };
        if self.dry_run {
            let memory = [self.memory, self.memory_of_samples];
            let plan = Plan::measure(
                parts,
                model,
                checkpoint,
                &summary,
                memory,
                nothing_left,
                observer,
            )?;
            outcome.plan = Some(Box::new(plan));
            return Ok(outcome);
        }
        let trainer = Trainer::new(parts, model, checkpoint, observer);
        let mut trainer = group.done(trainer)?;
        outcome.ending = Some(trainer.run(observer)?);
        outcome.step = trainer.step;
        outcome.progress = trainer.progress;
        Ok(outcome)
    }
}

/// Writes the files before a run's first step, after all validation. Returns the run's lock.
fn write_start(
    outcome: &Outcome,
    summary: &RunSummary,
    device: &Device,
    is_resumed: bool,
    nothing_left: bool,
) -> Result<Option<Arc<File>>, Error> {
    let Outcome {
        folder,
        step,
        progress,
        config,
        lock,
        ..
    } = outcome;
    let checkpoints = Checkpoints::of(folder);
    if is_resumed {
        kinegrad_output::remove_unfinished(folder);
    }
    if is_resumed && checkpoints.best() != progress.best() {
        // A crash may have come between the checkpoint and the record of the best step.
        checkpoints.set_best(progress.best().as_ref())?;
    }
    if nothing_left {
        // A process killed after the last checkpoint may not have removed old checkpoints.
        checkpoints.prune(*step, config.checkpoint.keep_last, progress.best_step)?;
        return Ok(lock.clone());
    }
    fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
    let lock = match lock {
        Some(lock) => lock.clone(),
        None => {
            let lock = super::folder::lock(folder)?;
            // Another process may have started the run in the meantime.
            if contains_run(folder)? {
                return Err(exists_already(&config.run.name, folder));
            }
            // A process may have ended before its first checkpoint.
            kinegrad_output::remove_unfinished(folder);
            lock
        }
    };
    write_config(folder, config)?;
    if config.sampling.count_at_end > 0 {
        // Samples from an earlier end of training belong to other weights.
        let unfinished = folder.join(UNFINISHED_SAMPLES);
        remove(&unfinished)?;
        fs::create_dir(&unfinished).map_err(Error::io("create", &unfinished))?;
    }
    let environment = Environment {
        step: *step,
        parameters: summary.parameters.all,
        train_items: summary.train_phrases,
        validation_items: summary.validation_phrases,
        skipped_items: summary.skipped.len(),
        ..Environment::here(device, &summary.device)
    };
    environment.record(folder)?;
    Ok(Some(lock))
}
