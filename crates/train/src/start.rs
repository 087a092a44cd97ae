//! Starting from a trained model (`init.*`), shared by all systems.

use std::fmt::Display;
use std::path::Path;

use kinegrad_settings::InvalidSetting;
use toml::Table;

use crate::checkpoint::{SavedCheckpoint, State, resolve_checkpoint};
use crate::config::{self, Config};
use crate::error::Error;
use crate::system::System;

/// Keys that fine-tuning may change, because the weights do not depend on them.
const FREE_KEYS: [&str; 9] = [
    "model.dropout",
    "model.activation_checkpointing",
    "diffusion.cond_drop_prob",
    "diffusion.style_drop_prob",
    "diffusion.loss_type",
    "diffusion.snr_gamma",
    "decoder.dropout",
    "decoder.coherence",
    "decoder.init",
];

/// A checkpoint that a key of `init` names.
#[derive(Clone, Debug)]
pub struct Start {
    /// The key that names it.
    pub key: &'static str,
    saved: SavedCheckpoint,
}

impl Start {
    /// The checkpoint, or the best checkpoint of the run, in `path`; `None` if the path is empty.
    ///
    /// # Errors
    /// If the checkpoint is missing, damaged, or of another system.
    pub fn named(
        key: &'static str,
        path: &Path,
        system: &dyn System,
    ) -> Result<Option<Self>, Error> {
        if path.as_os_str().is_empty() {
            return Ok(None);
        }
        let refused = |error| refused(key, path, &error);
        let saved = resolve_checkpoint(path, |_| {}).map_err(refused)?;
        let saved = system.read_tables(saved).map_err(refused)?;
        Ok(Some(Self { key, saved }))
    }

    /// Config, step, statistics.
    pub fn state(&self) -> &State {
        &self.saved.state
    }

    /// The network that `load` reads from the checkpoint.
    ///
    /// # Errors
    /// Names the key and the mismatch.
    pub fn load<T>(
        &self,
        load: impl FnOnce(&SavedCheckpoint) -> Result<T, Error>,
    ) -> Result<T, Error> {
        load(&self.saved).map_err(|error| self.refused(&error))
    }

    /// The tables `names` of the checkpoint's config, with every key.
    pub fn tables(&self, names: &[&str]) -> Table {
        tables_of(&self.saved.state.config, names)
    }

    /// The error for an unusable checkpoint.
    pub fn refused(&self, reason: &dyn Display) -> Error {
        refused(self.key, &self.saved.path, reason)
    }
}

fn refused(key: &str, path: &Path, reason: &dyn Display) -> Error {
    let path = path.display();
    Error::usage(
        format!("`{key}` is {path}, which cannot be started from: {reason}"),
        "`init.diffusion` takes a run whose denoiser is of the same recipe, or of phrases for \
         `decoder` and `e2e`; `init.decoder` one of recipe `decoder` or `e2e` made on the same base",
    )
}

/// The tables `names` of the `saved` config of a resumed run, or of the checkpoint
/// `init.diffusion`.
///
/// # Errors
/// As [`Start::named`].
pub fn inherited(
    saved: Option<&Config>,
    init: &Path,
    names: &[&str],
    system: &dyn System,
) -> Result<Option<Table>, Error> {
    // A resumed run does not need its initial checkpoint.
    if let Some(saved) = saved {
        return Ok(Some(tables_of(saved, names)));
    }
    let start = Start::named("init.diffusion", init, system)?;
    Ok(start.map(|start| start.tables(names)))
}

/// The tables `names` of a config, with every key.
pub fn tables_of(config: &Config, names: &[&str]) -> Table {
    let tables = config.system.to_table().into_iter();
    let tables = tables.filter(|(name, _)| names.contains(&name.as_str()));
    tables.collect()
}

/// Rejects a config whose tables `names` (networks or process) differ from those of the checkpoint.
///
/// # Errors
/// Names the first key that differs.
pub fn must_agree(config: &Config, start: &Config, names: &[&str]) -> Result<(), Error> {
    let (start, given) = (tables_of(start, names), tables_of(config, names));
    let mut differences = config::difference(&start, &given).into_iter();
    match differences.find(|d| !FREE_KEYS.contains(&d.key.as_str())) {
        None => Ok(()),
        Some(d) => {
            let start = format!("{}, which the run it starts from has", d.left);
            let refused = InvalidSetting::new(d.key, d.right, start);
            let hint = "leave the key out: it is taken from the run that `init` names";
            Err(refused.hint(hint).into())
        }
    }
}
