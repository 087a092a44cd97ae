//! A run whose request has been checked, up to its end.

use std::fs::{self, File};
use std::path::PathBuf;
use std::sync::Arc;

use burn::module::Module;
use burn::tensor::Device;
use kinegrad_data::{Dataset, Loader};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_models::{MotionModel, parameters};
use kinegrad_motion::TrainingStatistics;

use super::Outcome;
use super::folder::write_config;
use crate::checkpoint::{Checkpoint, Checkpoints};
use crate::config::{Config, Recipe};
use crate::error::Error;
use crate::observer::{Observer, RunSummary};
use crate::recipes::{self, HeldOut, Sampler};
use crate::start::Starts;
use crate::trained::networks;
use crate::trainer::restore::check_moments;
use crate::trainer::{Trainer, TrainerParts};

/// A run whose request has been checked.
pub(super) struct Setup {
    pub config: Config,
    pub folder: PathBuf,
    /// Taken already where the run existed before.
    pub lock: Option<File>,
    pub dataset: Dataset,
    pub statistics: Arc<TrainingStatistics>,
    pub device: Device,
    pub device_name: String,
}

impl Setup {
    /// The held-out phrases, in memory from now on.
    pub fn held_out(&self) -> Result<HeldOut, Error> {
        Ok(HeldOut::new(
            self.dataset.validation.load()?,
            self.statistics.clone(),
            &self.config.validation,
            self.config.data.target_frames,
        ))
    }

    pub fn sampler(&self) -> Result<Sampler, Error> {
        let diffusion = GaussianDiffusion::new(&self.config.diffusion)?;
        let statistics = self.statistics.clone();
        Ok(Sampler::new(diffusion, &self.config.rollout, statistics))
    }

    /// Denoiser and decoder, with the weights of `starts`; without, those of a checkpoint will
    /// replace them.
    pub fn networks(&self, starts: Option<Starts>) -> Result<MotionModel, Error> {
        let (config, device) = (&self.config, &self.device);
        match starts {
            Some(starts) => starts.networks(config, device),
            None => {
                let model = networks(config, &self.statistics, device)?;
                Ok(match config.train.recipe {
                    Recipe::Decoder => MotionModel {
                        unet: model.unet.no_grad(),
                        decoder: model.decoder,
                    },
                    Recipe::Diffusion | Recipe::E2e => model,
                })
            }
        }
    }

    /// Trains to the end, or until stopped; nothing but the record of the best step is written before.
    pub fn train<R: recipes::Recipe>(
        self,
        recipe: R,
        mut model: R::Model,
        checkpoint: Option<Checkpoint>,
        observer: &mut dyn Observer,
    ) -> Result<Outcome, Error> {
        if let Some(checkpoint) = &checkpoint {
            model = parameters::load(model, checkpoint.model.clone())?;
            let path = Checkpoints::of(&self.folder).step_path(checkpoint.state.step);
            check_moments(&model, checkpoint, &path)?;
        }
        let Self {
            mut config,
            folder,
            lock,
            dataset,
            statistics,
            device,
            device_name,
        } = self;
        let step = checkpoint
            .as_ref()
            .map_or(0, |checkpoint| checkpoint.state.step);
        let progress = checkpoint
            .as_ref()
            .map(|c| c.state.progress.clone())
            .unwrap_or_default();
        let summary = RunSummary {
            name: config.run.name.clone(),
            folder: folder.clone(),
            device: device_name,
            parameters: parameters::infos(&model)
                .iter()
                .map(|info| info.len())
                .sum(),
            train_phrases: dataset.train.len(),
            validation_phrases: dataset.validation.len(),
            skipped: dataset.skipped.clone(),
            step,
            max_steps: config.train.max_steps,
        };
        let checkpoints = Checkpoints::of(&folder);
        if checkpoint.is_some() && checkpoints.best() != progress.best() {
            // All that is written before anything can be refused: a crash came between the checkpoint and the record of its being the best.
            checkpoints.set_best(progress.best().as_ref())?;
        }
        let patience = config.train.patience;
        let stopped = patience > 0 && progress.validations_since_best >= patience;
        if step > 0 && (step >= config.train.max_steps || stopped) {
            observer.started(&summary);
            return Ok(Outcome {
                folder,
                ending: None,
                step,
                progress,
                config,
            });
        }

        // Everything that can be refused has been: only now is something written.
        fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
        let lock = match lock {
            Some(lock) => lock,
            None => super::folder::lock(&folder)?,
        };
        write_config(&folder, &config)?;
        observer.started(&summary);

        if config.validation.every_steps > 0 && dataset.validation.is_empty() {
            observer.warning("no phrase is held out: there is no validation and no best step");
            config.validation.every_steps = 0;
        }
        let loader = Loader::new(
            dataset.train,
            statistics.clone(),
            &config.data,
            config.run.seed,
            step * config.train.gradient_accumulation_steps,
        );
        let parts = TrainerParts {
            recipe,
            model,
            config: config.clone(),
            statistics,
            device,
            loader,
            dataset: dataset.digest,
            folder: folder.clone(),
        };
        let mut trainer = Trainer::new(parts, checkpoint)?;
        let ending = trainer.run(observer)?;
        drop(lock);
        let (step, progress) = (trainer.step(), trainer.progress().clone());
        Ok(Outcome {
            folder,
            ending: Some(ending),
            step,
            progress,
            config,
        })
    }
}
