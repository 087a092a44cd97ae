//! What may differ between a run's saved config and the one it is resumed with.

use super::{Config, difference};
use crate::Error;

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

/// Refuses a config that would not continue the saved one.
///
/// # Errors
/// [`Error::ResumeDiffers`] for the first key that differs and may not.
pub fn must_continue(saved: &Config, given: &Config) -> Result<(), Error> {
    let mut differences = difference(saved, given).into_iter();
    match differences.find(|d| !may_differ(&d.key)) {
        Some(d) => Err(Error::ResumeDiffers {
            key: d.key,
            saved: d.left,
            given: d.right,
            free: FREE.join(", "),
        }),
        None => Ok(()),
    }
}
