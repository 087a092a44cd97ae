//! The ablation of audio: loss and samples of a model with the phrases' own music, with silence and
//! with altered music. The differences show the model's use of the beats.

mod audio_variant;
mod beat_tracker;
mod loss;
mod means;
mod report;
mod scores;

use std::collections::BTreeSet;
use std::slice::from_ref;
use std::sync::Arc;

use kinegrad_data::{
    AudioFeatures, BeatAgreement, BeatPhrase, DataConfig, PhraseItem, PhraseSet, Songs,
};
use kinegrad_motion::Phrase;
use kinegrad_settings::counted;
use kinegrad_train::config::SamplingConfig;
use kinegrad_train::evaluation::{EvaluationRequest, Measure, OnStep, for_each_item};
use kinegrad_train::sampling::item_seed;
use kinegrad_train::{Error, TrainedModel};

use super::measures::Reference;
use super::{BATCH_HINT, CondSource, Measures};
use crate::generate::{self, Generator, keys};
use crate::lengths::leading;
use crate::{CcMotionConfig, EvaluationConfig};
use audio_variant::{AudioVariant, donors};
use means::{ALIGNMENTS, Mean, PHASE_ERRORS, means_by_variant};
use report::AblationReport;
use scores::{MeasuredCondition, MeasuredPhrase, Score};

/// An ablation of audio on held-out phrases with beats, cut to the training length.
pub(super) fn prepare<'a>(
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
    data: &DataConfig,
    held_out: Vec<Arc<PhraseItem>>,
    train: &PhraseSet,
) -> Result<Measure<'a>, Error> {
    let config = trained.config();
    let settings = &config.own::<CcMotionConfig>().evaluation;
    if settings.cond != CondSource::Phrases {
        let message = "option `audio_ablation` with `evaluation.cond = \"noise\"`";
        let hint = "it compares each phrase's own music with silence, with its frames in other \
                    orders and with another song's";
        return Err(Error::usage(message, hint));
    }
    let songs = Songs::read(data)?;
    let frames = config.data.target_frames;
    let beats_per_bar = settings.beats_per_bar.map(|beats| beats as f64);
    let with_beats = |phrases: &[Arc<PhraseItem>]| -> Vec<BeatPhrase> {
        let cut = phrases.iter().map(|phrase| leading(phrase, frames));
        cut.filter_map(|phrase| BeatPhrase::new(phrase, &songs, beats_per_bar))
            .collect()
    };
    let all = held_out.len();
    let held_out = with_beats(&held_out);
    if held_out.is_empty() {
        let message = format!(
            "none of the {all} held-out phrases of {} has beats: their phase advances by less than \
             a beat in the {frames} frames of the training length",
            trained.path().display()
        );
        let hint = "prepare them with the beats of their songs, or give another dataset with option \
                    `source URI`";
        return Err(Error::usage(message, hint));
    }
    let longest = held_out.iter().map(|one| one.phrase.frames()).max();
    let batch = settings.seeds.saturating_mul(AudioVariant::ALL.len());
    let processes = request.group.ranks().local().size;
    let longest = longest.unwrap_or_default();
    generate::must_fit(trained, batch, longest, processes, BATCH_HINT)?;
    let training_phrases = train.load()?;
    let training = with_beats(&training_phrases);
    let request = request.clone();
    Ok(Box::new(move |on_step| {
        let generator = Generator::load(trained)?;
        let ablation = Ablation {
            generator: &generator,
            settings,
            held_out: &held_out,
            donors: donors(&held_out, &training),
            training_phrases: &training_phrases,
            request: &request,
        };
        let report = ablation.run(on_step)?;
        let mut results = report.results(&ablation);
        results.remarks = remarks(&config.run.name, &report, &held_out, all);
        Ok(results)
    }))
}

/// Remarks on an ablation; `held_out` are the phrases with beats among `all` held-out phrases.
fn remarks(run: &str, report: &AblationReport, held_out: &[BeatPhrase], all: usize) -> Vec<String> {
    let mut remarks = vec![
        "in brackets: 95 % bootstrap intervals (songs, then phrases); chance level of a phase error: \
         0.25"
            .to_owned(),
    ];
    if held_out.len() < all {
        let missing = all - held_out.len();
        remarks.push(format!(
            "{missing} of {} left out, without beats",
            counted(all, "held-out phrase")
        ));
    }
    if report.songs == 1 {
        let remark = "all phrases are of one song: the intervals do not cover other songs";
        remarks.push(remark.to_owned());
    }
    let guessed = held_out.iter().filter(|one| one.guessed).count();
    if guessed > 0 {
        remarks.push(format!(
            "{} without a known number of beats in a bar: four are assumed (`evaluation.beats_per_bar`)",
            counted(guessed, "phrase")
        ));
    }
    let mut conditions = report.conditions.iter();
    if conditions.all(|(variant, _)| *variant != AudioVariant::OtherSong) {
        let remark =
            "the dataset has one song: samples with the music of another song are left out";
        remarks.push(remark.to_owned());
    }
    let named = remarks.into_iter();
    named.map(|remark| format!("{run}: {remark}")).collect()
}

/// An ablation of audio.
struct Ablation<'a> {
    generator: &'a Generator,
    settings: &'a EvaluationConfig,
    /// Held-out phrases with beats, at least one.
    held_out: &'a [BeatPhrase],
    /// The phrases that provide another song's music.
    donors: &'a [BeatPhrase],
    /// All training phrases, for measures of samples at other guidance scales.
    training_phrases: &'a [Arc<PhraseItem>],
    request: &'a EvaluationRequest,
}

impl<'a> Ablation<'a> {
    /// Computes losses and samples. All audio variants of a phrase have the same noise. Sample k of
    /// an uncut phrase with own music equals sample k of `kinegrad sample`.
    fn run(&self, on_step: &mut OnStep<'_>) -> Result<AblationReport, Error> {
        let (held_out, seed) = (self.held_out, self.request.seed);
        let group = &self.request.group;
        let measured = for_each_item(group, held_out.len(), on_step, |index, on_step| {
            self.measure(&held_out[index], on_step)
        })?;
        let guidance = self.guidance(on_step)?;
        let score = |phrase: &BeatPhrase| {
            scores::score(phrase, from_ref(&phrase.phrase.motion), None, seed)
        };
        let real: Vec<Score> = held_out.iter().map(score).collect();
        let songs: BTreeSet<&str> = held_out.iter().map(|one| one.song.as_str()).collect();
        let tracked = measured.iter();
        let tracked =
            tracked.filter_map(|each| Some((each.song.as_str(), each.tracked_beat_error?)));
        let of_music = held_out.iter();
        let of_music = of_music.filter_map(|one| Some((one.song.clone(), one.tracked_error()?)));
        Ok(AblationReport {
            songs: songs.len(),
            tracked_beats: BeatAgreement::of(of_music),
            tracked_beat_error: Mean::of(
                "tracked_beat_error",
                "beat-phase error of the network's tracker, beats",
                tracked,
                seed,
            ),
            conditions: means_by_variant(&measured, seed),
            real: Mean::of_scores(&ALIGNMENTS, &self.with_songs(&real), seed),
            guidance,
            measured,
        })
    }

    /// Scores of the held-out phrases, with their songs.
    fn with_songs<'s>(&'s self, scores: &'s [Score]) -> Vec<(&'s str, &'s Score)> {
        let songs = self.held_out.iter().map(|one| one.song.as_str());
        songs.zip(scores).collect()
    }

    fn sampling(&self) -> &'a SamplingConfig {
        &self.generator.config().sampling
    }

    /// The loss and the scores of one phrase for each audio variant.
    fn measure(
        &self,
        phrase: &BeatPhrase,
        on_step: &mut OnStep<'_>,
    ) -> Result<MeasuredPhrase, Error> {
        let (generator, seed) = (self.generator, self.request.seed);
        let music = |variant| {
            Some((
                variant,
                audio_variant::music(phrase, variant, seed, self.donors)?,
            ))
        };
        let variants: Vec<_> = AudioVariant::ALL.into_iter().filter_map(music).collect();
        let audio: Vec<_> = variants.iter().map(|(_, music)| &music.audio).collect();
        let samples = self.sample("samples", phrase, &audio, self.sampling(), on_step)?;
        let conditions = variants.iter().zip(samples.chunks(self.settings.seeds));
        let conditions = conditions.map(|(&(audio, ref music), samples)| MeasuredCondition {
            audio,
            loss: loss::loss(generator, &phrase.phrase, &music.audio),
            score: scores::score(phrase, samples, music.bars.as_ref(), seed),
        });
        Ok(MeasuredPhrase {
            id: phrase.phrase.id.clone(),
            song: phrase.song.clone(),
            beats_per_bar: phrase.beats_per_bar,
            tracked_beat_error: beat_tracker::error(generator, phrase),
            conditions: conditions.collect(),
        })
    }

    /// Samples with own music at each guidance scale.
    fn guidance(&self, on_step: &mut OnStep<'_>) -> Result<Vec<(f64, Vec<Mean>, Measures)>, Error> {
        let (held_out, seed) = (self.held_out, self.request.seed);
        let scales = &self.settings.guidance_scales;
        let phrases: Vec<Arc<PhraseItem>> = held_out.iter().map(|one| one.phrase.clone()).collect();
        let statistics = self.generator.statistics();
        let reference = Reference::new(&phrases, self.training_phrases, statistics);
        let mut guidance = Vec::with_capacity(scales.len());
        for (number, &guidance_scale) in scales.iter().enumerate() {
            let mut sampling = self.sampling().clone();
            sampling.sampler.guidance_scale = guidance_scale;
            let mut on_step =
                |stage, done, all| on_step(stage, number * all + done, scales.len() * all);
            let samples = for_each_item(
                &self.request.group,
                held_out.len(),
                &mut on_step,
                |index, on_step| {
                    let phrase = &held_out[index];
                    let audio = [&phrase.phrase.audio];
                    let samples = self.sample("guidance", phrase, &audio, &sampling, on_step)?;
                    let score = scores::score(phrase, &samples, None, seed);
                    Ok((samples, score))
                },
            )?;
            let (motions, scores): (Vec<Vec<Phrase>>, Vec<Score>) = samples.into_iter().unzip();
            let means = Mean::of_scores(&PHASE_ERRORS, &self.with_songs(&scores), seed);
            guidance.push((guidance_scale, means, reference.measure(&motions)));
        }
        Ok(guidance)
    }

    /// The post-processed samples of a phrase, `seeds` samples for each audio condition.
    fn sample(
        &self,
        stage: &'static str,
        phrase: &BeatPhrase,
        audio: &[&AudioFeatures],
        sampling: &SamplingConfig,
        on_step: &mut OnStep<'_>,
    ) -> Result<Vec<Phrase>, Error> {
        let seed = item_seed(self.request.seed, &phrase.phrase.id);
        let conditions = audio.iter().flat_map(|&audio| {
            keys(seed, self.settings.seeds).map(move |key| (audio.clone(), key))
        });
        let conditions: Vec<_> = conditions.collect();
        let mut motions = Vec::with_capacity(conditions.len());
        self.generator.sample_each(
            conditions.into_iter(),
            sampling,
            &mut |done, all| on_step(stage, done, all),
            &mut |sample| {
                motions.push(sample.motion);
                Ok(())
            },
        )?;
        Ok(motions)
    }
}
