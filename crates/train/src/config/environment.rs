//! Config keys from environment variables.
//!
//! A value of the command line (option `set`) wins over the environment, and the environment over the
//! config file.

use std::env;
use std::path::PathBuf;

use super::Origin;
use crate::error::Error;

/// Environment variables and the config keys that they set.
pub const VARIABLES: [(&str, &str); 4] = [
    ("KINEGRAD_DEVICE", "run.device"),
    ("KINEGRAD_DATA_SOURCE", "data.source"),
    ("KINEGRAD_DIFFUSION_CHECKPOINT", "init.diffusion"),
    ("KINEGRAD_DECODER_CHECKPOINT", "init.decoder"),
];

/// The environment variable of the folder that contains the runs.
const RUNS_DIR: &str = "KINEGRAD_RUNS_DIR";

/// The folder that contains the runs.
const RUNS: &str = "runs";

/// A config key that an environment variable sets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EnvironmentSetting {
    /// The variable.
    pub variable: &'static str,
    /// The dotted key.
    pub key: &'static str,
    /// The variable's value.
    pub value: String,
}

impl EnvironmentSetting {
    /// The settings of this process's environment.
    ///
    /// # Errors
    /// [`Error::Usage`] for a value that is not UTF-8.
    pub fn all() -> Result<Vec<Self>, Error> {
        let set = VARIABLES.iter().map(|&(name, key)| {
            let value = variable(name)?;
            Ok(value.map(|value| Self {
                variable: name,
                key,
                value,
            }))
        });
        set.filter_map(Result::transpose).collect()
    }

    /// The setting as an override, `KEY="VALUE"`.
    pub(crate) fn argument(&self) -> String {
        let value = serde_json::Value::from(self.value.as_str());
        format!("{}={value}", self.key)
    }
}

/// The folder that contains the runs, unless an option names it, and its origin.
///
/// # Errors
/// As [`EnvironmentSetting::all`].
pub fn runs_dir() -> Result<(PathBuf, Origin), Error> {
    Ok(match variable(RUNS_DIR)? {
        Some(folder) => (folder.into(), Origin::Environment(RUNS_DIR)),
        None => (RUNS.into(), Origin::Default),
    })
}

/// The device of the environment, if set.
///
/// # Errors
/// As [`EnvironmentSetting::all`].
pub fn device() -> Result<Option<String>, Error> {
    let (name, _) = VARIABLES[0];
    variable(name)
}

/// The value of an environment variable; `None` if the variable is unset or empty.
///
/// # Errors
/// [`Error::Usage`] for a value that is not UTF-8.
fn variable(name: &str) -> Result<Option<String>, Error> {
    match env::var(name) {
        Ok(value) => Ok((!value.is_empty()).then_some(value)),
        Err(env::VarError::NotPresent) => Ok(None),
        Err(env::VarError::NotUnicode(found)) => Err(Error::usage(
            format!("the environment variable {name} is {found:?}"),
            "set it to text in UTF-8, or unset it",
        )),
    }
}
