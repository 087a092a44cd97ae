//! What a fine-tuning starts from: `init.diffusion` and `init.decoder`.

use std::path::{Path, PathBuf};

use burn::module::Module;
use burn::tensor::Device;
use kinegrad_models::{MotionModel, parameters};
use kinegrad_motion::TrainingStatistics;
use toml::{Table, Value};

use crate::checkpoint::{State, Weights};
use crate::config::{self, Config, Recipe};
use crate::error::Error;
use crate::generate::resolve_checkpoint;
use crate::trained::{Trained, decoder, denoiser, with_adapters};

/// Keys that a fine-tuning may set anew, as the weights fit whatever they say.
const FREE_KEYS: [&str; 8] = [
    "model.dropout",
    "model.activation_checkpointing",
    "diffusion.cond_drop_prob",
    "diffusion.loss_type",
    "diffusion.snr_gamma",
    "decoder.dropout",
    "decoder.coherence",
    "decoder.init",
];

/// The checkpoints that a fine-tuning starts from.
#[derive(Clone, Debug)]
pub(crate) struct Starts {
    diffusion: PathBuf,
    decoder: Option<PathBuf>,
}

impl Starts {
    /// The checkpoints that `init.*` of `config` names; none where `init.diffusion` is empty.
    ///
    /// # Errors
    /// If one is not there.
    pub fn named(config: &Config) -> Result<Option<Self>, Error> {
        let init = &config.init;
        if init.diffusion.as_os_str().is_empty() {
            return Ok(None);
        }
        let decoder = (!init.decoder.as_os_str().is_empty()).then_some(init.decoder.as_path());
        Self::at(&init.diffusion, decoder).map(Some)
    }

    /// The best checkpoints of these runs, or these checkpoints.
    ///
    /// # Errors
    /// If one is not there.
    pub fn at(diffusion: &Path, decoder: Option<&Path>) -> Result<Self, Error> {
        let find = |key: &'static str, path: &Path| {
            resolve_checkpoint(path, |_| {}).map_err(|error| refused(key, path, &error))
        };
        Ok(Self {
            diffusion: find("init.diffusion", diffusion)?,
            decoder: decoder.map(|path| find("init.decoder", path)).transpose()?,
        })
    }

    /// What the start's configs say of networks and process: it stands beneath the new config.
    ///
    /// # Errors
    /// If a checkpoint is damaged.
    pub fn tables(&self) -> Result<Table, Error> {
        let base = State::read(&self.diffusion)?.config;
        let decoder = match &self.decoder {
            Some(path) => Some(State::read(path)?.config),
            None => None,
        };
        Ok(tables_of(&base, decoder.as_ref()))
    }

    /// The statistics that the denoiser's data were normalised by.
    ///
    /// # Errors
    /// If the checkpoint is damaged.
    pub fn statistics(&self) -> Result<TrainingStatistics, Error> {
        Ok(State::read(&self.diffusion)?.statistics.phrases()?.clone())
    }

    /// The networks with the start's averaged weights on an autodiff device.
    ///
    /// # Errors
    /// Names the key whose checkpoint does not fit, and why.
    pub fn networks(&self, config: &Config, device: &Device) -> Result<MotionModel, Error> {
        let base = Trained::load(&self.diffusion, Weights::Ema, device)
            .map_err(|error| refused("init.diffusion", &self.diffusion, &error))?;
        must_agree(config, &base.state.config, &["model", "diffusion"])?;
        let statistics = base.state.statistics.phrases()?;
        // Networks of this config, whose dropout and coherence may be others, with the values of
        // the start.
        let unet = parameters::replace(denoiser(config, device)?, values(&base.unet));
        let fresh = decoder(config, statistics, device)?;
        let decoder = match &self.decoder {
            None => fresh,
            Some(path) => {
                let refused =
                    |reason: &dyn std::fmt::Display| refused("init.decoder", path, reason);
                let start = Trained::load(path, Weights::Ema, device).map_err(|e| refused(&e))?;
                let Some(decoder) = start.decoder else {
                    return Err(refused(&"its recipe is `diffusion`, it holds no decoder"));
                };
                must_agree(config, &start.state.config, &["decoder"])?;
                let found = start.state.statistics.phrases()?;
                let same = found.mean == statistics.mean && found.std == statistics.std;
                if !same {
                    return Err(refused(
                        &"its latents were normalised by other statistics than those of \
                          `init.diffusion`",
                    ));
                }
                parameters::replace(fresh, values(&decoder))
            }
        };
        let unet = match config.train.recipe {
            Recipe::Decoder => unet.no_grad(),
            _ => unet,
        };
        with_adapters(MotionModel { unet, decoder }, config, device)
    }
}

/// The values of all parameters, in the module's order.
pub(crate) fn values<M: Module>(module: &M) -> Vec<Vec<f32>> {
    let parameters = parameters::export(module).into_iter();
    parameters.map(|parameter| parameter.values).collect()
}

/// The tables `model` and `diffusion` of `base` and `decoder` of `decoder`.
pub(crate) fn tables_of(base: &Config, decoder: Option<&Config>) -> Table {
    let mut tables = take(base, &["model", "diffusion"]);
    if let Some(decoder) = decoder {
        tables.extend(take(decoder, &["decoder"]));
    }
    tables
}

/// What `base` says of the network, process and space of a run on clips.
pub(crate) fn clip_tables_of(base: &Config) -> Table {
    take(base, &["model", "diffusion", "emphasis"])
}

fn take(config: &Config, names: &[&str]) -> Table {
    let mut whole: Table = config::to_toml(config).parse().expect("own output");
    let table = |name: &&str| whole.remove(*name).unwrap_or(Value::Table(Table::new()));
    let tables: Vec<Value> = names.iter().map(table).collect();
    names
        .iter()
        .map(|name| (*name).to_string())
        .zip(tables)
        .collect()
}

/// Refuses a config whose networks or process are not those of its start.
pub(crate) fn must_agree(config: &Config, start: &Config, tables: &[&str]) -> Result<(), Error> {
    let differs = config::difference(start, config).into_iter().find(|d| {
        let table = d.key.split('.').next().unwrap_or_default();
        let free = FREE_KEYS.contains(&d.key.as_str());
        tables.contains(&table) && !free
    });
    match differs {
        None => Ok(()),
        Some(d) => Err(Error::StartDiffers {
            key: d.key,
            start: d.left,
            found: d.right,
        }),
    }
}

pub(crate) fn refused(key: &'static str, path: &Path, reason: &dyn std::fmt::Display) -> Error {
    Error::Start {
        key,
        path: path.to_path_buf(),
        reason: reason.to_string(),
    }
}
