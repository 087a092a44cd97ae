//! Starting and resuming a run: what is checked before anything is written, and in which order.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use kinegrad_data::Digest;
use kinegrad_models::decoder::{DecoderInit, Normalization};
use kinegrad_models::parameters::{self, ParameterInfo};
use kinegrad_models::{DecoderConfig, Initializer};
use kinegrad_motion::phrase::CHANNELS;
use toml::Table;

use crate::checkpoint::{Checkpoint, Checkpoints, Progress};
use crate::clips::{ClipStart, clip_channels, text_denoiser};
use crate::config::{self, Config};
use crate::error::Error;
use crate::observer::Observer;
use crate::start::{Starts, clip_tables_of, tables_of};
use crate::trained::denoiser;
use crate::trainer::Ending;

mod clips;
mod folder;
mod phrases;
mod pretrain;
mod setup;

use folder::{lock, may_resume, saved_config};
use setup::Setup;

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
    if config.train.recipe.rolls_out() || config.train.recipe.reads_clips() {
        let beneath = match &saved {
            // A resumed run does not need its start any more.
            Some(saved) if config.train.recipe.reads_clips() => Some(clip_tables_of(saved)),
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

/// Reads a config with what its start, if it has one, says of the networks and the process; where
/// the start is not there, `warn` is told and the config is as it stands.
///
/// # Errors
/// If the config cannot be read.
pub fn load_config(
    path: &Path,
    overrides: &[String],
    warn: &mut dyn FnMut(&Error),
) -> Result<Config, Error> {
    let config = config::load(path, overrides)?;
    let config = match start_tables(&config) {
        Ok(Some(beneath)) => config::load_over(path, overrides, &beneath)?,
        Ok(None) => config,
        Err(error) => {
            warn(&error);
            config
        }
    };
    Ok(config.resolved())
}

fn start_tables(config: &Config) -> Result<Option<Table>, Error> {
    if config.train.recipe.reads_clips() {
        let start = ClipStart::named(config)?;
        return start.map(|start| start.tables()).transpose();
    }
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
    let setup = Setup {
        device: training_device(&config, device),
        device_name,
        folder,
        lock,
        checkpoint,
        config,
    };
    match setup.config.train.recipe.reads_clips() {
        true => clips::train(setup, observer),
        false => phrases::train(setup, observer),
    }
}

/// Number of parameters of the networks of a run of `config`, adapters left out.
///
/// # Errors
/// If a network cannot be built.
pub fn parameter_count(config: &Config) -> Result<usize, Error> {
    // Parameters are lazy: no weight of the denoiser is drawn and no memory taken.
    let device = Device::flex();
    let count = |infos: Vec<ParameterInfo>| infos.iter().map(ParameterInfo::len).sum::<usize>();
    if config.train.recipe.reads_clips() {
        let denoiser = text_denoiser(config, clip_channels(config), &device)?;
        return Ok(count(parameters::infos(&denoiser)));
    }
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

/// Refuses to continue on other phrases than those trained on so far.
fn same_dataset(digest: Digest, checkpoint: Option<&Checkpoint>) -> Result<(), Error> {
    let found = digest.to_string();
    match checkpoint.and_then(|checkpoint| checkpoint.state.dataset_sha256.as_ref()) {
        Some(saved) if *saved != found => Err(Error::DatasetDiffers {
            saved: saved.clone(),
            found,
        }),
        _ => Ok(()),
    }
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
