//! Starting and resuming a run: what is checked before anything is written, and in which order.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use burn::module::Module;
use burn::tensor::Device;
use kinegrad_data::{Dataset, Loader};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_models::decoder::{DecoderInit, Normalization};
use kinegrad_models::parameters::{self, ParameterInfo};
use kinegrad_models::{DecoderConfig, Initializer, MotionModel};
use kinegrad_motion::TrainingStatistics;
use kinegrad_motion::phrase::CHANNELS;
use toml::Table;

use crate::checkpoint::{Checkpoint, Checkpoints, Progress};
use crate::config::{self, Config, Recipe};
use crate::error::Error;
use crate::observer::{Observer, RunSummary};
use crate::recipes::{self, DecoderRecipe, DiffusionRecipe, E2eRecipe, HeldOut, Sampler};
use crate::start::{Starts, tables_of};
use crate::trained::{denoiser, networks};
use crate::trainer::{Ending, Trainer, TrainerParts};

mod pretrain;

/// What `kinegrad train` is asked to do.
#[derive(Clone, Debug)]
pub struct TrainRequest {
    /// The config file.
    pub config: PathBuf,
    /// `KEY=VALUE` overrides.
    pub overrides: Vec<String>,
    /// Folder that holds the runs.
    pub runs_dir: PathBuf,
    /// Continue the run instead of starting it.
    pub resume: bool,
}

/// How a request ended.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The run's folder.
    pub folder: PathBuf,
    /// How training ended; `None` if the run was finished before.
    pub ending: Option<Ending>,
    /// Steps done.
    pub step: u64,
    /// Best validation.
    pub progress: Progress,
    /// The resolved config.
    pub config: Config,
}

/// Trains as asked.
///
/// # Errors
/// If the request is wrong, before anything is written; or if the run fails.
pub fn train(request: &TrainRequest, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let mut config = config::load(&request.config, &request.overrides)?;
    if config.run.name.is_empty() {
        let stem = request.config.file_stem().unwrap_or_default();
        config.run.name = stem.to_string_lossy().into_owned();
    }
    let name = config.run.name.clone();
    let folder = request.runs_dir.join(&name);
    let saved = if request.resume && folder.join("config.toml").exists() {
        Some(saved_config(&folder)?)
    } else {
        None
    };
    if config.train.recipe.rolls_out() {
        let beneath = match &saved {
            // A resumed run does not need its start any more.
            Some(saved) => Some(tables_of(saved, Some(saved))),
            None => start_tables(&config)?,
        };
        if let Some(beneath) = beneath {
            config = config::load_over(&request.config, &request.overrides, &beneath)?;
            config.run.name = name;
        }
    }
    train_config(
        config.resolved(),
        &request.runs_dir,
        request.resume,
        observer,
    )
}

/// Reads a config with what its start, if it has one, says of the networks and the process.
///
/// # Errors
/// If the config or its start cannot be read.
pub fn load_config(path: &Path, overrides: &[String]) -> Result<Config, Error> {
    let config = config::load(path, overrides)?;
    let config = match start_tables(&config)? {
        Some(beneath) => config::load_over(path, overrides, &beneath)?,
        None => config,
    };
    Ok(config.resolved())
}

fn start_tables(config: &Config) -> Result<Option<Table>, Error> {
    if !config.train.recipe.rolls_out() {
        return Ok(None);
    }
    Starts::named(config)?
        .map(|starts| starts.tables())
        .transpose()
}

/// Trains the run that a resolved config describes, in a folder of its name under `runs_dir`.
fn train_config(
    config: Config,
    runs_dir: &Path,
    resume: bool,
    observer: &mut dyn Observer,
) -> Result<Outcome, Error> {
    for warning in config.validate()? {
        observer.warning(&warning);
    }
    let name = config.run.name.clone();
    let folder = runs_dir.join(&name);
    let exists = folder.join("config.toml").exists()
        || pretrain::has_begun(&folder)
        || !Checkpoints::of(&folder).steps().is_empty();
    match (exists, resume) {
        (true, false) => return Err(Error::RunExists { name, path: folder }),
        (false, true) if !folder.exists() => {
            let hint = "without `--resume` a new run of that name is started".into();
            return Err(Error::RunMissing { path: folder, hint });
        }
        _ => {}
    }
    let lock = exists.then(|| lock(&folder)).transpose()?;
    let checkpoint = if resume {
        let checkpoint = Checkpoints::of(&folder).newest_good(|damaged| {
            observer.warning(&format!("{damaged}; falling back to the one before"));
        })?;
        match &checkpoint {
            Some(checkpoint) => may_resume(&checkpoint.state.config, &config)?,
            None if folder.join("config.toml").exists() => {
                may_resume(&saved_config(&folder)?, &config)?;
            }
            None => {}
        }
        checkpoint
    } else {
        None
    };

    let (device, device_name) = crate::device::open(&config.run.device)?;
    let dataset = Dataset::open(&config.data)?;
    for warning in &dataset.warnings {
        observer.warning(warning);
    }
    let starts = match config.train.recipe {
        Recipe::Diffusion => None,
        _ if checkpoint.is_some() => None,
        recipe => match (Starts::named(&config)?, recipe) {
            (Some(starts), _) => Some(starts),
            (None, Recipe::E2e) => match pretrain::run(&config, &folder, observer)? {
                Ok(starts) => Some(starts),
                Err(interrupted) => return Ok(*interrupted),
            },
            (None, _) => return Err(Error::NoStart { recipe: "decoder" }),
        },
    };
    let statistics = match (&checkpoint, &starts) {
        (Some(checkpoint), _) => checkpoint.state.statistics.clone(),
        (None, Some(starts)) => starts.statistics()?,
        (None, None) => statistics_of(&dataset, &config)?,
    };
    let setup = Setup {
        statistics: Arc::new(statistics),
        device: training_device(&config, device),
        device_name,
        dataset,
        folder,
        lock,
        config,
    };
    let (config, device) = (&setup.config, &setup.device);
    match config.train.recipe {
        Recipe::Diffusion => {
            let model = denoiser(config, device)?;
            let recipe =
                DiffusionRecipe::new(GaussianDiffusion::new(&config.diffusion)?, setup.held_out());
            setup.train(recipe, model, checkpoint, observer)
        }
        Recipe::Decoder => {
            let model = setup.networks(starts)?;
            let recipe = DecoderRecipe::new(setup.sampler()?, &config.loss, setup.held_out());
            setup.train(recipe, model, checkpoint, observer)
        }
        Recipe::E2e => {
            let model = setup.networks(starts)?;
            let recipe = E2eRecipe::new(setup.sampler()?, &config.loss, setup.held_out());
            setup.train(recipe, model, checkpoint, observer)
        }
    }
}

/// A run whose request has been checked.
struct Setup {
    config: Config,
    folder: PathBuf,
    /// Taken already where the run existed before.
    lock: Option<File>,
    dataset: Dataset,
    statistics: Arc<TrainingStatistics>,
    device: Device,
    device_name: String,
}

impl Setup {
    fn held_out(&self) -> HeldOut {
        HeldOut::new(
            self.dataset.validation.clone(),
            self.statistics.clone(),
            &self.config.validation,
            self.config.data.target_frames,
        )
    }

    fn sampler(&self) -> Result<Sampler, Error> {
        let diffusion = GaussianDiffusion::new(&self.config.diffusion)?;
        let statistics = self.statistics.clone();
        Ok(Sampler::new(diffusion, &self.config.rollout, statistics))
    }

    /// Denoiser and decoder, with the weights of `starts`; without, those of a checkpoint will
    /// replace them.
    fn networks(&self, starts: Option<Starts>) -> Result<MotionModel, Error> {
        let (config, device) = (&self.config, &self.device);
        match starts {
            Some(starts) => starts.networks(config, device),
            None => {
                let model = networks(config, &self.statistics, device)?;
                Ok(match config.train.recipe {
                    Recipe::Decoder => MotionModel {
                        unet: model.unet.no_grad(),
                        decoder: model.decoder,
                    },
                    Recipe::Diffusion | Recipe::E2e => model,
                })
            }
        }
    }

    fn train<R: recipes::Recipe>(
        self,
        recipe: R,
        mut model: R::Model,
        checkpoint: Option<Checkpoint>,
        observer: &mut dyn Observer,
    ) -> Result<Outcome, Error> {
        if let Some(checkpoint) = &checkpoint {
            model = parameters::load(model, checkpoint.model.clone())?;
        }
        let Self {
            mut config,
            folder,
            lock,
            dataset,
            statistics,
            device,
            device_name,
        } = self;
        let step = checkpoint
            .as_ref()
            .map_or(0, |checkpoint| checkpoint.state.step);
        let progress = checkpoint
            .as_ref()
            .map(|c| c.state.progress.clone())
            .unwrap_or_default();
        let summary = RunSummary {
            name: config.run.name.clone(),
            folder: folder.clone(),
            device: device_name,
            parameters: parameters::infos(&model)
                .iter()
                .map(|info| info.len())
                .sum(),
            train_phrases: dataset.train.len(),
            validation_phrases: dataset.validation.len(),
            skipped: dataset.skipped.clone(),
            step,
            max_steps: config.train.max_steps,
        };
        let patience = config.train.patience;
        let stopped = patience > 0 && progress.validations_since_best >= patience;
        if step > 0 && (step >= config.train.max_steps || stopped) {
            observer.started(&summary);
            return Ok(Outcome {
                folder,
                ending: None,
                step,
                progress,
                config,
            });
        }

        // Everything that can be refused has been: only now is something written.
        fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
        let lock = match lock {
            Some(lock) => lock,
            None => crate::run::lock(&folder)?,
        };
        write_config(&folder, &config)?;
        observer.started(&summary);

        if config.validation.every_steps > 0 && dataset.validation.is_empty() {
            observer.warning("no phrase is held out: there is no validation and no best step");
            config.validation.every_steps = 0;
        }
        let loader = Loader::new(
            dataset.train,
            statistics.clone(),
            &config.data,
            config.run.seed,
            step * config.train.gradient_accumulation_steps,
        );
        let parts = TrainerParts {
            recipe,
            model,
            config: config.clone(),
            statistics,
            device,
            loader,
            folder: folder.clone(),
        };
        let mut trainer = Trainer::new(parts, checkpoint)?;
        let ending = trainer.run(observer)?;
        drop(lock);
        let (step, progress) = (trainer.step(), trainer.progress().clone());
        Ok(Outcome {
            folder,
            ending: Some(ending),
            step,
            progress,
            config,
        })
    }
}

/// Number of parameters of the networks that `config` trains.
///
/// # Errors
/// If a network cannot be built.
pub fn parameter_count(config: &Config) -> Result<usize, Error> {
    // Parameters are lazy: no weight of the denoiser is drawn and no memory taken.
    let device = Device::flex();
    let count = |infos: Vec<ParameterInfo>| infos.iter().map(ParameterInfo::len).sum::<usize>();
    let unet = count(parameters::infos(&denoiser(config, &device)?));
    if !config.train.recipe.rolls_out() {
        return Ok(unet);
    }
    let random = DecoderConfig {
        init: DecoderInit::Random,
        ..config.decoder.clone()
    };
    let unit = Normalization {
        mean: vec![0.0; CHANNELS],
        std: vec![1.0; CHANNELS],
    };
    let decoder = random.init(unit, &Initializer::new(0, &device))?;
    Ok(unet + count(parameters::infos(&decoder)))
}

/// Statistics of the training phrases as stored; augmentation widens their ranges only.
fn statistics_of(dataset: &Dataset, config: &Config) -> Result<TrainingStatistics, Error> {
    let motions = dataset.train.iter().map(|phrase| &phrase.motion);
    let mut statistics = TrainingStatistics::compute(motions)?;
    if config.data.augment.rotate_yaw {
        statistics.widen_ranges_for_yaw();
    }
    Ok(statistics)
}

/// The device gradients are computed on.
fn training_device(config: &Config, device: Device) -> Device {
    let device = device.autodiff();
    if config.model.activation_checkpointing {
        device.gradient_checkpointing()
    } else {
        device
    }
}

/// Keys that may differ when a run is resumed.
fn may_change(key: &str) -> bool {
    key == "train.max_steps"
        || key == "run.device"
        || key.starts_with("checkpoint.")
        || key.starts_with("validation.")
}

fn may_resume(saved: &Config, given: &Config) -> Result<(), Error> {
    match config::difference(saved, given)
        .into_iter()
        .find(|d| !may_change(&d.key))
    {
        Some(d) => Err(Error::ResumeDiffers {
            key: d.key,
            saved: d.left,
            given: d.right,
        }),
        None => Ok(()),
    }
}

fn saved_config(folder: &Path) -> Result<Config, Error> {
    Ok(config::load(&folder.join("config.toml"), &[])?)
}

/// Replaces the run's `config.toml` in one step.
fn write_config(folder: &Path, config: &Config) -> Result<(), Error> {
    let temporary = folder.join(".writing-config.toml");
    fs::write(&temporary, config::to_toml(config)).map_err(Error::io("write", &temporary))?;
    let target = folder.join("config.toml");
    fs::rename(&temporary, &target).map_err(Error::io("rename", &temporary))
}

/// Takes the run's lock, which ends with this process however it ends.
fn lock(folder: &Path) -> Result<File, Error> {
    let path = folder.join("lock");
    let file = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .open(&path)
        .map_err(Error::io("open", &path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(Error::RunLocked {
            path: folder.to_path_buf(),
        }),
        Err(TryLockError::Error(error)) => Err(Error::io("lock", &path)(error)),
    }
}
