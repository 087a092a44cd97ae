//! Metrics of a trained model's samples, next to those of real phrases.

pub mod listening;
mod measures;
mod moving;
mod report;
mod run;
mod terms;

use std::iter::repeat_n;
use std::ops::ControlFlow;
use std::sync::Arc;

use kinegrad_data::{AudioFeatures, PhraseItem};
use kinegrad_motion::Phrase;
use kinegrad_random::{Key, Purpose};
use serde::Serialize;

pub(super) use run::prepare;

pub use measures::{CheckRate, Measures, ProfileRates};
pub use moving::MovementSpread;
pub use terms::LossTerm;

use super::CondSource;
use super::generate::{Generator, keys};
use crate::config::SamplingConfig;
use crate::error::Error;
use crate::sampling::item_seed;
use crate::together::Together;
use measures::Reference;

/// Settings of an evaluation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EvaluationSettings {
    /// Samples for each phrase.
    pub seeds: usize,
    /// Seed of all noise.
    pub seed: u64,
    /// The audio condition.
    pub cond: CondSource,
    /// The sampler, and what the predicted clean motion is clipped to.
    #[serde(flatten)]
    pub sampling: SamplingConfig,
}

/// What an evaluation found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// Name of the run.
    pub run: String,
    /// Step of its checkpoint.
    pub step: u64,
    /// Number of held-out phrases.
    pub phrases: usize,
    /// The settings.
    #[serde(flatten)]
    pub settings: EvaluationSettings,
    /// The samples after post-processing.
    pub processed: Measures,
    /// The samples as the model drew them.
    pub raw: Measures,
    /// The real held-out phrases, by the same measures.
    pub real: Measures,
}

/// Generates `settings.seeds` samples for each of the `held_out` phrases and compares them with
/// the held-out and the `training` phrases. Sample k of a phrase depends on the seed, the
/// phrase's id and k alone: the same as from `kinegrad sample`. Each rank draws those of some phrases, and
/// all of them find the same. `on_step` is called with the denoising steps that this one has done and does
/// in all.
///
/// # Errors
/// If the sampler's settings cannot work.
pub fn evaluate(
    generator: &Generator,
    held_out: &[Arc<PhraseItem>],
    training: &[Arc<PhraseItem>],
    settings: &EvaluationSettings,
    together: &Together,
    on_step: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
) -> Result<Evaluation, Error> {
    let samples = together.each(held_out.len(), |index| {
        let phrase = &held_out[index];
        let [before, count] = together.own_of(index, held_out.len());
        let (mut drawn, mut repaired) = (Vec::new(), Vec::new());
        let seed = item_seed(settings.seed, &phrase.id);
        generator.sample_each(
            repeat_n(condition(phrase, settings), settings.seeds).zip(keys(seed, settings.seeds)),
            &settings.sampling,
            &mut |step, total| on_step(before * total + step, count * total),
            &mut |sample| {
                drawn.push(sample.raw);
                repaired.push(sample.motion);
                Ok(())
            },
        )?;
        Ok((drawn, repaired))
    })?;
    let (raw, processed): (Vec<Vec<Phrase>>, Vec<Vec<Phrase>>) = samples.into_iter().unzip();
    let real: Vec<Vec<Phrase>> = held_out
        .iter()
        .map(|phrase| vec![phrase.motion.clone()])
        .collect();
    let reference = Reference::new(held_out, training, generator.statistics());
    Ok(Evaluation {
        run: generator.config().run.name.clone(),
        step: generator.step(),
        phrases: held_out.len(),
        settings: settings.clone(),
        processed: reference.measure(&processed),
        raw: reference.measure(&raw),
        real: reference.measure(&real),
    })
}

/// The audio condition for `phrase`, the same for all of its samples.
fn condition(phrase: &PhraseItem, settings: &EvaluationSettings) -> AudioFeatures {
    match settings.cond {
        CondSource::Phrases => phrase.audio.clone(),
        CondSource::Noise => {
            let key = Key::new(settings.seed, Purpose::NoiseCondition).named(&phrase.id);
            let noise = key.normals(phrase.audio.as_slice().len());
            AudioFeatures::new(phrase.frames(), noise).expect("as many as of the phrase")
        }
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_data::synthetic;

    use super::*;

    fn settings(cond: CondSource, seed: u64) -> EvaluationSettings {
        EvaluationSettings {
            seeds: 1,
            seed,
            cond,
            sampling: SamplingConfig::default(),
        }
    }

    #[test]
    fn noise_conditions_differ_by_phrase_and_seed_and_have_the_phrase_s_length() {
        let phrases = [synthetic::phrase(0, 20, 1), synthetic::phrase(1, 30, 1)];
        let noise =
            |phrase: &PhraseItem, seed| condition(phrase, &settings(CondSource::Noise, seed));
        let [first, second] = phrases.each_ref().map(|phrase| noise(phrase, 0));
        assert_eq!((first.frames(), second.frames()), (20, 30));
        assert_eq!(first, noise(&phrases[0], 0));
        assert_ne!(first, noise(&phrases[0], 1));
        assert_ne!(first, second.slice(0..20));
        let heard = condition(&phrases[0], &settings(CondSource::Phrases, 0));
        assert_eq!(heard, phrases[0].audio);
    }
}
