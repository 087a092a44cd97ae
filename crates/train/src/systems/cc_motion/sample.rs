//! Sampling phrases conditioned on audio.

use std::cell::RefCell;
use std::iter::repeat_n;
use std::path::Path;

use kinegrad_data::{AudioFeatures, DataConfig, DataKind, Dataset, Phrase, load_audio};
use kinegrad_motion::phrase::FPS;
use kinegrad_motion::postprocess::PostProcessConfig;
use kinegrad_motion::{CHANNELS, Motion, Profile, Statistics, check};

use super::CcMotion;
use super::evaluate::phrase_seed;
use super::generate::{Generator, Sample, must_fit};
use crate::config::Config;
use crate::error::Error;
use crate::sampling::{
    Condition, Conditions, Contents, Drawn, Names, Receiver, Record, Remark, Request, Subject,
};
use crate::song::song_features;
use crate::system::System as _;

/// Extension of the post-processed motion.
const MOTION: &str = ".npy";

/// Extension of the raw model output.
const RAW: &str = ".raw.npy";

/// What to do where held-out samples do not fit into memory.
const HELD_OUT_HINT: &str = "draw fewer at the end of training (`sampling.count_at_end`), or train \
                             on shorter phrases (`data.target_frames`)";

/// What to do where samples do not fit into memory.
const HINT: &str = "draw shorter ones (`--frames`), or fewer";

/// Generates the requested phrases, each post-processed and as raw model output.
///
/// # Errors
/// If a condition cannot be used, or the checkpoint cannot be read.
pub(super) fn sample(
    subject: &Subject,
    request: &Request,
    receiver: &mut dyn Receiver,
) -> Result<Option<Remark>, Error> {
    request.conditions.refuse(
        &["--goal", "--trajectory-run", "--text-embedding"],
        "a run on phrases",
        "goals and text embeddings are conditions of recipes `gmd_motion` and `gmd_trajectory`",
    )?;
    if let Some(count) = request.conditions.held_out {
        return for_held_out(subject, count, request.seed, receiver).map(Some);
    }
    let conditions = conditions(request, &subject.config, receiver)?;
    let lengths = conditions.iter().map(|heard| heard.audio.frames());
    must_fit(
        subject,
        request.count,
        lengths.max().unwrap_or_default(),
        HINT,
    )?;
    let several = conditions.len() > 1;
    let stem = |heard: &Heard| match several {
        true => format!("-{}", heard.name),
        false => String::new(),
    };
    let names = Names {
        stems: conditions.iter().map(stem).collect(),
        count: request.count,
    };
    receiver.announced(&names, &[MOTION, RAW])?;
    let generator = Generator::load(&subject.checkpoint, subject.weights, &subject.device)?;
    for heard in conditions {
        let mut index = 0;
        let stem = stem(&heard);
        let receiver = RefCell::new(&mut *receiver);
        generator.sample_each(
            repeat_n(heard.audio, request.count),
            &subject.config.sampling,
            phrase_seed(request.seed, &heard.name),
            &mut |done, all| receiver.borrow_mut().advance("", done, all),
            &mut |sample| {
                let name = names.of(&stem, index);
                let record = Record {
                    index,
                    condition: heard.condition.clone(),
                    ..record(subject, request.seed, &sample)
                };
                index += 1;
                receiver.borrow_mut().drawn(drawn(name, sample, record))
            },
        )?;
    }
    Ok(None)
}

/// Generates one sample for each of the first `count` held-out phrases, or training phrases if none
/// are held out, and checks them.
fn for_held_out(
    subject: &Subject,
    count: usize,
    seed: u64,
    receiver: &mut dyn Receiver,
) -> Result<Remark, Error> {
    let dataset = Dataset::<Phrase>::open(&subject.config.data)?;
    let chosen = dataset.held_out().first(count)?;
    let frames = chosen.iter().map(|p| p.audio.frames()).min().unwrap_or(0);
    must_fit(subject, chosen.len(), frames, HELD_OUT_HINT)?;
    let generator = Generator::load(&subject.checkpoint, subject.weights, &subject.device)?;
    let conditions: Vec<_> = chosen.iter().map(|p| p.audio.slice(0..frames)).collect();
    let sampling = &subject.config.sampling;
    let samples = generator.sample(&conditions, sampling, seed, &mut |done, all| {
        receiver.advance("", done, all)
    })?;
    let header = ["sample", "document", "strict", "fails"];
    let mut rows = vec![header.map(String::from).to_vec()];
    for (index, (phrase, sample)) in chosen.iter().zip(samples).enumerate() {
        rows.push(checked(&phrase.id, &sample.motion, generator.statistics())?);
        let record = Record {
            index,
            condition: of_item(&phrase.id, &subject.config.data),
            ..record(subject, seed, &sample)
        };
        receiver.drawn(drawn(phrase.id.clone(), sample, record))?;
    }
    Ok(Remark::Table(rows))
}

/// A line of both profiles' verdicts.
fn checked(name: &str, motion: &Motion, statistics: &Statistics) -> Result<Vec<String>, Error> {
    let document = check(motion, Profile::Document, None)?;
    let strict = check(motion, Profile::Strict, Some(statistics))?;
    let checks = document.checks.iter().chain(&strict.checks);
    let failed = checks.filter(|check| !check.passed);
    let mut failed: Vec<&str> = failed.map(|check| check.name).collect();
    failed.dedup();
    let verdict = |passed| if passed { "ok" } else { "FAIL" }.to_string();
    Ok(vec![
        name.to_string(),
        verdict(document.passed),
        verdict(strict.passed),
        failed.join(", "),
    ])
}

/// What every sample's record says.
fn record(subject: &Subject, seed: u64, sample: &Sample) -> Record {
    Record {
        frames: sample.motion.frames(),
        fps: FPS,
        post_processing: Some(PostProcessConfig::default()),
        ..Record::new(CcMotion.name(), subject, seed)
    }
}

/// The condition of an item of a dataset.
fn of_item(id: &str, data: &DataConfig) -> Condition {
    Condition {
        item: Some(id.to_string()),
        source: data.source.clone(),
        ..Condition::default()
    }
}

fn drawn(name: String, sample: Sample, record: Record) -> Drawn {
    let array = |motion: Motion| Contents::Array {
        shape: vec![motion.frames(), CHANNELS],
        values: motion.into_vec(),
    };
    Drawn {
        name,
        files: vec![(MOTION, array(sample.motion)), (RAW, array(sample.raw))],
        record,
    }
}

/// An audio condition.
struct Heard {
    /// What stands for it in file names, and in the seed of its noise.
    name: String,
    audio: AudioFeatures,
    condition: Condition,
}

/// The conditions, cut to the requested number of frames.
fn conditions(
    request: &Request,
    config: &Config,
    receiver: &mut dyn Receiver,
) -> Result<Vec<Heard>, Error> {
    let Conditions {
        audio_features,
        song,
        ..
    } = &request.conditions;
    let found = match (audio_features, song) {
        (Some(path), _) => vec![Heard {
            name: "cond".to_string(),
            audio: load_audio(path, config.data.audio_layout())?,
            condition: Condition {
                audio_features: Some(path.clone()),
                ..Condition::default()
            },
        }],
        (None, Some(song)) => vec![of_song(song, request, config)?],
        (None, None) => of_phrases(&request.conditions, config, receiver)?,
    };
    let Some(frames) = request.frames else {
        return Ok(found);
    };
    let cut = |heard: Heard| {
        let Heard { name, audio, .. } = &heard;
        if frames == 0 || frames > audio.frames() {
            let message = format!(
                "`--frames` is {frames}, the condition `{name}` has {} frames",
                audio.frames()
            );
            return Err(Error::usage(message, "ask for 1 up to that many"));
        }
        Ok(Heard {
            audio: audio.slice(0..frames),
            ..heard
        })
    };
    found.into_iter().map(cut).collect()
}

/// The features of a whole song, from the requested start: of a part alone they would be
/// normalised otherwise than what the model was trained on.
fn of_song(song: &Path, request: &Request, config: &Config) -> Result<Heard, Error> {
    let (layout, known) = (config.data.audio_layout(), &request.conditions.beats);
    if let (false, Some(option)) = (layout.beats, known.given().first()) {
        return Err(Error::usage(
            format!("`{option}` with a run that hears no beat features"),
            "leave it out; data.audio_features = [\"document\", \"beats\"] trains with them",
        ));
    }
    let features = song_features(song, known)?.1;
    let audio = AudioFeatures::of_song(&features, layout, known.pulse(&features).as_ref());
    let begins = request.conditions.start;
    let start = begins * kinegrad_audio::FPS;
    let left = audio.frames() as f64 - start;
    let name = song.file_stem().unwrap_or_default().to_string_lossy();
    if !(start >= 0.0 && left >= 1.0) {
        let message = format!(
            "`--start` is {begins}, the song {name} has {:.1} seconds",
            audio.frames() as f64 / kinegrad_audio::FPS
        );
        return Err(Error::usage(message, "give a moment within the song"));
    }
    let start = start.round() as usize;
    let most = request.frames.unwrap_or(config.data.target_frames);
    let end = audio.frames().min(start + most.max(1));
    Ok(Heard {
        name: name.into_owned(),
        audio: audio.slice(start..end),
        condition: Condition {
            song: Some(song.to_path_buf()),
            start: Some(begins),
            beats: (!known.given().is_empty()).then(|| known.clone()),
            ..Condition::default()
        },
    })
}

fn of_phrases(
    conditions: &Conditions,
    config: &Config,
    receiver: &mut dyn Receiver,
) -> Result<Vec<Heard>, Error> {
    let mut data = config.data.clone();
    if let Some(source) = &conditions.source {
        data.kind = DataKind::Phrases;
        data.source = Some(source.clone());
        if conditions.item.is_none() {
            let hint = "name one with `--phrase ID`; `kinegrad data inspect URI` lists them";
            return Err(Error::usage("`--source` without `--phrase`", hint));
        }
    }
    let dataset = Dataset::<Phrase>::open(&data)?;
    let mut found = Vec::new();
    for side in [&dataset.validation, &dataset.train] {
        match &conditions.item {
            None if found.is_empty() && !side.is_empty() => found.push(side.get(0)?),
            None => {}
            Some(pattern) => {
                let chosen = side.filter(|id| kinegrad_data::matches(pattern, id));
                found.extend(chosen.load()?);
            }
        }
    }
    if found.is_empty() {
        let wanted = conditions.item.as_deref().unwrap_or_default();
        let message = format!("the dataset has no phrase `{wanted}`");
        let hint = "`kinegrad data inspect URI` lists the phrases";
        return Err(Error::usage(message, hint));
    }
    if conditions.item.is_none() {
        let side = match dataset.validation.is_empty() {
            true => "training phrase",
            false => "held-out phrase",
        };
        let id = &found[0].id;
        receiver.note(&format!("no condition given: using {side} {id}"));
    }
    let found = found.into_iter();
    Ok(found
        .map(|phrase| Heard {
            name: phrase.id.clone(),
            audio: phrase.audio.clone(),
            condition: of_item(&phrase.id, &data),
        })
        .collect())
}
