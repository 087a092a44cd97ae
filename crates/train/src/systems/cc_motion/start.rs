//! The initial checkpoints of fine-tuning: `init.diffusion` and `init.decoder`.

use burn::tensor::Device;
use kinegrad_data::AugmentConfig;
use kinegrad_models::{MotionModel, parameters};
use kinegrad_motion::{Phrases, Statistics};
use kinegrad_settings::{Refused, require};
use toml::Table;

use super::networks::{Trained, decoder, denoiser, trainable};
use super::recipe_name::RecipeName;
use super::{CcMotionConfig, InitConfig};
use crate::config::{Config, SystemTables};
use crate::error::Error;
use crate::start::{Start, must_agree, tables_of};

/// Tables that follow from the run that `init.diffusion` names.
const OF_BASE: [&str; 2] = ["model", "diffusion"];

/// Tables that follow from the run that `init.decoder` names.
const OF_DECODER: [&str; 1] = ["decoder"];

/// The checkpoints that a fine-tuning starts from.
#[derive(Clone, Debug)]
pub(crate) struct Starts {
    diffusion: Start,
    decoder: Option<Start>,
}

impl Starts {
    /// The checkpoints that `init` names; none where `init.diffusion` is empty.
    ///
    /// # Errors
    /// If one is not there.
    pub fn named(init: &InitConfig) -> Result<Option<Self>, Error> {
        let Some(diffusion) = Start::named("init.diffusion", &init.diffusion)? else {
            return Ok(None);
        };
        let decoder = Start::named("init.decoder", &init.decoder)?;
        Ok(Some(Self { diffusion, decoder }))
    }

    /// What the start's configs say of networks and process: it stands beneath the new config.
    ///
    /// # Errors
    /// If a checkpoint is damaged.
    pub fn tables(&self) -> Result<Table, Error> {
        let mut tables = self.diffusion.tables::<CcMotionConfig>(&OF_BASE)?;
        if let Some(decoder) = &self.decoder {
            tables.extend(decoder.tables::<CcMotionConfig>(&OF_DECODER)?);
        }
        Ok(tables)
    }

    /// The statistics that the denoiser's data were normalised by, and how they were augmented.
    ///
    /// # Errors
    /// If the checkpoint is damaged.
    pub fn statistics(&self) -> Result<(Statistics, AugmentConfig), Error> {
        let state = self.diffusion.state()?;
        let statistics = state.statistics_of(&Phrases)?.clone();
        Ok((statistics, state.config.data.augment.clone()))
    }

    /// The networks with the start's averaged weights on an autodiff device.
    ///
    /// # Errors
    /// Names the key whose checkpoint does not fit, and why.
    pub fn networks(&self, config: &Config, device: &Device) -> Result<MotionModel, Error> {
        let base = self.diffusion.load(device, Trained::load)?;
        must_agree::<CcMotionConfig>(config, &base.state.config, &OF_BASE)?;
        must_hear(config, &base.state.config)?;
        let statistics = base.state.statistics_of(&Phrases)?;
        // Networks of this config, whose dropout and coherence may be others, with the values of
        // the start.
        let unet = parameters::replace(denoiser(config, device)?, parameters::values(&base.unet));
        let mut decoder = decoder(config, statistics, device)?;
        if let Some(given) = &self.decoder {
            let start = given.load(device, Trained::load)?;
            let Some(trained) = start.decoder else {
                return Err(given.refused(&"its recipe is `diffusion`, it holds no decoder"));
            };
            must_agree::<CcMotionConfig>(config, &start.state.config, &OF_DECODER)?;
            let found = start.state.statistics_of(&Phrases)?;
            if (&found.mean, &found.std) != (&statistics.mean, &statistics.std) {
                return Err(given.refused(
                    &"its latents were normalised by other statistics than those of \
                      `init.diffusion`",
                ));
            }
            decoder = parameters::replace(decoder, parameters::values(&trained));
        }
        trainable(MotionModel { unet, decoder }, config, device)
    }
}

/// Rejects a config whose model hears other audio features than its start.
///
/// # Errors
/// Names `data.audio_features`, and what the start has.
fn must_hear(config: &Config, start: &Config) -> Result<(), Error> {
    let [given, start] = [config, start]
        .map(|config| serde_json::to_string(&config.data.audio_features).unwrap_or_default());
    let allowed = format!("{start}, which the run it starts from has");
    let agree = require(given == start, "data.audio_features", given, allowed);
    Ok(agree.hint("the network takes as many features as it was trained with")?)
}

/// Rejects keys of `init` that the recipe of a new run would not use.
///
/// # Errors
/// Names the first.
pub(super) fn must_use(config: &Config) -> Result<(), Error> {
    let (recipe, init) = (RecipeName::of(config)?, CcMotionConfig::of(config)?.init);
    let name = recipe.name();
    for (key, path) in [
        ("init.diffusion", &init.diffusion),
        ("init.decoder", &init.decoder),
    ] {
        let used = recipe.trains_through_sampler() || path.as_os_str().is_empty();
        let found = format!("\"{}\"", path.display());
        let allowed = format!("a run to start from for recipes `decoder` and `e2e`, not `{name}`");
        require(used, key, found, allowed).hint(format!(
            "leave the key out: recipe `{name}` starts from new weights"
        ))?;
    }
    Ok(())
}

/// What the config of a resumed run says of networks and process.
///
/// # Errors
/// If the config is of another version and cannot be read.
pub(super) fn inherited(saved: &Config) -> Result<Table, Error> {
    tables_of::<CcMotionConfig>(saved, &[OF_BASE.as_slice(), &OF_DECODER].concat())
}
