//! Runs on phrases: recipes `diffusion`, `decoder` and `e2e`.

use std::sync::Arc;

use kinegrad_data::{Dataset, Phrase, PhraseSamples};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_motion::phrase::{ACCELERATION, ANGULAR_VELOCITY, POSITION, QUATERNION, VELOCITY};
use kinegrad_motion::{Phrases, Statistics};
use kinegrad_settings::InvalidSetting;

use super::networks::{denoiser, networks};
use super::recipe_name::RecipeName;
use super::recipes::{DecoderRecipe, E2eRecipe, Rollouts, diffusion_recipe};
use super::start::Starts;
use super::{CcMotionConfig, pretrain};
use crate::config::{Config, SystemTables};
use crate::error::Error;
use crate::observer::Observer;
use crate::run::{Material, Outcome, Setup};

/// Trains as the setup's config says.
pub(super) fn train(setup: Setup, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let config = setup.config.clone();
    let own = CcMotionConfig::of(&config)?;
    let setup = setup.with_gradients(own.model.activation_checkpointing);
    let dataset = Dataset::<Phrase>::open_with_progress(&config.data, &*observer.reading())?;
    for warning in &dataset.warnings {
        observer.warning(warning);
    }
    setup.same_dataset(dataset.digest)?;
    let recipe = RecipeName::of(&config)?;
    let pretrains = recipe == RecipeName::E2e && own.init.diffusion.as_os_str().is_empty();
    if setup.dry_run && pretrains {
        pretrain::tell(&config, &setup.folder, observer)?;
        observer.note("these two are not planned: the plan is of the last training alone");
    }
    let planned = setup.dry_run && pretrains;
    let starts_anew = setup.checkpoint.is_none() && !planned;
    let starts = match recipe.trains_through_sampler() && starts_anew {
        false => None,
        true => {
            let mut init = own.init.clone();
            if pretrains {
                init = match pretrain::run(&config, &setup.folder, observer)? {
                    Ok(trained) => trained,
                    Err(interrupted) => return Ok(*interrupted),
                };
            }
            let missing = || {
                let allowed = format!("a trained denoiser for recipe `{}`", recipe.name());
                InvalidSetting::new("init.diffusion", "empty", allowed)
                    .hint("name a run or checkpoint: `--set init.diffusion=runs/phrases`")
            };
            Some(Starts::named(&init)?.ok_or_else(missing)?)
        }
    };
    let statistics = match (&setup.checkpoint, &starts) {
        (Some(checkpoint), _) => checkpoint.state.statistics_of(&Phrases)?.clone(),
        (None, Some(starts)) => starts.statistics()?,
        (None, None) => statistics_of(&dataset, &config)?,
    };
    let normalized = Arc::new(statistics.clone());
    let shared = normalized.clone();
    let samples = move |phrases, config: &Config| {
        PhraseSamples::new(phrases, shared.clone(), &config.data, config.run.seed)
    };
    let diffusion = GaussianDiffusion::new(&own.diffusion)?;
    let (material, held_out) = Material::new(dataset, statistics.clone(), &config, samples)?;
    let through_sampler = |diffusion| {
        let model = match starts {
            Some(starts) => starts.networks(&config, &setup.device)?,
            // The weights of the checkpoint will replace them.
            None => networks(&config, &statistics, &setup.device)?,
        };
        let rollouts = Rollouts::new(diffusion, &own.rollout, normalized)?;
        Ok::<_, Error>((model, rollouts))
    };
    match recipe {
        RecipeName::Diffusion => {
            let model = denoiser(&config, &setup.device)?;
            let recipe = diffusion_recipe(diffusion, held_out);
            setup.train(material, recipe, model, observer)
        }
        RecipeName::Decoder => {
            let (model, rollouts) = through_sampler(diffusion)?;
            let recipe = DecoderRecipe::new(rollouts, &own.loss, held_out);
            setup.train(material, recipe, model, observer)
        }
        RecipeName::E2e => {
            let (model, rollouts) = through_sampler(diffusion)?;
            let recipe = E2eRecipe::new(rollouts, &own.loss, held_out);
            setup.train(material, recipe, model, observer)
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
