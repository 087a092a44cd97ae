//! Sampling phrases conditioned on audio.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::iter::repeat_n;
use std::path::{Path, PathBuf};

use kinegrad_data::{AudioFeatures, DataConfig, DataKind, Dataset, Phrase, load_audio};
use kinegrad_models::Beats;
use kinegrad_motion::path::PathPlan;
use kinegrad_motion::phrase::FPS;
use kinegrad_motion::postprocess::PostProcessConfig;
use kinegrad_motion::stitch::Windows;
use kinegrad_motion::{CHANNELS, Motion, OrientationTarget, Profile, Report, Statistics, check};
use kinegrad_random::{Key, Purpose};

use super::generate::{Generator, Sample, keys, must_fit};
use super::lengths::{untrained, windows};
use super::networks::targets;
use super::path::Asked;
use super::style::must_know;
use super::whole::{WINDOWS_IN_FLIGHT, Whole};
use super::{CcMotion, CcMotionConfig, CcMotionNetwork};
use crate::TrainedModel;
use crate::config::Config;
use crate::error::Error;
use crate::path_target::{in_words, read_path};
use crate::sampling::{
    Condition, Conditions, Contents, Drawn, GivenFrames, GivenMotion, Kept, Names, Receiver,
    Record, Remark, Request, WindowsRecord, item_seed,
};
use crate::song::song_features;
use crate::system::System as _;

/// Extension of the post-processed motion.
const MOTION: &str = ".npy";

/// Extension of the raw model output.
const RAW: &str = ".raw.npy";

/// What to do where held-out samples do not fit into memory.
const HELD_OUT_HINT: &str = "draw none at the end of training (`sampling.count_at_end = 0`), or \
                             prepare shorter phrases";

/// Of the frames of a window, that of which one part in so many continues another motion at most.
const CONTINUED_SHARE: usize = 4;

/// What to do where samples do not fit into memory.
const HINT: &str = "draw shorter ones (`--frames`), or fewer";

/// Generates the requested phrases, each post-processed and as raw model output.
///
/// # Errors
/// If a condition cannot be used, or the checkpoint cannot be read.
pub(super) fn sample(
    trained: &TrainedModel,
    request: &Request,
    receiver: &mut dyn Receiver,
) -> Result<Option<Remark>, Error> {
    request.conditions.refuse(
        &[
            "--goal",
            "--trajectory-run",
            "--text",
            "--text-embedding",
            "--history",
            "--prompts",
        ],
        "a run on phrases",
        "goals and texts are conditions of recipes `gmd_motion` and `gmd_trajectory`, histories and \
         plans of recipe `flow`",
    )?;
    if let Some(count) = request.conditions.held_out {
        return for_held_out(trained, count, request, receiver).map(Some);
    }
    let style = request.conditions.style.as_ref();
    if let Some(style) = style {
        must_know(style, trained.config())?;
    }
    let path = request
        .conditions
        .path
        .as_ref()
        .map(read_path)
        .transpose()?;
    let conditions = conditions(request, trained.config(), receiver)?;
    let mut drawings = Vec::with_capacity(conditions.len());
    for mut heard in conditions {
        heard.condition.style = style.cloned();
        drawings.push(drawing(heard, request, trained.config(), path.as_ref())?);
    }
    let lengths = drawings.iter().map(|drawing| match &drawing.whole {
        Some((windows, _)) => windows.length(),
        None => drawing.heard.audio.frames(),
    });
    if let Some(odd) = untrained(trained.config(), lengths) {
        receiver.warning(&odd);
    }
    for drawing in &drawings {
        let (count, frames) = match &drawing.whole {
            Some((windows, _)) => (windows.len().min(WINDOWS_IN_FLIGHT), windows.length()),
            None => (request.count, drawing.heard.audio.frames()),
        };
        must_fit(trained, count, frames, 1, HINT)?;
    }
    let several = drawings.len() > 1;
    let stem = |heard: &Heard| match several {
        true => format!("-{}", heard.name),
        false => String::new(),
    };
    let names = Names {
        stems: drawings
            .iter()
            .map(|drawing| stem(&drawing.heard))
            .collect(),
        count: request.count,
    };
    receiver.announced(&names, &[MOTION, RAW])?;
    let post_processing = PostProcessConfig::from(request.post_processing.unwrap_or_default());
    let generator = Generator::load(trained)?
        .with_post_processing(post_processing)
        .with_style(style)?;
    let mut remarks = Vec::new();
    for Drawing { heard, whole, path } in drawings {
        let too_fast = |path: &Asked| path.too_fast(generator.statistics());
        if let Some(warning) = path.as_ref().and_then(too_fast) {
            receiver.warning(&warning);
        }
        let seed = item_seed(request.seed, &heard.name);
        let stem = stem(&heard);
        if let Some((windows, given)) = &whole {
            let whole = Whole {
                audio: &heard.audio,
                windows: windows.clone(),
                given: given.as_ref(),
                path: path.as_ref().map(|path| &path.followed),
                in_flight: WINDOWS_IN_FLIGHT,
            };
            let key = Key::new(seed, Purpose::Sampling);
            for index in 0..request.count {
                let sample = generator.sample_whole(
                    &whole,
                    &trained.config().sampling,
                    key.at(index as u64),
                    &mut |done, all| {
                        let before = index.saturating_mul(all);
                        let wanted = request.count.saturating_mul(all);
                        receiver.advance("windows", before.saturating_add(done), wanted)
                    },
                )?;
                let path = path.as_ref().map(|path| path.record(&sample.motion));
                remarks.extend(path.as_ref().map(|path| in_words(&path.report)));
                let record = Record {
                    index,
                    path,
                    windows: Some(windows_record(windows)),
                    condition: heard.condition.clone(),
                    ..record(trained, request, &sample)
                };
                receiver.drawn(drawn(names.of(&stem, index), sample, record))?;
            }
            continue;
        }
        let mut index = 0;
        let receiver = RefCell::new(&mut *receiver);
        generator.sample_each(
            repeat_n(heard.audio, request.count).zip(keys(seed, request.count)),
            &trained.config().sampling,
            &mut |done, all| receiver.borrow_mut().advance("", done, all),
            &mut |sample| {
                let name = names.of(&stem, index);
                let record = Record {
                    index,
                    condition: heard.condition.clone(),
                    ..record(trained, request, &sample)
                };
                index += 1;
                receiver.borrow_mut().drawn(drawn(name, sample, record))
            },
        )?;
    }
    Ok((!remarks.is_empty()).then(|| Remark::Text(remarks.join("\n"))))
}

/// Generates one sample for each of the first `count` held-out phrases, or training phrases if none
/// are held out, and checks them. They are those that `kinegrad sample --item` generates with the
/// same seed.
fn for_held_out(
    trained: &TrainedModel,
    count: usize,
    request: &Request,
    receiver: &mut dyn Receiver,
) -> Result<Remark, Error> {
    let dataset =
        Dataset::<Phrase>::open_with_progress(&trained.config().data, &*receiver.reading())?;
    let chosen = dataset.held_out().first(count)?;
    let lengths: BTreeSet<usize> = chosen.iter().map(|phrase| phrase.audio.frames()).collect();
    for frames in lengths {
        must_fit(trained, chosen.len(), frames, 1, HELD_OUT_HINT)?;
    }
    let post_processing = PostProcessConfig::from(request.post_processing.unwrap_or_default());
    let generator = Generator::load(trained)?.with_post_processing(post_processing);
    let header = ["sample", "ccmotion", "strict", "fails"];
    let mut rows = vec![header.map(String::from).to_vec()];
    let mut done_before = 0;
    // Phrases of one length form a batch, if they are not longer than training saw; each has the first sample that is drawn for its name.
    for phrases in chosen.chunk_by(|a, b| a.audio.frames() == b.audio.frames()) {
        let conditions: Vec<_> = phrases
            .iter()
            .flat_map(|phrase| {
                keys(item_seed(request.seed, &phrase.id), 1).map(|key| (phrase.audio.clone(), key))
            })
            .collect();
        let mut samples = Vec::with_capacity(phrases.len());
        generator.sample_each(
            conditions.into_iter(),
            &trained.config().sampling,
            &mut |done, all| {
                let steps = done_before * all + phrases.len() * done;
                receiver.advance("", steps, chosen.len() * all)
            },
            &mut |sample| {
                samples.push(sample);
                Ok(())
            },
        )?;
        for (phrase, sample) in phrases.iter().zip(samples) {
            rows.push(checked(&phrase.id, &sample.motion, generator.statistics())?);
            let windows = windows(trained.config(), phrase.audio.frames())?;
            let record = Record {
                windows: windows.as_ref().map(windows_record),
                condition: of_item(&phrase.id, &trained.config().data),
                ..record(trained, request, &sample)
            };
            receiver.drawn(drawn(phrase.id.clone(), sample, record))?;
        }
        done_before += phrases.len();
    }
    Ok(Remark::Table(rows))
}

/// A line of both profiles' verdicts.
fn checked(name: &str, motion: &Motion, statistics: &Statistics) -> Result<Vec<String>, Error> {
    let document = Some(check(motion, Profile::Document, None)?);
    // Statistics of before the movement was measured say too little.
    let strict = check(motion, Profile::Strict, Some(statistics)).ok();
    let reports = document.iter().chain(&strict);
    let checks = reports.flat_map(|report| &report.checks);
    let failed = checks.filter(|check| !check.passed);
    let mut failed: Vec<&str> = failed.map(|check| check.name).collect();
    failed.dedup();
    let verdict = |report: &Option<Report>| {
        let verdict = match report {
            Some(report) if report.passed => "ok",
            Some(_) => "FAIL",
            None => "-",
        };
        verdict.to_string()
    };
    Ok(vec![
        name.to_string(),
        verdict(&document),
        verdict(&strict),
        failed.join(", "),
    ])
}

/// What every sample's record says.
fn record(trained: &TrainedModel, request: &Request, sample: &Sample) -> Record {
    Record {
        frames: sample.motion.frames(),
        fps: FPS,
        post_processing: Some(request.post_processing.unwrap_or_default().into()),
        ..Record::new(CcMotion.name(), trained, request.seed)
    }
}

fn windows_record(windows: &Windows) -> WindowsRecord {
    WindowsRecord {
        frames: windows.length(),
        count: windows.len(),
        in_flight: WINDOWS_IN_FLIGHT,
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

/// What is drawn for an audio condition.
struct Drawing {
    heard: Heard,
    /// The windows and the given frames, of motion that is not drawn as one.
    whole: Option<(Windows, Option<GivenMotion>)>,
    /// The path that it follows.
    path: Option<Asked>,
}

/// What is drawn for `heard`: in windows, if it is longer than what training saw, if frames are given or
/// if it follows a path.
fn drawing(
    mut heard: Heard,
    request: &Request,
    config: &Config,
    path: Option<&(PathBuf, PathPlan)>,
) -> Result<Drawing, Error> {
    let (frames, trained) = (heard.audio.frames(), config.data.target_frames);
    let is_song = request.conditions.song.is_some();
    let given = match &request.conditions.given {
        None => None,
        Some(given) => {
            let motion = given.read(frames, trained.min(frames) / CONTINUED_SHARE)?;
            heard.condition.kept = Some(Kept {
                motion: given.motion.clone(),
                frames: motion.frames.iter().map(|r| [r.start, r.end]).collect(),
                continued: given.frames == GivenFrames::Last,
            });
            Some(motion)
        }
    };
    let length = frames.min(trained);
    let evaluation = &config.own::<CcMotionConfig>().evaluation;
    let path = path.map(|path| Asked::new(path, frames, &evaluation.path));
    let path = path.transpose()?;
    let must_join = given.is_some() || path.is_some() || (is_song && frames > length);
    if must_join && targets(config).orientation == OrientationTarget::CanonicalQuaternion {
        let message = "a run with `model.orientation_target = \"canonical_quaternion\"` draws each motion \
                       from its own first heading: windows of a song, given frames and paths do \
                       not fit together";
        let hint = "draw parts of a song (`--frames`), or train with `rotation_6d`";
        return Err(Error::usage(message, hint));
    }
    let windows = match given.is_some() || path.is_some() {
        true => Some(Windows::new(frames, length)),
        false => windows(config, frames)?,
    };
    let whole = windows.map(|windows| (windows, given));
    Ok(Drawing { heard, whole, path })
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
    let CcMotionNetwork::Unet1d(unet) = &config.own::<CcMotionConfig>().model.network;
    if let (Beats::Tracked, Some(option)) = (unet.beats, known.given().first()) {
        return Err(Error::usage(
            format!("`{option}` with a run that finds the beats itself"),
            "leave it out; `model.beats = \"given\"` trains models that are told them",
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
    let end = match request.frames {
        Some(frames) => audio.frames().min(start + frames),
        None => audio.frames(),
    };
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
            let hint = "name one with `--item ID`; `kinegrad data inspect URI` lists them";
            return Err(Error::usage("`--source` without `--item`", hint));
        }
    }
    let dataset = Dataset::<Phrase>::open_with_progress(&data, &*receiver.reading())?;
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
