//! The initial checkpoints of fine-tuning: `init.diffusion` and `init.decoder`.

use std::fs::canonicalize;

use burn::tensor::Device;
use kinegrad_data::{DataConfig, DataKind};
use kinegrad_models::parameters;
use kinegrad_motion::{OrientationEncoding, Phrases};
use kinegrad_settings::{Refused, require};
use kinegrad_train::Error;
use kinegrad_train::checkpoint::{State, Weights};
use kinegrad_train::config::{Config, PLAIN};
use kinegrad_train::start::{Start, must_agree};
use toml::Table;

use super::load::{Trained, decoder, denoiser, targets, trainable, unet1d};
use super::recipe_name::RecipeName;
use super::{CcMotion, CcMotionConfig, InitConfig};
use crate::network::{Beats, MotionModel};

/// Tables inherited from the run `init.diffusion`.
pub(super) const OF_BASE: [&str; 2] = ["model", "diffusion"];

/// Tables inherited from the run `init.decoder`.
pub(super) const OF_DECODER: [&str; 1] = ["decoder"];

/// The initial checkpoints of fine-tuning.
#[derive(Clone, Debug)]
pub(crate) struct Starts {
    diffusion: Start,
    decoder: Option<Start>,
}

impl Starts {
    /// The checkpoints that `init` names; `None` if `init.diffusion` is empty.
    pub fn named(init: &InitConfig) -> Result<Option<Self>, Error> {
        let Some(diffusion) = Start::named("init.diffusion", &init.diffusion, &CcMotion)? else {
            return Ok(None);
        };
        let decoder = Start::named("init.decoder", &init.decoder, &CcMotion)?;
        Ok(Some(Self { diffusion, decoder }))
    }

    /// Defaults of the new config: the tables of networks and process. The base model's split and
    /// labels are added if it was trained on the dataset of `config`, so that none of its training
    /// items is held out.
    pub fn tables_for(&self, config: &Config) -> Table {
        let mut tables = self.diffusion.tables(&OF_BASE);
        if let Some(decoder) = &self.decoder {
            tables.extend(decoder.tables(&OF_DECODER));
        }
        let base = &self.diffusion.state().config.data;
        if is_of_one_source(base, &config.data) {
            let split = Table::try_from(&base.validation).expect(PLAIN);
            let mut data = Table::from_iter([("validation".to_string(), split.into())]);
            if !base.labels.is_empty() {
                let labels = Table::try_from(&base.labels).expect(PLAIN);
                data.insert("labels".into(), labels.into());
            }
            tables.insert("data".into(), data.into());
        }
        tables
    }

    /// The state of the denoiser's checkpoint, for models of phrases.
    pub fn state(&self) -> Result<&State, Error> {
        let state = self.diffusion.state();
        state.statistics_of(&Phrases)?;
        Ok(state)
    }

    /// Key and state of each checkpoint.
    pub fn states(&self) -> impl Iterator<Item = (&'static str, &State)> {
        let starts = [Some(&self.diffusion), self.decoder.as_ref()];
        let starts = starts.into_iter().flatten();
        starts.map(|start| (start.key, start.state()))
    }

    /// The networks with the EMA weights of the initial checkpoints, on an autodiff device.
    pub fn networks(&self, config: &Config, device: &Device) -> Result<MotionModel, Error> {
        let load = |saved: &_| Trained::load(saved, Weights::Ema, device);
        let base = self.diffusion.load(load)?;
        must_agree(config, &base.state.config, &OF_BASE)?;
        must_have_features(config, &base.state.config)?;
        base.state.statistics_of(&Phrases)?;
        let statistics = base.state.normalization();
        // Uses dropout and coherence of this config with the weights of the initial checkpoints.
        let unet = parameters::replace(denoiser(config, device)?, parameters::values(&base.unet));
        let mut decoder = decoder(config, statistics, device)?;
        if let Some(given) = &self.decoder {
            let start = given.load(load)?;
            let Some(trained) = start.decoder else {
                return Err(given.refused(&"its recipe is `diffusion`, it contains no decoder"));
            };
            must_agree(config, &start.state.config, &OF_DECODER)?;
            let found = start.state.normalization();
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

/// Rejects a config with other audio features than the initial model's config.
fn must_have_features(config: &Config, start: &Config) -> Result<(), Error> {
    let [given, start] = [config, start]
        .map(|config| serde_json::to_string(&config.data.audio_features).unwrap_or_default());
    let allowed = format!("{start}, which the run it starts from has");
    let agree = require(given == start, "data.audio_features", given, allowed);
    Ok(agree.hint("the network takes as many features as it was trained with")?)
}

/// True if two runs read the same dataset, with any split.
pub(super) fn is_of_one_source(a: &DataConfig, b: &DataConfig) -> bool {
    a.kind == b.kind
        && match a.kind {
            DataKind::Synthetic => a.synthetic == b.synthetic,
            _ => {
                // Compares folders by their canonical paths.
                let place = |source: &str| canonicalize(source).unwrap_or_else(|_| source.into());
                let [a, b] = [a, b].map(|data| data.source.as_deref().map(place));
                a.is_some() && a == b
            }
        }
}

/// Rejects keys that a new run would not use.
pub(super) fn must_use(config: &Config) -> Result<(), Error> {
    let (recipe, init) = (RecipeName::of(config), &config.own::<CcMotionConfig>().init);
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
    let unet = unet1d(config);
    let learns = unet.beats == Beats::Given || config.data.audio_layout().beats;
    let found = "\"tracked\" without known beats";
    let allowed = "\"given\", or `data.audio_features = [\"ccmotion\", \"beats\"]`";
    require(learns, "model.beats", found, allowed)
        .hint("the tracker learns from the beats of the training songs; samples need none")?;
    let noise = config.data.augment.audio_noise;
    let learns = unet.beats == Beats::Given || noise == 0.0;
    let allowed = "0 with `model.beats = \"tracked\"`";
    require(learns, "data.augment.audio_noise", noise, allowed)
        .hint("the tracker would learn from beats with noise; `audio_masks` vary the music")?;
    let (orientation, augment) = (targets(config).orientation, &config.data.augment);
    let flips = augment.flip_quaternion && orientation != OrientationEncoding::Quaternion;
    let of_one_sign = "false with this `model.orientation_target`";
    require(!flips, "data.augment.flip_quaternion", true, of_one_sign)
        .hint("q and -q are one rotation, and one target: there is nothing to learn from both")?;
    let turns = augment.rotate_yaw && orientation == OrientationEncoding::CanonicalQuaternion;
    let turned_back = "false with `model.orientation_target = \"canonical_quaternion\"`";
    require(!turns, "data.augment.rotate_yaw", true, turned_back)
        .hint("each sample is turned to face +z, which undoes the rotation")?;
    Ok(())
}
