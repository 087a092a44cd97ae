//! The files of a run's folder that are not checkpoints: its config and its lock.

use std::fs::{self, File, TryLockError};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use kinegrad_data::file::{is_inside, regular};

use crate::checkpoint::Checkpoints;
use crate::config::{self, Config};
use crate::error::Error;
use crate::telemetry;

pub(super) const CONFIG: &str = "config.toml";
const LOCK: &str = "lock";

/// Folder of the samples at a run's end.
pub const SAMPLES: &str = "samples";

/// Folder for unfinished samples, from the start of a run until all samples are complete.
pub const UNFINISHED_SAMPLES: &str = ".writing-samples";

/// Folder of the previews during training.
pub const PREVIEWS: &str = "previews";

/// Folder of the reports of evaluations.
pub const REPORTS: &str = "reports";

/// Page of the previews of `step` of the run in `folder`.
pub fn preview_page(folder: &Path, step: u64) -> PathBuf {
    folder.join(PREVIEWS).join(format!("step-{step:08}.html"))
}

/// True if `folder` contains a run: its config or, if the config is lost, a checkpoint.
///
/// # Errors
/// If the checkpoints cannot be listed.
pub fn contains_run(folder: &Path) -> Result<bool, Error> {
    Ok(folder.join(CONFIG).exists() || !Checkpoints::of(folder).steps()?.is_empty())
}

/// Rejects a folder that is a file or below one.
pub(super) fn must_be_a_folder(folder: &Path) -> Result<(), Error> {
    let is_file = match fs::metadata(folder) {
        Ok(found) => !found.is_dir(),
        Err(error) => error.kind() == ErrorKind::NotADirectory,
    };
    match is_file {
        false => Ok(()),
        true => Err(Error::usage(
            format!(
                "{} cannot be a run's folder: it is a file, or below one",
                folder.display()
            ),
            "choose another option `name` or option `runs_dir`",
        )),
    }
}

/// Files and folders of a run other than its config, its lock and its stages.
const WRITTEN: [&str; 9] = [
    "checkpoints",
    "metrics.jsonl",
    "loader.jsonl",
    "events.out.tfevents.kinegrad",
    telemetry::ENVIRONMENT,
    REPORTS,
    PREVIEWS,
    SAMPLES,
    UNFINISHED_SAMPLES,
];

/// Rejects a run with files, folders or `stages` that are links out of it: they would be written
/// through.
pub(super) fn must_have_own_files(folder: &Path, stages: &[&str]) -> Result<(), Error> {
    let mut names = WRITTEN.iter().chain(stages);
    names.try_for_each(|name| must_be_inside(folder, name))
}

/// Rejects the file or folder `name` of the run in `folder` if it is a link that leads out of the run.
///
/// # Errors
/// [`Error::Usage`] for such a link, and for one that leads nowhere.
pub fn must_be_inside(folder: &Path, name: &str) -> Result<(), Error> {
    let path = folder.join(name);
    match path.is_symlink() && !is_inside(folder, &path).unwrap_or(false) {
        false => Ok(()),
        true => Err(Error::usage(
            format!(
                "{} is a symbolic link that leads out of the run",
                path.display()
            ),
            "put it into the run's folder itself; the run's whole folder may be a link",
        )),
    }
}

/// Rejects the folder of a new run if it contains files that the run would overwrite.
pub(super) fn must_be_unused(folder: &Path) -> Result<(), Error> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(Error::io("list", folder))?,
    };
    for entry in entries {
        let name = entry.map_err(Error::io("list", folder))?.file_name();
        if WRITTEN.iter().any(|written| name == *written) {
            return Err(Error::usage(
                format!(
                    "{} exists and is not a run: it contains `{}` and no {CONFIG}",
                    folder.display(),
                    name.display()
                ),
                "choose another option `name` or option `runs_dir`, or move away what is in that folder",
            ));
        }
    }
    Ok(())
}

/// Replaces the run's `config.toml` in one step.
pub(super) fn write_config(folder: &Path, config: &Config) -> Result<(), Error> {
    let target = folder.join(CONFIG);
    let written = kinegrad_output::write(&target, config::to_toml(config).as_bytes());
    written.map_err(Error::io("write", &target))
}

/// Removes a file, or a folder with its contents, if it exists.
///
/// # Errors
/// If the file or folder cannot be removed.
pub fn remove(path: &Path) -> Result<(), Error> {
    let removed = match path.is_dir() && !path.is_symlink() {
        true => fs::remove_dir_all(path),
        false => fs::remove_file(path),
    };
    match removed {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(Error::io("remove", path)(error)),
        _ => Ok(()),
    }
}

/// The error for a run that would be overwritten.
pub(super) fn exists_already(name: &str, folder: &Path) -> Error {
    Error::usage(
        format!("the run `{name}` exists already: {}", folder.display()),
        "add option `resume` to continue it, or choose another option `name`",
    )
}

/// True if a process has the run's lock, for training or sampling.
pub fn is_in_use(folder: &Path) -> bool {
    let path = folder.join(LOCK);
    // Opening a pipe would wait.
    let Ok(file) = regular(&path).and_then(|_| File::open(path)) else {
        return false;
    };
    // With a shared lock, several processes can check at a time.
    matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock))
}

/// Takes the run's lock, which is released on drop and when the process ends.
pub(super) fn lock(folder: &Path) -> Result<Arc<File>, Error> {
    let path = folder.join(LOCK);
    let file = kinegrad_output::lock(&path).map_err(Error::io("open", &path))?;
    match file.try_lock() {
        Ok(()) => Ok(Arc::new(file)),
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
