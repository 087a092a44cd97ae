//! Runs on phrases: recipes `diffusion`, `decoder` and `e2e`.

use std::sync::Arc;

use burn::module::Module;
use burn::tensor::Device;
use kinegrad_data::{Dataset, Loader, Phrase, PhraseSamples};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_models::MotionModel;
use kinegrad_motion::phrase::{ACCELERATION, ANGULAR_VELOCITY, POSITION, QUATERNION, VELOCITY};
use kinegrad_motion::{self as motion, Statistics};
use kinegrad_settings::InvalidSetting;

use super::networks::{denoiser, networks};
use super::recipes::{DecoderRecipe, DiffusionRecipe, E2eRecipe, Sampler};
use super::start::Starts;
use super::{CcMotionConfig, DECODER, DIFFUSION, E2E, pretrain};
use crate::config::{Config, SystemTables};
use crate::denoising::HeldOut;
use crate::error::Error;
use crate::observer::Observer;
use crate::run::{Material, Outcome, Setup};

/// Trains as the setup's config says.
pub(super) fn train(setup: Setup, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let config = setup.config.clone();
    let own = CcMotionConfig::of(&config)?;
    let setup = setup.with_gradients(own.model.activation_checkpointing);
    let dataset = Dataset::open_with_progress(&config.data, &*observer.reading())?;
    for warning in &dataset.warnings {
        observer.warning(warning);
    }
    setup.same_dataset(dataset.digest)?;
    let starts = match config.train.recipe.as_str() {
        DIFFUSION => None,
        _ if setup.checkpoint.is_some() => None,
        recipe => match Starts::named(&config)? {
            Some(starts) => Some(starts),
            None if recipe == E2E => match pretrain::run(&config, &setup.folder, observer)? {
                Ok(starts) => Some(starts),
                Err(interrupted) => return Ok(*interrupted),
            },
            None => {
                let allowed = format!("a trained denoiser for recipe `{recipe}`");
                let refused = InvalidSetting::new("init.diffusion", "empty", allowed);
                let hint = "name a run or checkpoint: `--set init.diffusion=runs/phrases`";
                return Err(refused.hint(hint).into());
            }
        },
    };
    let statistics = match (&setup.checkpoint, &starts) {
        (Some(checkpoint), _) => checkpoint.state.statistics_of(&motion::Phrases)?.clone(),
        (None, Some(starts)) => starts.statistics()?,
        (None, None) => statistics_of(&dataset, &config)?,
    };
    let phrases = Phrases {
        statistics: Arc::new(statistics),
        device: setup.device.clone(),
        dataset,
        config,
        own,
    };
    let loss = phrases.own.loss.clone();
    match setup.recipe.name {
        DECODER => {
            let model = phrases.networks(starts)?;
            let held_out = phrases.held_out()?;
            let recipe = DecoderRecipe::new(phrases.sampler()?, &loss, held_out);
            setup.train(phrases.material(), recipe, model, observer)
        }
        E2E => {
            let model = phrases.networks(starts)?;
            let held_out = phrases.held_out()?;
            let recipe = E2eRecipe::new(phrases.sampler()?, &loss, held_out);
            setup.train(phrases.material(), recipe, model, observer)
        }
        _ => {
            let model = denoiser(&phrases.config, &phrases.device)?;
            let diffusion = GaussianDiffusion::new(&phrases.own.diffusion)?;
            let recipe = DiffusionRecipe::new(diffusion, phrases.held_out()?);
            setup.train(phrases.material(), recipe, model, observer)
        }
    }
}

/// What the recipes on phrases are made from.
struct Phrases {
    config: Config,
    own: CcMotionConfig,
    dataset: Dataset<Phrase>,
    statistics: Arc<Statistics>,
    device: Device,
}

impl Phrases {
    /// The held-out phrases, in memory from now on.
    fn held_out(&self) -> Result<HeldOut, Error> {
        let phrases = self.dataset.validation.load()?.into();
        let (statistics, data) = (self.statistics.clone(), &self.config.data);
        let samples = PhraseSamples::new(phrases, statistics, data, self.config.run.seed);
        Ok(HeldOut::new(samples, &self.config.validation))
    }

    fn sampler(&self) -> Result<Sampler, Error> {
        let diffusion = GaussianDiffusion::new(&self.own.diffusion)?;
        let statistics = self.statistics.clone();
        Sampler::new(diffusion, &self.own.rollout, statistics)
    }

    /// Denoiser and decoder, with the weights of `starts`; without, those of a checkpoint will
    /// replace them.
    fn networks(&self, starts: Option<Starts>) -> Result<MotionModel, Error> {
        let (config, device) = (&self.config, &self.device);
        if let Some(starts) = starts {
            return starts.networks(config, device);
        }
        let model = networks(config, &self.statistics, device)?;
        Ok(match config.train.recipe == DECODER {
            true => MotionModel {
                unet: model.unet.no_grad(),
                decoder: model.decoder,
            },
            false => model,
        })
    }

    fn material(self) -> Material {
        let Self {
            dataset,
            statistics,
            ..
        } = self;
        Material {
            train: dataset.train.len(),
            validation: dataset.validation.len(),
            skipped: dataset.skipped,
            digest: dataset.digest,
            statistics: (*statistics).clone(),
            loader: Box::new(move |config, first_batch| {
                let (data, seed) = (&config.data, config.run.seed);
                let samples = PhraseSamples::new(dataset.train, statistics, data, seed);
                Loader::new(samples, data, seed, first_batch)
            }),
        }
    }
}

/// Statistics of the training phrases as stored; augmentation widens their ranges only.
fn statistics_of(dataset: &Dataset<Phrase>, config: &Config) -> Result<Statistics, Error> {
    let mut statistics = dataset.statistics()?;
    if config.data.augment.rotate_yaw {
        statistics.widen_range_for_yaw(
            &[POSITION, VELOCITY, ACCELERATION, ANGULAR_VELOCITY],
            QUATERNION,
        );
    }
    Ok(statistics)
}
