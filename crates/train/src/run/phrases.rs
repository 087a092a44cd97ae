//! Runs on phrases: recipes `diffusion`, `decoder` and `e2e`.

use std::sync::Arc;

use burn::module::Module;
use burn::tensor::Device;
use kinegrad_data::{Dataset, Loader};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_models::MotionModel;
use kinegrad_motion::TrainingStatistics;

use super::setup::{Material, Setup};
use super::{Outcome, pretrain, same_dataset};
use crate::config::{Config, Recipe};
use crate::error::Error;
use crate::observer::Observer;
use crate::recipes::{DecoderRecipe, DiffusionRecipe, E2eRecipe, HeldOut, Sampler};
use crate::start::Starts;
use crate::trained::{denoiser, networks};

/// Trains as the setup's config says.
pub(super) fn train(setup: Setup, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let config = setup.config.clone();
    let dataset = Dataset::open_with_progress(&config.data, &*observer.reading())?;
    for warning in &dataset.warnings {
        observer.warning(warning);
    }
    same_dataset(dataset.digest, setup.checkpoint.as_ref())?;
    let starts = match config.train.recipe {
        Recipe::Diffusion => None,
        _ if setup.checkpoint.is_some() => None,
        recipe => match (Starts::named(&config)?, recipe) {
            (Some(starts), _) => Some(starts),
            (None, Recipe::E2e) => match pretrain::run(&config, &setup.folder, observer)? {
                Ok(starts) => Some(starts),
                Err(interrupted) => return Ok(*interrupted),
            },
            (None, _) => return Err(Error::NoStart { recipe: "decoder" }),
        },
    };
    let statistics = match (&setup.checkpoint, &starts) {
        (Some(checkpoint), _) => checkpoint.state.statistics.phrases()?.clone(),
        (None, Some(starts)) => starts.statistics()?,
        (None, None) => statistics_of(&dataset, &config)?,
    };
    let phrases = Phrases {
        statistics: Arc::new(statistics),
        device: setup.device.clone(),
        dataset,
        config,
    };
    let (config, device) = (&phrases.config, &phrases.device);
    match config.train.recipe {
        Recipe::Decoder => {
            let model = phrases.networks(starts)?;
            let held_out = phrases.held_out()?;
            let recipe = DecoderRecipe::new(phrases.sampler()?, &config.loss, held_out);
            setup.train(phrases.material(), recipe, model, observer)
        }
        Recipe::E2e => {
            let model = phrases.networks(starts)?;
            let held_out = phrases.held_out()?;
            let recipe = E2eRecipe::new(phrases.sampler()?, &config.loss, held_out);
            setup.train(phrases.material(), recipe, model, observer)
        }
        Recipe::Diffusion | Recipe::GmdMotion | Recipe::GmdTrajectory => {
            let model = denoiser(config, device)?;
            let diffusion = GaussianDiffusion::new(&config.diffusion)?;
            let recipe = DiffusionRecipe::new(diffusion, phrases.held_out()?);
            setup.train(phrases.material(), recipe, model, observer)
        }
    }
}

/// What the recipes on phrases are made from.
struct Phrases {
    config: Config,
    dataset: Dataset,
    statistics: Arc<TrainingStatistics>,
    device: Device,
}

impl Phrases {
    /// The held-out phrases, in memory from now on.
    fn held_out(&self) -> Result<HeldOut, Error> {
        Ok(HeldOut::new(
            self.dataset.validation.load()?,
            self.statistics.clone(),
            &self.config.validation,
            self.config.data.target_frames,
        ))
    }

    fn sampler(&self) -> Result<Sampler, Error> {
        let diffusion = GaussianDiffusion::new(&self.config.diffusion)?;
        let statistics = self.statistics.clone();
        Ok(Sampler::new(diffusion, &self.config.rollout, statistics))
    }

    /// Denoiser and decoder, with the weights of `starts`; without, those of a checkpoint will
    /// replace them.
    fn networks(&self, starts: Option<Starts>) -> Result<MotionModel, Error> {
        let (config, device) = (&self.config, &self.device);
        if let Some(starts) = starts {
            return starts.networks(config, device);
        }
        let model = networks(config, &self.statistics, device)?;
        Ok(match config.train.recipe {
            Recipe::Decoder => MotionModel {
                unet: model.unet.no_grad(),
                decoder: model.decoder,
            },
            _ => model,
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
            statistics: (*statistics).clone().into(),
            loader: Box::new(move |config, first_batch| {
                let (data, seed) = (&config.data, config.run.seed);
                Loader::new(dataset.train, statistics, data, seed, first_batch)
            }),
        }
    }
}

/// Statistics of the training phrases as stored; augmentation widens their ranges only.
fn statistics_of(dataset: &Dataset, config: &Config) -> Result<TrainingStatistics, Error> {
    let mut statistics = dataset.train.statistics()?;
    if config.data.augment.rotate_yaw {
        statistics.widen_ranges_for_yaw();
    }
    Ok(statistics)
}
