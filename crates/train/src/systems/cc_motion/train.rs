//! Runs on phrases: recipes `diffusion`, `decoder` and `e2e`.

use std::sync::Arc;

use kinegrad_data::{AugmentConfig, Dataset, Phrase, PhraseSamples};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_motion::augment::mirrored_channels;
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
        (None, Some(starts)) => {
            let (mut statistics, augmented) = starts.statistics()?;
            if statistics.movement.is_empty() {
                // Of a start of before it was measured.
                statistics.movement = dataset.statistics()?.movement;
            }
            widened(statistics, &config.data.augment, &augmented)
        }
        (None, None) => widened(
            dataset.statistics_with_progress(&*observer.reading())?,
            &config.data.augment,
            &AugmentConfig::default(),
        ),
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

/// The statistics with the range that augmented phrases reach, which predicted ones are clipped to;
/// `before` is the augmentation that the range takes in already.
fn widened(
    mut statistics: Statistics,
    augment: &AugmentConfig,
    before: &AugmentConfig,
) -> Statistics {
    if augment.mirror {
        statistics.widen_range_for_signs(mirrored_channels());
    }
    if augment.flip_quaternion {
        statistics.widen_range_for_signs(QUATERNION);
    }
    if augment.rotate_yaw && !before.rotate_yaw {
        statistics.widen_range_for_yaw(
            &[POSITION, VELOCITY, ACCELERATION, ANGULAR_VELOCITY],
            QUATERNION,
        );
    }
    statistics
}

#[cfg(test)]
mod tests {
    use kinegrad_motion::{CHANNELS, phrase_statistics, rotate_yaw};
    use kinegrad_motion::{Motion, mirror};

    use super::*;

    /// Phrases that lie to one side in every channel.
    fn phrases() -> Vec<Motion> {
        let value = |i: usize| 0.2 + ((i * 7919) % 101) as f32 / 200.0;
        let phrase =
            |shift: usize| -> Vec<f32> { (0..20 * CHANNELS).map(|i| value(i + shift)).collect() };
        (0..3)
            .map(|n| Motion::new(phrase(n)).expect("whole frames"))
            .collect()
    }

    /// Channels in which a changed phrase leaves the range of the statistics.
    fn cut(statistics: &Statistics, change: impl Fn(&mut Motion)) -> Vec<usize> {
        let [low, high] = statistics.normalized_range().expect("measured");
        let mut cut = Vec::new();
        for mut phrase in phrases() {
            change(&mut phrase);
            let values = statistics.normalize(phrase.as_slice());
            for (channel, row) in values.chunks(20).enumerate() {
                let within = |v: &f32| (low[channel] - 1e-5..=high[channel] + 1e-5).contains(v);
                if !row.iter().all(within) && !cut.contains(&channel) {
                    cut.push(channel);
                }
            }
        }
        cut
    }

    fn flip(phrase: &mut Motion) {
        (0..20).for_each(|t| phrase.set_quaternion(t, phrase.quaternion(t).scale(-1.0)));
    }

    #[test]
    fn each_augmentation_alone_stays_within_the_range_that_it_widens() {
        let measured = phrase_statistics(&phrases()).expect("phrases");
        let none = AugmentConfig::default();
        let with = |set: fn(&mut AugmentConfig)| {
            let mut augment = none.clone();
            set(&mut augment);
            widened(measured.clone(), &augment, &none)
        };
        assert!(!cut(&measured, mirror).is_empty() && !cut(&measured, flip).is_empty());
        let turn = |phrase: &mut Motion| rotate_yaw(phrase, 2.0);
        assert!(!cut(&measured, turn).is_empty());
        assert!(cut(&with(|a| a.mirror = true), mirror).is_empty());
        assert!(cut(&with(|a| a.flip_quaternion = true), flip).is_empty());
        assert!(cut(&with(|a| a.rotate_yaw = true), turn).is_empty());
        // Nothing else is widened.
        assert!(!cut(&with(|a| a.mirror = true), turn).is_empty());
    }

    #[test]
    fn a_range_that_takes_in_rotation_is_not_widened_again() {
        let measured = phrase_statistics(&phrases()).expect("phrases");
        let turned = AugmentConfig {
            rotate_yaw: true,
            ..AugmentConfig::default()
        };
        let once = widened(measured, &turned, &AugmentConfig::default());
        assert_eq!(widened(once.clone(), &turned, &turned), once);
    }
}
