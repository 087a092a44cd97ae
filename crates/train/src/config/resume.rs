//! What may differ between a run's saved config and the one it is resumed with.

use kinegrad_settings::InvalidSetting;

use super::{Config, difference};

/// Keys that may differ, or the tables whose every key may. Where motion lies and how it is fetched
/// and kept changes no batch: that it is the same is checked by itself.
const FREE: [&str; 9] = [
    "train.max_steps",
    "run.device",
    "checkpoint.*",
    "validation.*",
    "evaluation.*",
    "data.source",
    "data.num_workers",
    "data.cache.*",
    "data.store.*",
];

/// Whether a dotted key may differ when a run is resumed.
pub fn may_differ(key: &str) -> bool {
    FREE.iter().any(|free| kinegrad_data::matches(free, key))
}

/// Rejects a config that would not continue the saved one.
///
/// # Errors
/// Names the first key that differs and may not.
pub fn must_continue(saved: &Config, given: &Config) -> Result<(), InvalidSetting> {
    let mut differences = difference(saved, given).into_iter();
    match differences.find(|d| !may_differ(&d.key)) {
        Some(d) => {
            let saved = format!("{}, which the run was started with", d.left);
            Err(InvalidSetting::new(d.key, d.right, saved).hint(format!(
                "a resumed run continues as it was; only {} may differ. For other settings start \
                 a new run",
                FREE.join(", ")
            )))
        }
        None => Ok(()),
    }
}
