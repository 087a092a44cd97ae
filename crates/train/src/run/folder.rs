//! The files of a run's folder that are not checkpoints: its config and its lock.

use std::fs::{self, File, TryLockError};
use std::path::Path;

use crate::config::{self, Config};
use crate::error::Error;

/// Replaces the run's `config.toml` in one step.
pub(super) fn write_config(folder: &Path, config: &Config) -> Result<(), Error> {
    let temporary = folder.join(".writing-config.toml");
    fs::write(&temporary, config::to_toml(config)).map_err(Error::io("write", &temporary))?;
    let target = folder.join("config.toml");
    fs::rename(&temporary, &target).map_err(Error::io("rename", &temporary))
}

/// The error of a run that would be overwritten.
pub(super) fn exists_already(name: &str, folder: &Path) -> Error {
    Error::usage(
        format!("the run `{name}` exists already: {}", folder.display()),
        "add `--resume` to continue it, or choose another `--name`",
    )
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
        Err(TryLockError::WouldBlock) => Err(Error::usage(
            format!(
                "another process is using the run folder {}",
                folder.display()
            ),
            "wait for it to end; the lock ends with its process",
        )),
        Err(TryLockError::Error(error)) => Err(Error::io("lock", &path)(error)),
    }
}
