//! Whether a model hears when the beats of its music fall: its loss and its samples with the
//! phrases' own music, and with music that says less or something else.

mod conditions;
mod loss;
mod means;
mod measure;
mod phrases;
mod report;
mod tracked;

use std::ops::ControlFlow;
use std::sync::Arc;

use kinegrad_data::{AudioFeatures, PhraseItem};
use kinegrad_motion::Phrase;
use kinegrad_motion::metrics::Estimate;
use serde::Serialize;

pub use conditions::Heard;
pub use means::{Alignment, Alignments, AtScale, Condition, Differences};
pub use measure::{MeasuredCondition, MeasuredPhrase, Score};
pub(super) use phrases::Listened;
pub(super) use report::evaluated;

use super::measures::Reference;
use crate::config::SamplingConfig;
use crate::error::Error;
use crate::sampling::item_seed;
use crate::systems::cc_motion::generate::{Generator, keys};
use crate::together::Together;
use conditions::{Music, exchanged};
use means::conditions_of;
use measure::Dancing;

/// Settings of an evaluation of listening.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ListeningSettings {
    /// Samples for each phrase and condition.
    pub seeds: usize,
    /// Seed of all noise, of shuffled frames, of other songs and of intervals.
    pub seed: u64,
    /// Guidance scales that samples with the own music are drawn at, beside the sampler's own.
    pub guidance_scales: Vec<f64>,
    /// The sampler, and what the predicted clean motion is clipped to.
    #[serde(flatten)]
    pub sampling: SamplingConfig,
}

/// What an evaluation of listening found.
#[derive(Clone, Debug, Serialize)]
pub struct Listening {
    /// Name of the run.
    pub run: String,
    /// Step of its checkpoint.
    pub step: u64,
    /// Number of held-out phrases with beats.
    pub phrases: usize,
    /// Number of songs they are of.
    pub songs: usize,
    /// The settings.
    #[serde(flatten)]
    pub settings: ListeningSettings,
    /// Timesteps of the loss.
    pub timesteps: Vec<usize>,
    /// Distance of the beat phase that the network's own tracker finds from that of the music, beats;
    /// `None` without a tracker.
    pub tracked_beat_error: Option<Estimate>,
    /// What was heard, and what came of it.
    pub conditions: Vec<Condition>,
    /// How the real phrases fall in with the beats.
    pub real: Alignments,
    /// Samples with the own music at each of the guidance scales.
    pub guidance: Vec<AtScale>,
    /// The values of each phrase that the means are of.
    pub measured: Vec<MeasuredPhrase>,
}

/// What listening is measured on.
pub(super) struct Stage<'a> {
    /// Held-out phrases with beats, at least one.
    pub held_out: &'a [Listened],
    /// Phrases to train on, for their music.
    pub training: &'a [Listened],
    /// All phrases to train on, to compare samples with.
    pub real: &'a [Arc<PhraseItem>],
}

/// Measures how a model listens. All conditions of a phrase share their noise, in the loss and in
/// the samples, so that what differs is what was heard; sample k of a phrase with its own music is
/// that of `kinegrad sample`, unless the phrase was cut. Ranks measure some phrases each. `on_step` is called
/// with what is done, and with steps done and in all.
///
/// # Errors
/// If the sampler's settings cannot work, and [`Error::Interrupted`] after `Break`.
pub(super) fn listen(
    generator: &Generator,
    stage: &Stage<'_>,
    settings: &ListeningSettings,
    together: &Together,
    on_step: &mut dyn FnMut(&'static str, usize, usize) -> ControlFlow<()>,
) -> Result<Listening, Error> {
    let held_out = stage.held_out;
    let others = exchanged(held_out, stage.training);
    let dancing: Vec<Dancing<'_>> = held_out.iter().map(Dancing::to).collect();
    let mut measured: Vec<MeasuredPhrase> = held_out.iter().map(MeasuredPhrase::new).collect();
    let losses = together.each(held_out.len(), |index| {
        let [before, count] = together.own_of(index, held_out.len());
        let listened = &held_out[index];
        let music = all_music(listened, settings.seed, others);
        let of_each = music
            .iter()
            .map(|(_, music)| loss::loss(generator, &listened.phrase, &music.audio));
        let of_each = of_each.collect::<Vec<f64>>();
        let tracked = tracked::beat_error(generator, listened);
        go_on(on_step("loss", before + 1, count))?;
        Ok((of_each, tracked))
    })?;
    let scores: Vec<Vec<Score>> = together.each(held_out.len(), |index| {
        let [before, count] = together.own_of(index, held_out.len());
        let listened = &held_out[index];
        let music = all_music(listened, settings.seed, others);
        let heard: Vec<_> = music.iter().map(|(_, music)| &music.audio).collect();
        let samples = draw(
            generator,
            listened,
            &heard,
            settings,
            &settings.sampling,
            &mut |done, all| on_step("samples", before * all + done, count * all),
        )?;
        let of_each = music.iter().zip(samples.chunks(settings.seeds));
        let scores = of_each.map(|((_, music), samples)| {
            dancing[index].score(samples, music.bars.as_ref(), settings.seed)
        });
        Ok(scores.collect())
    })?;
    for (index, ((losses, tracked), scores)) in losses.into_iter().zip(scores).enumerate() {
        measured[index].tracked_beat_error = tracked;
        let music = all_music(&held_out[index], settings.seed, others);
        for (((heard, _), loss), score) in music.into_iter().zip(losses).zip(scores) {
            measured[index]
                .conditions
                .push(MeasuredCondition { heard, loss, score });
        }
    }
    let guidance = sweep(generator, stage, &dancing, settings, together, on_step)?;
    let real = held_out.iter().zip(&dancing).map(|(listened, dancing)| {
        let motion = std::slice::from_ref(&listened.phrase.motion);
        (
            listened.song.as_str(),
            dancing.score(motion, None, settings.seed),
        )
    });
    let real: Vec<(&str, Score)> = real.collect();
    let real = real.iter().map(|(song, score)| (*song, score));
    let mut songs: Vec<&str> = held_out.iter().map(|one| one.song.as_str()).collect();
    songs.sort_unstable();
    songs.dedup();
    Ok(Listening {
        run: generator.config().run.name.clone(),
        step: generator.step(),
        phrases: held_out.len(),
        songs: songs.len(),
        settings: settings.clone(),
        timesteps: loss::high_noise(generator.diffusion.config.num_train_timesteps),
        tracked_beat_error: means::tracked(&measured, settings.seed),
        conditions: conditions_of(&measured, settings.seed),
        real: Alignments::of(real, settings.seed),
        guidance,
        measured,
    })
}

/// Samples with the own music at each of the guidance scales.
fn sweep(
    generator: &Generator,
    stage: &Stage<'_>,
    dancing: &[Dancing<'_>],
    settings: &ListeningSettings,
    together: &Together,
    on_step: &mut dyn FnMut(&'static str, usize, usize) -> ControlFlow<()>,
) -> Result<Vec<AtScale>, Error> {
    let (held_out, scales) = (stage.held_out, &settings.guidance_scales);
    let phrases: Vec<Arc<PhraseItem>> = held_out.iter().map(|one| one.phrase.clone()).collect();
    let reference = Reference::new(&phrases, stage.real, generator.statistics());
    let mut guidance = Vec::with_capacity(scales.len());
    for (place, &guidance_scale) in scales.iter().enumerate() {
        let mut sampling = settings.sampling.clone();
        sampling.sampler.guidance_scale = guidance_scale;
        let drawn = together.each(held_out.len(), |index| {
            let [before, count] = together.own_of(index, held_out.len());
            let (before, count) = (place * count + before, scales.len() * count);
            let listened = &held_out[index];
            let samples = draw(
                generator,
                listened,
                &[&listened.phrase.audio],
                settings,
                &sampling,
                &mut |done, all| on_step("guidance", before * all + done, count * all),
            )?;
            let score = dancing[index].score(&samples, None, settings.seed);
            Ok((samples, score))
        })?;
        let (motions, scores): (Vec<Vec<Phrase>>, Vec<Score>) = drawn.into_iter().unzip();
        let songs = held_out.iter().map(|one| one.song.as_str());
        guidance.push(AtScale::new(
            guidance_scale,
            songs.zip(&scores),
            reference.measure(&motions),
            settings.seed,
        ));
    }
    Ok(guidance)
}

fn go_on(flow: ControlFlow<()>) -> Result<(), Error> {
    match flow {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Interrupted),
    }
}

/// Everything that is heard in the place of a phrase's music.
fn all_music(listened: &Listened, seed: u64, others: &[Listened]) -> Vec<(Heard, Music)> {
    Heard::ALL
        .into_iter()
        .filter_map(|heard| Some((heard, listened.music(heard, seed, others)?)))
        .collect()
}

/// The post-processed samples of a phrase, `settings.seeds` for each of the `heard` features in
/// their order.
fn draw(
    generator: &Generator,
    listened: &Listened,
    heard: &[&AudioFeatures],
    settings: &ListeningSettings,
    sampling: &SamplingConfig,
    on_step: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
) -> Result<Vec<Phrase>, Error> {
    let seed = item_seed(settings.seed, &listened.phrase.id);
    let conditions: Vec<_> = heard
        .iter()
        .flat_map(|&heard| keys(seed, settings.seeds).map(move |key| (heard.clone(), key)))
        .collect();
    let mut motions = Vec::with_capacity(conditions.len());
    generator.sample_each(conditions.into_iter(), sampling, on_step, &mut |sample| {
        motions.push(sample.motion);
        Ok(())
    })?;
    Ok(motions)
}
