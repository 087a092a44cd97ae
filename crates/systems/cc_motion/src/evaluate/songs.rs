//! Metrics of samples for songs without motion.

use std::path::Path;

use kinegrad_audio::{FPS, Pulse};
use kinegrad_data::{AudioFeatures, MIN_FRAMES};
use kinegrad_settings::{Refused, counted, require};
use kinegrad_train::evaluation::{Evaluation, EvaluationRequest, OnStep, Results, with_sampling};
use kinegrad_train::song::{KnownBeats, song_features, songs_in};
use kinegrad_train::{Error, TrainedModel};
use serde_json::json;

use super::beat_verdict::beat_verdict;
use super::measures::{Beats, Reference};
use super::report::groups;
use super::{BATCH_HINT, BYTES_PER_FRAME, Measures, SampleSettings, counts, samples};
use crate::generate::{self, Generator};
use crate::lengths::{untrained, windows};
use crate::{CcMotionConfig, CondSource};

/// Most excerpts of all songs, unless the request or `evaluation.phrases` names a number.
const EXCERPTS: usize = 64;

/// Beats in a bar, unless `evaluation.beats_per_bar` is set.
const BEATS_PER_BAR: usize = 4;

/// A part of a song.
struct Excerpt {
    song: String,
    /// Name and first frame.
    name: String,
    audio: AudioFeatures,
    /// Number of beats up to each frame, as tracked in the whole song; `None` without beats.
    positions: Option<Vec<f64>>,
}

/// An evaluation on the songs in a folder, or on one song.
pub(super) fn prepare<'a>(
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
    folder: &Path,
) -> Result<Evaluation<'a>, Error> {
    let config = trained.config();
    let settings = &config.own::<CcMotionConfig>().evaluation;
    require(
        settings.cond == CondSource::Phrases,
        "evaluation.cond",
        "\"noise\" with songs",
        "\"phrases\", the music of the songs",
    )
    .hint("leave out the songs, or the key")?;
    let frames = request.num_frames.unwrap_or(config.data.target_frames);
    let mut excerpts = Vec::new();
    let files = songs_in(folder)?;
    for file in &files {
        excerpts.extend(excerpts_of(file, frames, trained)?);
    }
    let all = excerpts.len();
    let usual = settings.phrases.unwrap_or(EXCERPTS);
    let most = if request.num_samples.is_some() {
        all
    } else {
        usual
    };
    let [count, seeds] = counts(request.num_samples, most.min(all), settings.seeds);
    let excerpts = spread(excerpts, count);
    let lengths = excerpts.iter().map(|excerpt| excerpt.audio.frames());
    let memory = lengths.clone().map(|frames| frames as u64).sum::<u64>() * BYTES_PER_FRAME;
    let longest = lengths.clone().max().unwrap_or(frames);
    let processes = request.group.ranks().local().size;
    generate::must_fit(trained, seeds, longest, processes, BATCH_HINT)?;
    let generated = lengths.map(|frames| windows(config, frames).map_or(frames, |w| w.length()));
    let mut remarks: Vec<String> = untrained(config, generated).into_iter().collect();
    if count < all {
        remarks.push(format!(
            "{count} of {} of {} are sampled; `evaluation.phrases` and option `num_samples` set \
             their number",
            counted(all, "excerpt"),
            counted(files.len(), "song")
        ));
    }
    remarks.push(
        "songs without motion: there are no distances to real motion and no values of real motion"
            .into(),
    );
    let songs = files.len();
    let settings = SampleSettings {
        seeds,
        seed: request.seed,
        cond: settings.cond,
    };
    let group = request.group.clone();
    let measure = move |on_step: &mut OnStep<'_>| {
        let generator = Generator::load(trained)?;
        let music = |index: usize| {
            let Excerpt { name, audio, .. } = &excerpts[index];
            (name.clone(), audio.clone())
        };
        let of_each = samples(&generator, count, music, settings, &group, on_step)?;
        let measured = measured(&excerpts, &generator, of_each);
        Ok(results(measured, [songs, count], settings, &generator))
    };
    Ok(Evaluation {
        report: "eval-songs",
        memory: memory.saturating_mul(seeds as u64),
        memory_hint: "all samples are compared with each other: choose fewer samples (option \
                      `num_samples`)",
        remarks,
        measure: Box::new(measure),
    })
}

/// The parts of a song, of `frames` frames each; a shorter song is one part.
fn excerpts_of(file: &Path, frames: usize, trained: &TrainedModel) -> Result<Vec<Excerpt>, Error> {
    let known = KnownBeats::default();
    let features = song_features(file, &known)?.1;
    let pulse = known.pulse(&features);
    let layout = trained.config().data.audio_layout();
    let audio = AudioFeatures::of_song(&features, layout, pulse.as_ref());
    let song = file.file_stem().unwrap_or_default().to_string_lossy();
    let all = audio.frames();
    if all < MIN_FRAMES {
        let message = format!("{} has {}", file.display(), counted(all, "frame"));
        let hint = format!("samples need {MIN_FRAMES} or more: remove the song");
        return Err(Error::usage(message, hint));
    }
    let length = frames.min(all);
    let starts = (0..=all - length).step_by(length);
    let excerpt = |start: usize| {
        let position = |pulse: &Pulse, t: usize| pulse.position((start + t) as f64 / FPS);
        let positions = |pulse: &Pulse| (0..length).map(|t| position(pulse, t)).collect();
        Excerpt {
            name: format!("{song}_{start:05}"),
            audio: audio.slice(start..start + length),
            positions: pulse.as_ref().map(positions),
            song: song.to_string(),
        }
    };
    Ok(starts.map(excerpt).collect())
}

/// `count` evenly spaced elements.
fn spread<T>(all: Vec<T>, count: usize) -> Vec<T> {
    let total = all.len();
    let is_taken = |index: usize| (index * count) % total < count;
    let taken = all.into_iter().enumerate();
    let taken = taken.filter(|(index, _)| is_taken(*index));
    taken.map(|(_, each)| each).collect()
}

/// The measures of the processed and of the raw samples.
fn measured(
    excerpts: &[Excerpt],
    generator: &Generator,
    [raw, processed]: [Vec<Vec<kinegrad_motion::Phrase>>; 2],
) -> [Measures; 2] {
    let evaluation = &generator.config().own::<CcMotionConfig>().evaluation;
    let beats_per_bar = evaluation.beats_per_bar.unwrap_or(BEATS_PER_BAR) as f64;
    let beats = excerpts.iter().map(|excerpt| {
        Some(Beats::Tracked {
            song: excerpt.song.clone(),
            beats_per_bar,
            positions: excerpt.positions.clone()?,
        })
    });
    let music = excerpts.iter().map(|excerpt| &excerpt.audio);
    let reference = Reference::of_music(music, beats.collect(), generator.statistics());
    let reference = reference.with_thresholds(evaluation.thresholds);
    [reference.measure(&processed), reference.measure(&raw)]
}

fn results(
    [processed, raw]: [Measures; 2],
    [songs, excerpts]: [usize; 2],
    settings: SampleSettings,
    generator: &Generator,
) -> Results {
    let mut verdict = vec![processed.strict.verdict(None)];
    let error = processed.beat_phase_error.as_ref();
    verdict.extend(error.map(|error| beat_verdict(error, excerpts, None)));
    let json = json!({
        "songs": songs,
        "excerpts": excerpts,
        "seeds": settings.seeds,
        "cond": "songs",
        "processed": processed,
        "raw": raw,
        "real": null,
    });
    let samples = groups(&processed, &raw);
    let mut real = samples.clone();
    let numbers = real.iter_mut().flat_map(|group| &mut group.numbers);
    numbers.for_each(|number| {
        number.value = None;
        if let Some((_, shown)) = &mut number.line {
            *shown = None;
        }
    });
    Results {
        json: with_sampling(json, &generator.config().sampling),
        facts: vec![
            ("songs", [Some(songs as u64), None]),
            ("excerpts", [Some(excerpts as u64), None]),
            ("seeds", [Some(settings.seeds as u64), None]),
        ],
        samples: Some(samples),
        real,
        verdict,
        remarks: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn excerpts_are_spread_over_all_songs() {
        assert_eq!(spread((0..10).collect(), 10), (0..10).collect::<Vec<_>>());
        assert_eq!(spread((0..10).collect(), 5), [0, 2, 4, 6, 8]);
        let three = spread((0..100).collect::<Vec<usize>>(), 3);
        assert_eq!(three, [0, 34, 67]);
        assert_eq!(spread(vec![7], 1), [7]);
    }
}
