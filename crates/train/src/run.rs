//! Starting and resuming a run: what is checked before anything is written, and in which order.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use burn::tensor::Device;
use kinegrad_data::{AUDIO_CHANNELS, Dataset, Loader};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_models::{Initializer, UNet1d, parameters};
use kinegrad_motion::TrainingStatistics;
use kinegrad_motion::phrase::CHANNELS;

use crate::checkpoint::{Checkpoint, Checkpoints, Progress};
use crate::config::{self, Config};
use crate::error::Error;
use crate::observer::{Observer, RunSummary};
use crate::recipes::DiffusionRecipe;
use crate::trainer::{Ending, Trainer, TrainerParts};

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
    let mut config = config::load(&request.config, &request.overrides)?.resolved();
    if config.run.name.is_empty() {
        let stem = request.config.file_stem().unwrap_or_default();
        config.run.name = stem.to_string_lossy().into_owned();
    }
    for warning in config.validate()? {
        observer.warning(&warning);
    }
    let folder = request.runs_dir.join(&config.run.name);
    let exists =
        folder.join("config.toml").exists() || !Checkpoints::of(&folder).steps().is_empty();
    let name = config.run.name.clone();
    match (exists, request.resume) {
        (true, false) => return Err(Error::RunExists { name, path: folder }),
        (false, true) if !folder.exists() => {
            let hint = "without `--resume` a new run of that name is started".into();
            return Err(Error::RunMissing { path: folder, hint });
        }
        _ => {}
    }
    let lock = exists.then(|| lock(&folder)).transpose()?;
    let checkpoint = if request.resume {
        let checkpoint = Checkpoints::of(&folder).newest_good(|damaged| {
            observer.warning(&format!("{damaged}; falling back to the one before"));
        })?;
        match &checkpoint {
            Some(checkpoint) => may_resume(&checkpoint.state.config, &config)?,
            None if exists => may_resume(&saved_config(&folder)?, &config)?,
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
    let statistics = match &checkpoint {
        Some(checkpoint) => checkpoint.state.statistics.clone(),
        None => statistics_of(&dataset, &config)?,
    };
    let statistics = Arc::new(statistics);
    let device = training_device(&config, device);
    let model = build_model(&config, checkpoint.as_ref(), &device)?;

    let step = checkpoint
        .as_ref()
        .map_or(0, |checkpoint| checkpoint.state.step);
    let progress = checkpoint
        .as_ref()
        .map(|c| c.state.progress.clone())
        .unwrap_or_default();
    let summary = RunSummary {
        name,
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
        dataset.train.clone(),
        statistics.clone(),
        &config.data,
        config.run.seed,
        step * config.train.gradient_accumulation_steps,
    );
    let recipe = DiffusionRecipe::new(
        GaussianDiffusion::new(&config.diffusion)?,
        &config.validation,
        dataset.validation,
        statistics.clone(),
        config.data.target_frames,
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

/// Number of parameters of the networks that `config` trains.
///
/// # Errors
/// If the network cannot be built.
pub fn parameter_count(config: &Config) -> Result<usize, Error> {
    // Parameters are lazy: no weight is drawn and no memory taken.
    let model = build_model(config, None, &Device::flex())?;
    Ok(parameters::infos(&model)
        .iter()
        .map(|info| info.len())
        .sum())
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

fn build_model(
    config: &Config,
    checkpoint: Option<&Checkpoint>,
    device: &Device,
) -> Result<UNet1d, Error> {
    let unet = config.model.unet1d(CHANNELS, AUDIO_CHANNELS)?;
    let model = unet.init(&Initializer::new(config.run.seed, device))?;
    Ok(match checkpoint {
        Some(checkpoint) => parameters::load(model, checkpoint.model.clone())?,
        None => model,
    })
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
