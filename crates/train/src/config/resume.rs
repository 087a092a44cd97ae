//! Differences allowed between a run's saved config and its resume.

use std::fmt::Display;

use kinegrad_settings::InvalidSetting;

use super::{Config, difference};

/// Keys and tables that a resumed run may change. The location, transport and cache of motion do
/// not affect batches; the dataset's digest is checked separately.
const FREE: [&str; 13] = [
    "train.max_steps",
    "train.epochs",
    "run.device",
    "optim.offload",
    "optim.shard_states",
    "checkpoint.*",
    "validation.*",
    "evaluation.*",
    "sampling.preview_every_steps",
    "data.source",
    "data.num_workers",
    "data.cache.*",
    "data.store.*",
];

/// True if a dotted key may differ when a run is resumed.
pub(crate) fn may_differ(key: &str) -> bool {
    FREE.iter().any(|free| kinegrad_data::matches(free, key))
}

/// Rejects changes of the saved config with which a run cannot continue.
pub(crate) fn must_continue(saved: &Config, given: &Config) -> Result<(), InvalidSetting> {
    must_have_recipe(saved, given)?;
    let mut differences = difference(saved, given).into_iter();
    match differences.find(|d| !may_differ(&d.key)) {
        Some(d) => Err(refused(d.key, d.right, &d.left)),
        None => Ok(()),
    }
}

/// Rejects a config whose recipe differs from the saved recipe.
pub(crate) fn must_have_recipe(saved: &Config, given: &Config) -> Result<(), InvalidSetting> {
    let [saved, given] = [saved, given].map(|config| format!("\"{}\"", config.train.recipe));
    match saved == given {
        true => Ok(()),
        false => Err(refused("train.recipe", given, &saved)),
    }
}

fn refused(key: impl Display, found: String, saved: &str) -> InvalidSetting {
    let saved = format!("{saved}, which the run was started with");
    InvalidSetting::new(key, found, saved).hint(format!(
        "a resumed run continues as it was; only {} may differ. `kinegrad train` with option `resume RUN` takes \
         all others from the run itself; for other settings start a new run",
        FREE.join(", ")
    ))
}
