//! The initial checkpoints of fine-tuning: `init.diffusion` and `init.decoder`.

use std::path::{Path, PathBuf};

use burn::module::Module;
use burn::tensor::Device;
use kinegrad_models::{MotionModel, parameters};
use kinegrad_motion::{Phrases, Statistics};
use toml::Table;

use super::networks::{Trained, decoder, denoiser, with_adapters};
use super::{CcMotionConfig, DECODER};
use crate::checkpoint::{State, Weights};
use crate::config::{Config, SystemTables};
use crate::error::Error;
use crate::start::{must_agree, named, refused, tables_of, values};

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
        let init = CcMotionConfig::of(config)?.init;
        let Some(diffusion) = named("init.diffusion", &init.diffusion)? else {
            return Ok(None);
        };
        let decoder = named("init.decoder", &init.decoder)?;
        Ok(Some(Self { diffusion, decoder }))
    }

    /// The best checkpoints of these runs, or these checkpoints.
    ///
    /// # Errors
    /// If one is not there.
    pub fn at(diffusion: &Path, decoder: Option<&Path>) -> Result<Self, Error> {
        let found =
            |key, path| named(key, path)?.ok_or_else(|| refused(key, path, &"the path is empty"));
        Ok(Self {
            diffusion: found("init.diffusion", diffusion)?,
            decoder: decoder
                .map(|path| found("init.decoder", path))
                .transpose()?,
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
        inherited(&base, decoder.as_ref())
    }

    /// The statistics that the denoiser's data were normalised by.
    ///
    /// # Errors
    /// If the checkpoint is damaged.
    pub fn statistics(&self) -> Result<Statistics, Error> {
        Ok(State::read(&self.diffusion)?
            .statistics_of(&Phrases)?
            .clone())
    }

    /// The networks with the start's averaged weights on an autodiff device.
    ///
    /// # Errors
    /// Names the key whose checkpoint does not fit, and why.
    pub fn networks(&self, config: &Config, device: &Device) -> Result<MotionModel, Error> {
        let base = Trained::load(&self.diffusion, Weights::Ema, device)
            .map_err(|error| refused("init.diffusion", &self.diffusion, &error))?;
        must_agree::<CcMotionConfig>(config, &base.state.config, &["model", "diffusion"])?;
        let statistics = base.state.statistics_of(&Phrases)?;
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
                must_agree::<CcMotionConfig>(config, &start.state.config, &["decoder"])?;
                let found = start.state.statistics_of(&Phrases)?;
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
        let unet = match config.train.recipe == DECODER {
            true => unet.no_grad(),
            false => unet,
        };
        with_adapters(MotionModel { unet, decoder }, config, device)
    }
}

/// The tables `model` and `diffusion` of `base` and `decoder` of `decoder`.
///
/// # Errors
/// If a config is of another version and cannot be read.
pub(super) fn inherited(base: &Config, decoder: Option<&Config>) -> Result<Table, Error> {
    let mut tables = tables_of::<CcMotionConfig>(base, &["model", "diffusion"])?;
    if let Some(decoder) = decoder {
        tables.extend(tables_of::<CcMotionConfig>(decoder, &["decoder"])?);
    }
    Ok(tables)
}
