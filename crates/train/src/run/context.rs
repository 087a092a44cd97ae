//! A validated run: its device, folder and checkpoint, and its training.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;

use burn::tensor::Device;
use kinegrad_data::{BatchShare, Dataset, Digest, Item, ItemSet, Loader, Samples};
use kinegrad_models::parameters;
use kinegrad_motion::Statistics;

use super::folder::{UNFINISHED_SAMPLES, contains_run, exists_already, remove, write_config};
use super::plan::{Plan, Planned};
use crate::checkpoint::{Checkpoint, Checkpoints, Progress};
use crate::config::Config;
use crate::denoising::HeldOut;
use crate::error::Error;
use crate::observer::{Observer, RunSummary};
use crate::parameter_count::ParameterCount;
use crate::process_group::ProcessGroup;
use crate::recipe::{Recipe, RecipeInfo};
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

/// Prefixes of the parameters of a recipe's networks; empty for a single network.
fn networks_of(recipe: &RecipeInfo) -> &'static [&'static str] {
    match recipe.groups {
        [_] => &[],
        several => several,
    }
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
    /// The context on the device with gradients; `activation_checkpointing` recomputes cheap activations
    /// in the backward pass.
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
    /// If it differs from the one trained on so far.
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

    /// The training data of `dataset` as `samples` of its items, and the held-out items, loaded into
    /// memory.
    ///
    /// # Errors
    /// If a held-out item cannot be read, or `sampling.clip` cannot be followed.
    pub fn training_data<T: Item, S: Samples>(
        &self,
        dataset: Dataset<T>,
        statistics: Statistics,
        samples: impl Fn(ItemSet<T>, &Config) -> S + 'static,
    ) -> Result<(TrainingData, HeldOut), Error> {
        let config = &self.config;
        if config.sampling.count_at_end > 0 || config.sampling.preview_every_steps > 0 {
            config
                .sampling
                .clip
                .range(&statistics, statistics.channels())?;
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

    /// Rejects a dataset that differs from the one trained on so far.
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
        // Nothing is written before all ranks get here.
        self.group.done(Ok(()))?;
        self.group
            .must_match(&[("dataset", &training_data.digest.to_string())])?;
        let Self {
            mut config,
            recipe: info,
            folder,
            lock,
            checkpoint,
            device,
            device_name,
            dry_run,
            memory,
            memory_of_samples,
            group,
        } = self;
        let on_host = crate::device::is_host(&device_name);
        let (step, progress) = match &checkpoint {
            Some(checkpoint) => (checkpoint.state.step, checkpoint.state.progress.clone()),
            None => (0, Progress::default()),
        };
        let summary = RunSummary {
            name: config.run.name.clone(),
            folder: folder.clone(),
            device: device_name,
            parameters: {
                let trained = parameters::trainable(&model);
                let infos = parameters::infos(&model);
                ParameterCount::of(&infos, networks_of(info), |index, _| trained[index])
            },
            train_phrases: training_data.train,
            validation_phrases: training_data.validation,
            skipped: training_data.skipped,
            step,
            max_steps: config.train.max_steps,
        };
        let patience = config.train.patience;
        let stopped = patience > 0 && progress.validations_since_best >= patience;
        let nothing_left = step > 0 && (step >= config.train.max_steps || stopped);
        if dry_run {
            let planned = Planned {
                config: &config,
                summary: &summary,
                memory,
                memory_of_samples,
                channels: {
                    let own = training_data.network_statistics.as_ref();
                    own.unwrap_or(&training_data.statistics).channels()
                },
                nothing_left,
            };
            let share = batches(&config, step, &group);
            let parts = TrainerParts {
                recipe,
                groups: info.groups,
                config: config.clone(),
                statistics: training_data.statistics,
                network_statistics: training_data.network_statistics,
                device,
                on_host,
                loader: (training_data.loader)(&config, share),
                dataset: training_data.digest,
                folder: folder.clone(),
                group,
            };
            let plan = Plan::measure(&planned, parts, model, checkpoint, observer)?;
            return Ok(Outcome {
                folder,
                ending: None,
                step,
                progress,
                config,
                plan: Some(Box::new(plan)),
                lock,
            });
        }
        let written = match group.writes() {
            true => Written {
                folder: &folder,
                config: &config,
                summary: &summary,
                device: &device,
                checkpoint: checkpoint.as_ref(),
                progress: &progress,
                nothing_left,
            }
            .write(lock),
            false => Ok(None),
        };
        let lock = group.done(written)?;
        observer.started(&summary);
        if nothing_left {
            return Ok(Outcome {
                folder,
                ending: None,
                step,
                progress,
                config,
                plan: None,
                lock,
            });
        }
        if config.validation.every_steps > 0 && training_data.validation == 0 {
            observer.warning("nothing is held out: there is no validation and no best step");
            config.validation.every_steps = 0;
        }
        let loader = (training_data.loader)(&config, batches(&config, step, &group));
        let parts = TrainerParts {
            recipe,
            groups: info.groups,
            config: config.clone(),
            statistics: training_data.statistics,
            network_statistics: training_data.network_statistics,
            device,
            on_host,
            loader,
            dataset: training_data.digest,
            folder: folder.clone(),
            group: group.clone(),
        };
        let trainer = Trainer::new(parts, model, checkpoint, observer);
        let mut trainer = group.done(trainer)?;
        let ending = trainer.run(observer)?;
        let (step, progress) = (trainer.step(), trainer.progress().clone());
        Ok(Outcome {
            folder,
            ending: Some(ending),
            step,
            progress,
            config,
            plan: None,
            lock,
        })
    }
}

/// Files written before a run's first step.
struct Written<'a> {
    folder: &'a Path,
    config: &'a Config,
    summary: &'a RunSummary,
    device: &'a Device,
    checkpoint: Option<&'a Checkpoint>,
    progress: &'a Progress,
    nothing_left: bool,
}

impl Written<'_> {
    /// Writes the files after all validation. Returns the run's lock, which an existing run already has.
    fn write(&self, lock: Option<Arc<File>>) -> Result<Option<Arc<File>>, Error> {
        let Self { folder, config, .. } = *self;
        let (step, progress) = (self.summary.step, self.progress);
        let checkpoints = Checkpoints::of(folder);
        if self.checkpoint.is_some() && checkpoints.best() != progress.best() {
            // A crash came between the checkpoint and the record of the best step.
            checkpoints.set_best(progress.best().as_ref())?;
        }
        if self.nothing_left {
            // A kill after the last checkpoint may have prevented this.
            checkpoints.prune(step, config.checkpoint.keep_last, progress.best_step)?;
            return Ok(lock);
        }
        fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
        let lock = match lock {
            Some(lock) => lock,
            None => {
                let lock = super::folder::lock(folder)?;
                // Another process may have started the run in the meantime.
                if contains_run(folder)? {
                    return Err(exists_already(&config.run.name, folder));
                }
                lock
            }
        };
        write_config(folder, config)?;
        if config.sampling.count_at_end > 0 {
            // Samples at an earlier end are of other weights.
            let owed = folder.join(UNFINISHED_SAMPLES);
            remove(&owed)?;
            fs::create_dir(&owed).map_err(Error::io("create", &owed))?;
        }
        let environment = Environment {
            step,
            parameters: self.summary.parameters.all,
            train_items: self.summary.train_phrases,
            validation_items: self.summary.validation_phrases,
            skipped_items: self.summary.skipped.len(),
            ..Environment::here(self.device, &self.summary.device)
        };
        environment.record(folder)?;
        Ok(Some(lock))
    }
}
