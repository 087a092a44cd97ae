//! The files of a run's folder that are not checkpoints: its config and its lock.

use std::fs::{self, File, TryLockError};
use std::path::Path;

use crate::config::{self, Config};
use crate::error::Error;

/// Keys that may differ when a run is resumed.
fn may_change(key: &str) -> bool {
    key == "train.max_steps"
        || key == "run.device"
        || key.starts_with("checkpoint.")
        || key.starts_with("validation.")
        // Where phrases lie and how they are fetched and kept changes no batch: that they are the
        // same is checked by itself.
        || key == "data.source"
        || key == "data.num_workers"
        || key.starts_with("data.cache.")
        || key.starts_with("data.store.")
}

/// Refuses a config that would not continue the saved one.
pub(super) fn may_resume(saved: &Config, given: &Config) -> Result<(), Error> {
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

/// The config the run was started with.
pub(super) fn saved_config(folder: &Path) -> Result<Config, Error> {
    Ok(config::load(&folder.join("config.toml"), &[])?)
}

/// Replaces the run's `config.toml` in one step.
pub(super) fn write_config(folder: &Path, config: &Config) -> Result<(), Error> {
    let temporary = folder.join(".writing-config.toml");
    fs::write(&temporary, config::to_toml(config)).map_err(Error::io("write", &temporary))?;
    let target = folder.join("config.toml");
    fs::rename(&temporary, &target).map_err(Error::io("rename", &temporary))
}

/// Takes the run's lock, which ends with this process however it ends.
pub(super) fn lock(folder: &Path) -> Result<File, Error> {
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
