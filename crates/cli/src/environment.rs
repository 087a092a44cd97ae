//! Options that have an environment variable.

use std::path::PathBuf;

use kinegrad_train::Error;
use kinegrad_train::config::Origin;
use kinegrad_train::config::environment::{DEVICE, RUNS_DIR, variable};

use crate::args::RUNS;

/// The folder that contains the runs, unless an option names it, and its origin.
pub fn runs_dir() -> Result<(PathBuf, Origin), Error> {
    Ok(match variable(RUNS_DIR)? {
        Some(folder) => (folder.into(), Origin::Environment(RUNS_DIR)),
        None => (RUNS.into(), Origin::Default),
    })
}

/// The device of an option, else that of the environment.
pub fn device(option: Option<&str>) -> Result<Option<String>, Error> {
    match option {
        Some(device) => Ok(Some(device.to_owned())),
        None => variable(DEVICE),
    }
}
