//! Starting from a trained model (`init.*`), shared by all systems.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use kinegrad_settings::InvalidSetting;
use toml::Table;

use crate::checkpoint::{State, Weights, resolve_checkpoint};
use crate::config::{self, Config, SystemTables};
use crate::error::Error;

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
    key: &'static str,
    path: PathBuf,
}

impl Start {
    /// The best checkpoint of the run, or the checkpoint, that `key` names; none where the path is
    /// empty.
    ///
    /// # Errors
    /// If it is not there.
    pub fn named(key: &'static str, path: &Path) -> Result<Option<Self>, Error> {
        if path.as_os_str().is_empty() {
            return Ok(None);
        }
        let found = resolve_checkpoint(path, |_| {});
        let path = found.map_err(|error| refused(key, path, &error))?;
        Ok(Some(Self { key, path }))
    }

    /// The key that names it.
    pub fn key(&self) -> &'static str {
        self.key
    }

    /// Config, step, statistics.
    ///
    /// # Errors
    /// If the checkpoint is damaged.
    pub fn state(&self) -> Result<State, Error> {
        State::read(&self.path)
    }

    /// What `load` makes of the averaged weights on `device`.
    ///
    /// # Errors
    /// Names the key and why the checkpoint does not fit.
    pub fn load<T>(
        &self,
        device: &Device,
        load: impl FnOnce(&Path, Weights, &Device) -> Result<T, Error>,
    ) -> Result<T, Error> {
        load(&self.path, Weights::Ema, device).map_err(|error| self.refused(&error))
    }

    /// The tables `names` of its config, every key written out.
    ///
    /// # Errors
    /// If the checkpoint is damaged, or of another system.
    pub fn tables<T: SystemTables>(&self, names: &[&str]) -> Result<Table, Error> {
        let config = self.state()?.config;
        tables_of::<T>(&config, names).map_err(|error| {
            let reason = format!("its recipe is `{}`: {error}", config.train.recipe);
            self.refused(&reason)
        })
    }

    /// The error of a checkpoint that cannot be started from.
    pub fn refused(&self, reason: &dyn Display) -> Error {
        refused(self.key, &self.path, reason)
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

/// The tables `names` of a config, every key written out.
///
/// # Errors
/// If the config is of another version and cannot be read.
pub fn tables_of<T: SystemTables>(config: &Config, names: &[&str]) -> Result<Table, Error> {
    let tables = T::of(config)?.to_table().into_iter();
    let tables = tables.filter(|(name, _)| names.contains(&name.as_str()));
    Ok(tables.collect())
}

/// Rejects a config whose networks or process, the tables `names`, are not those of its start.
///
/// # Errors
/// Names the first key that differs.
pub fn must_agree<T: SystemTables>(
    config: &Config,
    start: &Config,
    names: &[&str],
) -> Result<(), Error> {
    let (start, given) = (
        tables_of::<T>(start, names)?,
        tables_of::<T>(config, names)?,
    );
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
