//! Starting and resuming a run: validation before anything is written.

use std::path::{Path, PathBuf};

use super::folder::{exists_already, has_begun, lock, must_be_a_folder, must_hold_no_other};
use super::setup::{Outcome, Setup};
use crate::checkpoint::Checkpoints;
use crate::config::{self, Config, ConfigError};
use crate::error::Error;
use crate::memory;
use crate::observer::Observer;
use crate::system::Systems;

/// A request to train.
#[derive(Clone, Debug)]
pub struct TrainRequest {
    /// The config file.
    pub config: PathBuf,
    /// `KEY=VALUE` overrides.
    pub overrides: Vec<String>,
    /// Folder that contains the runs.
    pub runs_dir: PathBuf,
    /// Resume the run instead of starting it.
    pub resume: bool,
}

/// Trains a run with the system of `systems` that has the config's recipe.
///
/// # Errors
/// If the request is invalid, before anything is written, or if the run fails.
pub fn train(
    systems: Systems<'_>,
    request: &TrainRequest,
    observer: &mut dyn Observer,
) -> Result<Outcome, Error> {
    let mut config = systems.load(&request.config, &request.overrides)?;
    if config.run.name.is_empty() {
        let stem = request.config.file_stem().unwrap_or_default();
        config.run.name = stem.to_string_lossy().into_owned();
    }
    let name = config.run.name.clone();
    let folder = request.runs_dir.join(&name);
    let saved = match request.resume {
        true => saved_config(systems, &folder)?,
        false => None,
    };
    if let Some(saved) = &saved {
        config::must_have_recipe(saved, &config)?;
    }
    let (system, _) = systems.of(&config)?;
    if let Some(beneath) = system.inherited(&config, saved.as_ref())? {
        let (path, overrides) = (&request.config, &request.overrides);
        config = systems.load_over(path, overrides, &beneath)?;
        config.run.name = name;
    }
    train_config(systems, config, &request.runs_dir, request.resume, observer)
}

/// Reads a config with the values inherited from its initial checkpoints. If one is missing, calls
/// `warn` and returns the config without them.
///
/// # Errors
/// If the config cannot be read.
pub fn load_config(
    systems: Systems<'_>,
    path: &Path,
    overrides: &[String],
    warn: &mut dyn FnMut(&Error),
) -> Result<Config, Error> {
    let config = systems.load(path, overrides)?;
    let (system, _) = systems.of(&config)?;
    match system.inherited(&config, None) {
        Ok(Some(beneath)) => Ok(systems.load_over(path, overrides, &beneath)?),
        Ok(None) => Ok(config),
        Err(error) => {
            warn(&error);
            Ok(config)
        }
    }
}

/// The config that the run in `folder` was started with, if it was.
fn saved_config(systems: Systems<'_>, folder: &Path) -> Result<Option<Config>, ConfigError> {
    let path = folder.join("config.toml");
    let exists = path.exists();
    exists.then(|| systems.load(&path, &[])).transpose()
}

/// Trains the run of a resolved config, in the folder of its name under `runs_dir`.
///
/// # Errors
/// As [`train`].
pub fn train_config(
    systems: Systems<'_>,
    config: Config,
    runs_dir: &Path,
    resume: bool,
    observer: &mut dyn Observer,
) -> Result<Outcome, Error> {
    for warning in systems.validate(&config)? {
        observer.warning(&warning);
    }
    let (system, recipe) = systems.of(&config)?;
    let name = config.run.name.clone();
    let folder = runs_dir.join(&name);
    must_be_a_folder(&folder)?;
    let mut exists = has_begun(&folder)?;
    for stage in system.stages() {
        exists |= has_begun(&folder.join(stage))?;
    }
    match (exists, resume) {
        (true, false) => return Err(exists_already(&name, &folder)),
        (false, true) if !folder.exists() => {
            let hint = "without `--resume` a new run of that name is started".into();
            return Err(Error::RunMissing { path: folder, hint });
        }
        _ => {}
    }
    let lock = exists.then(|| lock(&folder)).transpose()?;
    let (checkpoint, saved) = match resume {
        false => (None, None),
        true => {
            let checkpoint = Checkpoints::of(&folder).newest_good(|damaged| {
                observer.warning(&format!("{damaged}; falling back to the one before"));
            })?;
            let saved = match &checkpoint {
                Some(checkpoint) => Some(systems.completed(&checkpoint.state.config)?),
                None => saved_config(systems, &folder)?,
            };
            (checkpoint, saved)
        }
    };
    match saved {
        Some(saved) => config::must_continue(&system.moved(saved, &config, &folder)?, &config)?,
        None => {
            system.must_use(&config)?;
            must_hold_no_other(&folder)?;
        }
    }

    let (device, device_name) = crate::device::open(&config.run.device)?;
    let on_host = crate::device::is_host(&device_name);
    let needed = system.footprint(&config)?.of_training(&config, on_host);
    memory::must_fit(
        "training",
        needed,
        "choose a smaller model (`model.*`), fewer `data.batch_size`, `validation.batch_size`, \
         `data.target_frames` or, with synthetic data, `data.synthetic.phrases`; `kinegrad config \
         show` prints the estimate",
    )?;
    let setup = Setup {
        recipe,
        device,
        device_name,
        folder,
        lock,
        checkpoint,
        config,
    };
    system.train(setup, observer)
}
