//! Runs on phrases: recipes `diffusion`, `decoder` and `e2e`.

use std::sync::Arc;

use kinegrad_data::{
    AugmentConfig, Dataset, PhraseItem, PhraseSamples, StatisticsOf, target_statistics,
};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_motion::phrase::{ACCELERATION, POSITION, VELOCITY};
use kinegrad_motion::{ChannelEncoding, OrientationEncoding, Phrases, Statistics};
use kinegrad_settings::{InvalidSetting, Refused, require};
use kinegrad_train::checkpoint::State;
use kinegrad_train::config::Config;
use kinegrad_train::run::{Outcome, RunContext, TrainingData};
use kinegrad_train::{Error, Observer};

use super::beat_warnings::{self, HeldOutBeats};
use super::load::{denoiser, networks, targets};
use super::recipe_name::RecipeName;
use super::recipes::{DecoderRecipe, E2eRecipe, Rollouts, diffusion_recipe};
use super::select::{Selecting, Selection};
use super::start::Starts;
use super::{CcMotionConfig, leaks, pretrain, style};
use crate::network::MotionModel;

/// Trains according to the context's config.
pub(super) fn train(context: RunContext, observer: &mut dyn Observer) -> Result<Outcome, Error> {
    let own: CcMotionConfig = context.config.own::<CcMotionConfig>().clone();
    let mut context = context.with_gradients(own.model.activation_checkpointing);
    let (group, reading) = (context.group.clone(), observer.reading());
    let recipe = RecipeName::of(&context.config);
    require(
        own.decoder.use_layer_norm || !recipe.trains_through_sampler() || group.ranks().size() == 1,
        "decoder.use_layer_norm",
        "false",
        "true with several ranks, whose batches have different statistics",
    )
    .hint("LayerNorm normalizes each frame by itself")?;
    let data = &context.config.data;
    let dataset = Dataset::<PhraseItem>::open_among(data, &*observer.reading(), &*context.group)?;
    context.check_dataset(&dataset, observer)?;
    if context.checkpoint.is_none() {
        beat_warnings::warn_of_data(&dataset, &context.config.data, &group, observer)?;
    }
    let config = style::with_labels(context.config.clone(), &dataset, observer)?;
    context.config = config.clone();
    let pretrains = recipe == RecipeName::E2e && own.init.diffusion.as_os_str().is_empty();
    if context.dry_run && pretrains {
        pretrain::announce(&config, &context.folder, observer);
        observer.note("the estimate does not include these two, but only the last training");
    }
    let starts_anew = context.checkpoint.is_none() && !(context.dry_run && pretrains);
    let mut starts = None;
    if recipe.trains_through_sampler() && starts_anew {
        let mut init = own.init.clone();
        if pretrains {
            init = match pretrain::run(&config, &context.folder, &group, observer)? {
                Ok(trained) => trained,
                Err(interrupted) => return Ok(*interrupted),
            };
        }
        let missing = || {
            let allowed = format!("a trained denoiser for recipe `{}`", recipe.name());
            InvalidSetting::new("init.diffusion", "empty", allowed)
                .hint("name a run or checkpoint: option `set init.diffusion=runs/phrases`")
        };
        starts = Some(Starts::named(&init)?.ok_or_else(missing)?);
    }
    if let Some(starts) = &starts
        && group.writes()
    {
        // Another dataset, read only for a warning.
        leaks::warn(starts, &dataset, &config.data, observer);
    }
    let targets = targets(&config);
    let measured = |dataset: &Dataset<PhraseItem>| dataset.statistics_among(&*reading, &*group);
    let augment = &config.data.augment;
    let wide =
        |targets, statistics, before: &AugmentConfig| widened(statistics, targets, augment, before);
    let stored = ChannelEncoding::default();
    let (statistics, network_statistics) = match (&context.checkpoint, &starts) {
        (Some(checkpoint), _) => {
            let stored = checkpoint.state.statistics_of(&Phrases)?.clone();
            (stored, checkpoint.state.network_statistics.clone())
        }
        (None, Some(starts)) => {
            let state = starts.state()?;
            let before = &state.config.data.augment;
            let own = state.network_statistics.clone();
            let mut statistics = state.statistics.clone();
            if statistics.movement.is_empty() {
                // Old checkpoints do not contain movement measures.
                statistics.movement = measured(&dataset)?.movement;
            }
            (
                wide(stored, statistics, before),
                own.map(|own| wide(targets, own, before)),
            )
        }
        (None, None) => {
            let none = AugmentConfig::default();
            let of_crops = config.data.statistics != StatisticsOf::Phrases;
            // Crops are measured at their playback speeds.
            let before = AugmentConfig {
                speed: if of_crops { augment.speed } else { 0.0 },
                ..none.clone()
            };
            let own = (of_crops || !targets.are_stored_channels()).then(|| {
                let train = dataset.train.clone();
                let own = target_statistics(train, targets, &config.data, &*group)?;
                Ok::<_, Error>(wide(targets, own, &before))
            });
            (wide(stored, measured(&dataset)?, &none), own.transpose()?)
        }
    };
    let normalized = Arc::new(network_statistics.as_ref().unwrap_or(&statistics).clone());
    let shared = normalized.clone();
    let style = style::conditions(&config, &statistics);
    let samples = move |phrases, config: &Config| {
        let (statistics, seed) = (shared.clone(), config.run.seed);
        PhraseSamples::new(phrases, statistics, &config.data, seed)
            .with_targets(targets)
            .with_style(style.clone())
    };
    let diffusion = GaussianDiffusion::new(&own.diffusion)?;
    let state = State {
        network_statistics: network_statistics.clone(),
        ..State::untrained(config.clone(), statistics.clone())
    };
    let beats = HeldOutBeats::new(&dataset.validation, &diffusion, state.clone(), &group)?;
    let selection = Selection::new(&dataset.validation, &diffusion, state, &group)?;
    let (training_data, held_out) = context.training_data(dataset, statistics.clone(), samples)?;
    let training_data = TrainingData {
        network_statistics,
        ..training_data
    };
    let through_sampler = |diffusion| {
        let model = match starts {
            Some(starts) => starts.networks(&config, &context.device)?,
            // The weights of the checkpoint will replace these initial weights.
            None => networks(&config, &normalized, &context.device)?,
        };
        let rollouts = Rollouts::new(diffusion, &own.rollout, normalized)?;
        Ok::<_, Error>((model, rollouts.with_targets(targets, &statistics)))
    };
    let of_both = |model: &MotionModel| (model.unet.clone(), Some(model.decoder.clone()));
    match recipe {
        RecipeName::Diffusion => {
            let model = denoiser(&config, &context.device)?;
            let selecting = Selecting {
                recipe: diffusion_recipe(diffusion, held_out),
                selection,
                beats,
                networks: |unet| (unet.clone(), None),
            };
            context.train(training_data, selecting, model, observer)
        }
        RecipeName::Decoder => {
            let (model, rollouts) = through_sampler(diffusion)?;
            let selecting = Selecting {
                recipe: DecoderRecipe::new(rollouts, &own.loss, held_out),
                selection,
                beats,
                networks: of_both,
            };
            context.train(training_data, selecting, model, observer)
        }
        RecipeName::E2e => {
            let (model, rollouts) = through_sampler(diffusion)?;
            let selecting = Selecting {
                recipe: E2eRecipe::new(rollouts, &own.loss, held_out),
                selection,
                beats,
                networks: of_both,
            };
            context.train(training_data, selecting, model, observer)
        }
    }
}

/// The statistics of the channels of `targets`, with the range of augmented phrases for clamping
/// predictions. The given range already includes the augmentation `before`.
fn widened(
    mut statistics: Statistics,
    targets: ChannelEncoding,
    augment: &AugmentConfig,
    before: &AugmentConfig,
) -> Statistics {
    let faster = ((1.0 + augment.speed) / (1.0 + before.speed)).max(1.0);
    // A faster dancer moves further in the same time.
    for (channels, power) in [
        (POSITION, 1),
        (VELOCITY, 1),
        (ACCELERATION, 2),
        (targets.angular_velocity_channels(), 1),
    ] {
        statistics.widen_range_by(faster.powi(power), channels);
    }
    if augment.mirror {
        statistics.widen_range_for_signs(targets.mirrored_channels());
    }
    if augment.flip_quaternion && targets.orientation == OrientationEncoding::Quaternion {
        statistics.widen_range_for_signs(targets.orientation_channels());
    }
    if augment.rotate_yaw && !before.rotate_yaw {
        let turning = targets.angular_velocity_channels();
        let vectors = [POSITION, VELOCITY, ACCELERATION, turning];
        statistics.widen_range_for_yaw(&vectors, targets.orientation_channels());
    }
    statistics
}

#[cfg(test)]
mod tests {
    use kinegrad_motion::{CHANNELS, phrase_statistics, rotate_yaw};
    use kinegrad_motion::{Phrase, mirror};

    use super::*;

    /// Phrases with values on one side of zero in every channel.
    fn phrases() -> Vec<Phrase> {
        let value = |i: usize| 0.2 + ((i * 7919) % 101) as f32 / 200.0;
        let phrase =
            |shift: usize| -> Vec<f32> { (0..20 * CHANNELS).map(|i| value(i + shift)).collect() };
        (0..3)
            .map(|n| Phrase::new(phrase(n)).expect("whole frames"))
            .collect()
    }

    /// Channels in which a changed phrase leaves the range of the statistics.
    fn cut(statistics: &Statistics, change: impl Fn(&mut Phrase)) -> Vec<usize> {
        cut_of(statistics, ChannelEncoding::default(), change)
    }

    fn cut_of(
        statistics: &Statistics,
        targets: ChannelEncoding,
        change: impl Fn(&mut Phrase),
    ) -> Vec<usize> {
        let [low, high] = statistics.normalized_range().expect("measured");
        let mut cut = Vec::new();
        for mut phrase in phrases() {
            change(&mut phrase);
            let values = statistics.normalize(&targets.encode(phrase.as_slice()));
            for (channel, row) in values.chunks(20).enumerate() {
                let within = |v: &f32| (low[channel] - 1e-5..=high[channel] + 1e-5).contains(v);
                if !row.iter().all(within) && !cut.contains(&channel) {
                    cut.push(channel);
                }
            }
        }
        cut
    }

    fn flip(phrase: &mut Phrase) {
        (0..20).for_each(|t| phrase.set_quaternion(t, phrase.quaternion(t).scale(-1.0)));
    }

    #[test]
    fn each_augmentation_alone_stays_within_the_range_that_it_widens() {
        let measured = phrase_statistics(&phrases()).expect("phrases");
        let none = AugmentConfig::default();
        let with = |set: fn(&mut AugmentConfig)| {
            let mut augment = none.clone();
            set(&mut augment);
            widened(
                measured.clone(),
                ChannelEncoding::default(),
                &augment,
                &none,
            )
        };
        assert!(!cut(&measured, mirror).is_empty() && !cut(&measured, flip).is_empty());
        let turn = |phrase: &mut Phrase| rotate_yaw(phrase, 2.0);
        assert!(!cut(&measured, turn).is_empty());
        assert!(cut(&with(|a| a.mirror = true), mirror).is_empty());
        assert!(cut(&with(|a| a.flip_quaternion = true), flip).is_empty());
        assert!(cut(&with(|a| a.rotate_yaw = true), turn).is_empty());
        let faster = |phrase: &mut Phrase| {
            for t in 0..20 {
                for (channels, factor) in [(POSITION, 1.5), (VELOCITY, 1.5), (ACCELERATION, 2.25)] {
                    let scaled = phrase.vector(t, channels.clone()).map(|v| factor * v);
                    phrase.set_vector(t, channels, scaled);
                }
            }
        };
        assert!(!cut(&measured, faster).is_empty());
        assert!(cut(&with(|a| a.speed = 0.5), faster).is_empty());
        // Nothing else is widened.
        assert!(!cut(&with(|a| a.mirror = true), turn).is_empty());
    }

    #[test]
    fn the_range_of_other_targets_takes_in_each_augmentation() {
        use kinegrad_motion::{ChannelMoments, PhaseEncoding};

        let targets = ChannelEncoding {
            phase: PhaseEncoding::SinCos,
            orientation: OrientationEncoding::Rotation6d,
        };
        let encoded: Vec<Vec<f32>> = phrases()
            .iter()
            .map(|phrase| targets.encode(phrase.as_slice()).into_owned())
            .collect();
        let rows = encoded.iter().map(Vec::as_slice);
        let measured = targets.statistics(ChannelMoments::measure(targets.channels(), rows));
        let none = AugmentConfig::default();
        let (mirrored, turned) = (
            AugmentConfig {
                mirror: true,
                ..none.clone()
            },
            AugmentConfig {
                rotate_yaw: true,
                ..none.clone()
            },
        );
        let turn = |phrase: &mut Phrase| rotate_yaw(phrase, 2.0);
        assert!(cut_of(&measured, targets, |_| ()).is_empty());
        assert!(cut_of(&measured, targets, flip).is_empty());
        for (augment, change) in [(mirrored, &mirror as &dyn Fn(&mut Phrase)), (turned, &turn)] {
            assert!(!cut_of(&measured, targets, change).is_empty());
            let wide = widened(measured.clone(), targets, &augment, &none);
            assert!(cut_of(&wide, targets, change).is_empty(), "{augment:?}");
        }
    }

    #[test]
    fn a_range_that_takes_in_rotation_is_not_widened_again() {
        let measured = phrase_statistics(&phrases()).expect("phrases");
        let turned = AugmentConfig {
            rotate_yaw: true,
            ..AugmentConfig::default()
        };
        let none = AugmentConfig::default();
        let stored = ChannelEncoding::default();
        let once = widened(measured, stored, &turned, &none);
        assert_eq!(widened(once.clone(), stored, &turned, &turned), once);
    }
}
