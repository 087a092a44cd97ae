//! Metrics of a trained model's samples and of real phrases.

mod audio_ablation;
pub(crate) mod beat_verdict;
mod measures;
mod movement;
mod report;
mod songs;
mod terms;

use std::collections::BTreeSet;
use std::iter::repeat_n;
use std::sync::Arc;

use kinegrad_data::{AudioFeatures, BeatAgreement, BeatPhrase, PhraseItem, Songs};
use kinegrad_motion::Phrase;
use kinegrad_random::{Key, Purpose};
use kinegrad_train::evaluation::{
    Evaluation, EvaluationRequest, OnStep, for_each_item, phrases_with_held_out,
};
use kinegrad_train::sampling::item_seed;
use kinegrad_train::{Error, ProcessGroup, TrainedModel};

use super::generate::{self, Generator, keys};
use super::lengths::{leading, untrained, windows};
use super::{CcMotionConfig, CondSource};
use measures::Reference;

pub use measures::{CheckRate, Measures, ProfileRates};
pub use movement::MovementSpread;
pub use terms::LossTerm;

/// Bytes of memory per frame of a sample: raw and post-processed motion, and their derivatives.
const BYTES_PER_FRAME: u64 = 800;

/// Hint of the error for samples of a phrase that do not fit into memory.
const BATCH_HINT: &str =
    "choose fewer `evaluation.seeds`: the samples of a phrase are generated at a time";

/// Settings of the samples.
#[derive(Clone, Copy)]
pub(super) struct SampleSettings {
    /// Samples for each phrase.
    pub seeds: usize,
    /// Seed of all noise.
    pub seed: u64,
    /// The audio condition.
    pub cond: CondSource,
}

/// A condition of samples: its name, from which the seed of the noise is derived, and its music.
pub(super) type Music = (String, AudioFeatures);

/// The measures of an evaluation.
pub(super) struct EvaluationReport {
    /// Number of held-out phrases.
    phrases: usize,
    settings: SampleSettings,
    /// The samples after post-processing.
    pub processed: Measures,
    /// The samples without post-processing.
    raw: Measures,
    /// The held-out phrases.
    pub real: Measures,
    /// Agreement of their phase with the beats tracked in their music.
    tracked: Option<BeatAgreement>,
}

/// The held-out phrases of an evaluation.
#[derive(Clone, Copy)]
pub(super) struct HeldOut<'a> {
    pub phrases: &'a [Arc<PhraseItem>],
    /// Facts about their music.
    pub songs: &'a Songs,
    /// Beats in a bar, if stated.
    pub beats_per_bar: Option<f64>,
}

impl HeldOut<'_> {
    fn phases(&self) -> Vec<Option<BeatPhrase>> {
        let phrases = self.phrases.iter().cloned();
        let phase = |phrase| BeatPhrase::new(phrase, self.songs, self.beats_per_bar);
        phrases.map(phase).collect()
    }

    fn tracked(&self) -> Option<BeatAgreement> {
        BeatAgreement::with_tracked(self.phrases, self.songs)
    }
}

/// An evaluation on the held-out phrases.
pub(super) fn prepare<'a>(
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
) -> Result<Evaluation<'a>, Error> {
    let config = trained.config();
    let settings = &config.own::<CcMotionConfig>().evaluation;
    let purpose = "samples are generated for held-out phrases";
    if let Some(folder) = &request.songs {
        return songs::prepare(trained, request, folder);
    }
    let (data, dataset) = phrases_with_held_out(trained, request, purpose)?;
    let mut held_out = dataset.validation.load()?;
    if let Some(frames) = request.num_frames {
        held_out = held_out
            .iter()
            .map(|phrase| leading(phrase, frames))
            .collect();
    }
    let most = settings.phrases.unwrap_or(usize::MAX).min(held_out.len());
    let [most, seeds] = counts(request.num_samples, most, settings.seeds);
    held_out.truncate(most);
    let frames = held_out.iter().map(|phrase| phrase.frames() as u64);
    let bytes = frames.sum::<u64>() * BYTES_PER_FRAME;
    let evaluation = |report, measure| Evaluation {
        report,
        memory: bytes.saturating_mul(seeds as u64),
        memory_hint: "all samples are compared with each other: choose fewer `evaluation.seeds` or \
                      `evaluation.phrases`",
        remarks: Vec::new(),
        measure,
    };
    if request.audio_ablation {
        let measure = audio_ablation::prepare(trained, request, &data, held_out, &dataset.train)?;
        return Ok(evaluation("eval-audio-ablation", measure));
    }
    let processes = request.group.ranks().local().size;
    let lengths: BTreeSet<usize> = held_out.iter().map(|phrase| phrase.frames()).collect();
    for frames in lengths {
        generate::must_fit(trained, seeds, frames, processes, BATCH_HINT)?;
    }
    let training = dataset.train.load()?;
    let generated = held_out.iter().map(|phrase| {
        let windows = windows(config, phrase.frames());
        windows.map_or(phrase.frames(), |windows| windows.length())
    });
    let odd_lengths = untrained(config, generated);
    let report = match settings.cond {
        CondSource::Phrases => "eval",
        CondSource::Noise => "eval-noise",
    };
    let beats_per_bar = settings.beats_per_bar.map(|beats| beats as f64);
    let settings = SampleSettings {
        seeds,
        seed: request.seed,
        cond: settings.cond,
    };
    let (group, songs) = (request.group.clone(), Songs::read(&data)?);
    let measure = move |on_step: &mut OnStep<'_>| {
        let generator = Generator::load(trained)?;
        let held_out = HeldOut {
            phrases: &held_out,
            songs: &songs,
            beats_per_bar,
        };
        let report = evaluate(&generator, held_out, &training, settings, &group, on_step)?;
        let mut results = report.results(&config.sampling);
        if generator.statistics().movement.is_empty() {
            results.remarks.push(format!(
                "{} was trained before kinegrad measured how training motion moves: the bounds of \
                 `strict` are those of its dataset's {} training phrases",
                config.run.name,
                training.len()
            ));
        }
        results.remarks.extend(odd_lengths);
        Ok(results)
    };
    Ok(evaluation(report, Box::new(measure)))
}

/// Generates samples for each held-out phrase and compares them with the held-out and the training
/// phrases. Sample k of a phrase depends only on the seed, the phrase's id and k, as in `kinegrad
/// sample`. Each process generates the samples of some phrases.
pub(super) fn evaluate(
    generator: &Generator,
    held_out: HeldOut<'_>,
    training: &[Arc<PhraseItem>],
    settings: SampleSettings,
    group: &ProcessGroup,
    on_step: &mut OnStep<'_>,
) -> Result<EvaluationReport, Error> {
    let (phases, tracked) = (held_out.phases(), held_out.tracked());
    let held_out = held_out.phrases;
    let music = |index: usize| {
        let phrase = &held_out[index];
        let audio = condition(phrase, settings.cond, settings.seed);
        (phrase.id.clone(), audio)
    };
    let [raw, processed] = samples(generator, held_out.len(), music, settings, group, on_step)?;
    let real = held_out.iter().map(|phrase| vec![phrase.motion.clone()]);
    let reference = Reference::new(held_out, training, generator.statistics());
    let thresholds = generator
        .config()
        .own::<CcMotionConfig>()
        .evaluation
        .thresholds;
    let reference = reference.with_phases(phases).with_thresholds(thresholds);
    Ok(EvaluationReport {
        phrases: held_out.len(),
        settings,
        processed: reference.measure(&processed),
        raw: reference.measure(&raw),
        real: reference.measure(&real.collect::<Vec<_>>()),
        tracked,
    })
}

/// The raw and the processed samples of each of `count` conditions. Each process generates the samples
/// of some conditions.
pub(super) fn samples(
    generator: &Generator,
    count: usize,
    music: impl Fn(usize) -> Music,
    settings: SampleSettings,
    group: &ProcessGroup,
    on_step: &mut OnStep<'_>,
) -> Result<[Vec<Vec<Phrase>>; 2], Error> {
    let SampleSettings { seeds, seed, .. } = settings;
    let sampling = &generator.config().sampling;
    let samples = for_each_item(group, count, on_step, |index, on_step| {
        let (name, audio) = music(index);
        let (mut raw, mut processed) = (Vec::new(), Vec::new());
        generator.sample_each(
            repeat_n(audio, seeds).zip(keys(item_seed(seed, &name), seeds)),
            sampling,
            &mut |done, all| on_step("", done, all),
            &mut |sample| {
                raw.push(sample.raw);
                processed.push(sample.motion);
                Ok(())
            },
        )?;
        Ok((raw, processed))
    })?;
    let (raw, processed) = samples.into_iter().unzip();
    Ok([raw, processed])
}

/// The numbers of conditions and of samples of each, for at most `num_samples` samples in total. There
/// are at most `most` conditions, and at least `seeds` samples of each if `num_samples` allows it.
fn counts(num_samples: Option<usize>, most: usize, seeds: usize) -> [usize; 2] {
    let Some(all) = num_samples else {
        return [most, seeds];
    };
    let conditions = most.min(all / seeds).max(1);
    [conditions, (all / conditions).max(1)]
}

/// The audio condition of all samples of `phrase`.
fn condition(phrase: &PhraseItem, cond: CondSource, seed: u64) -> AudioFeatures {
    match cond {
        CondSource::Phrases => phrase.audio.clone(),
        CondSource::Noise => {
            let key = Key::new(seed, Purpose::NoiseCondition).named(&phrase.id);
            let noise = key.normals(phrase.audio.as_slice().len());
            AudioFeatures::new(phrase.frames(), noise).expect("as many as of the phrase")
        }
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_data::synthetic;

    use super::*;

    #[test]
    fn a_number_of_samples_is_divided_into_conditions_and_seeds() {
        assert_eq!(counts(None, 27, 2), [27, 2]);
        assert_eq!(counts(Some(20), 27, 2), [10, 2]);
        assert_eq!(counts(Some(100), 27, 2), [27, 3]);
        assert_eq!(counts(Some(20), 4, 2), [4, 5]);
        assert_eq!(counts(Some(7), 3, 2), [3, 2]);
        assert_eq!(counts(Some(1), 3, 2), [1, 1]);
    }

    #[test]
    fn noise_conditions_differ_by_phrase_and_seed_and_have_the_phrase_s_length() {
        let phrases = [synthetic::phrase(0, 20, 1), synthetic::phrase(1, 30, 1)];
        let noise = |phrase: &PhraseItem, seed| condition(phrase, CondSource::Noise, seed);
        let [first, second] = phrases.each_ref().map(|phrase| noise(phrase, 0));
        assert_eq!((first.frames(), second.frames()), (20, 30));
        assert_eq!(first, noise(&phrases[0], 0));
        assert_ne!(first, noise(&phrases[0], 1));
        assert_ne!(first, second.slice(0..20));
        let own = condition(&phrases[0], CondSource::Phrases, 0);
        assert_eq!(own, phrases[0].audio);
    }
}
