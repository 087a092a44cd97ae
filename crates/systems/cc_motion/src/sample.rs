//! Sampling phrases conditioned on audio.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::iter::repeat_n;
use std::path::{Path, PathBuf};

use kinegrad_audio::beats::track;
use kinegrad_data::{Alone, AudioFeatures, DataConfig, DataKind, Dataset, PhraseItem, load_audio};
use kinegrad_motion::metrics::{beat_alignment, speed_peaks};
use kinegrad_motion::path::PathPlan;
use kinegrad_motion::postprocess::PostProcessConfig;
use kinegrad_motion::stitch::Windows;
use kinegrad_motion::{
    OrientationEncoding, Phrase, Profile, Report, SanityThresholds, Statistics, check,
    check_thresholds,
};
use kinegrad_settings::counted;
use kinegrad_train::clips::path_target::read_path;
use kinegrad_train::config::Config;
use kinegrad_train::sampling::{
    Condition, Generated, Job, KnownFrames, Needs, Record, Request, Run, SampleSink, Sampler,
    Summary, WindowsRecord, item_seed,
};
use kinegrad_train::song::{KnownBeats, song_features};
use kinegrad_train::{Error, TrainedModel};

use super::generate::{Generator, Sample, keys, needs};
use super::lengths::{untrained, windows};
use super::load::{targets, unet1d};
use super::path::PathCondition;
use super::style::must_know;
use super::windowed::{WINDOWS_IN_FLIGHT, WindowedSampling};
use super::{CcMotionConfig, EvaluationConfig};
use crate::network::Beats;

/// Conditions of phrases.
pub(super) const ACCEPTS: &[&str] = &[
    "item",
    "held_out",
    "audio_features",
    "song",
    "style",
    "path",
    "continue_from",
    "keep",
    "postprocess",
];

/// Hint for held-out samples that do not fit into memory.
const HELD_OUT_HINT: &str = "sample none at the end of training (`sampling.count_at_end = 0`), or \
                             prepare shorter phrases";

/// At most 1 / `CONTINUED_SHARE` of the frames of a window continue another motion.
const CONTINUED_SHARE: usize = 4;

/// Hint for samples that do not fit into memory.
const HINT: &str = "ask for shorter ones (option `frames`), or fewer";

/// A request for phrases.
pub(super) struct Phrases<'a> {
    trained: &'a TrainedModel,
    request: &'a Request,
    jobs: Vec<Job>,
    /// One for each job.
    tasks: Vec<Task>,
}

/// The input of a job.
struct Task {
    /// The condition in file names and in the seed of the noise.
    name: String,
    audio: AudioFeatures,
    /// Beats of the audio, seconds.
    beats: Vec<f64>,
    /// The windows and the known frames; `None` for motion sampled as a whole.
    windows: Option<(Windows, Option<KnownFrames>)>,
    path: Option<PathCondition>,
}

/// An audio condition.
struct Audio {
    name: String,
    features: AudioFeatures,
    condition: Condition,
}

impl<'a> Phrases<'a> {
    /// Reads the conditions of a request.
    pub fn new(
        trained: &'a TrainedModel,
        request: &'a Request,
        sink: &mut dyn SampleSink,
    ) -> Result<Self, Error> {
        let config = trained.config();
        let mut resolved = Self {
            trained,
            request,
            jobs: Vec::new(),
            tasks: Vec::new(),
        };
        if let Some(count) = request.held_out_items() {
            let dataset =
                Dataset::<PhraseItem>::open_among(&config.data, &*sink.reading(), &Alone)?;
            for phrase in dataset.held_out().first(count)? {
                let windows = windows(config, phrase.audio.frames()).map(|windows| (windows, None));
                resolved.push(of_phrase(&phrase, &config.data), Vec::new(), windows, None);
            }
            return Ok(resolved);
        }
        if let Some(style) = request.style() {
            must_know(style, config)?;
        }
        let path = request.path().map(read_path).transpose()?;
        for audio in audio(request, config, sink)? {
            resolved.resolve(audio, path.as_ref())?;
        }
        let lengths = resolved.tasks.iter().map(|task| match &task.windows {
            Some((windows, _)) => windows.length(),
            None => task.audio.frames(),
        });
        if let Some(doubt) = untrained(config, lengths) {
            sink.warning(&doubt);
        }
        Ok(resolved)
    }

    fn push(
        &mut self,
        audio: Audio,
        others: Vec<Condition>,
        windows: Option<(Windows, Option<KnownFrames>)>,
        path: Option<PathCondition>,
    ) {
        self.jobs.push(Job {
            name: Some(audio.name.clone()),
            frames: audio.features.frames(),
            conditions: [audio.condition].into_iter().chain(others).collect(),
            caption: None,
        });
        self.tasks.push(Task {
            name: audio.name,
            beats: track(audio.features.onset_strength()).times(),
            audio: audio.features,
            windows,
            path,
        });
    }

    /// Adds the job of an audio condition. Long conditions, known frames and paths need windows.
    fn resolve(&mut self, audio: Audio, path: Option<&(PathBuf, PathPlan)>) -> Result<(), Error> {
        let (request, config) = (self.request, self.trained.config());
        let (frames, trained) = (audio.features.frames(), config.data.target_frames);
        let is_song = matches!(audio.condition, Condition::Song { .. });
        let mut others = Vec::new();
        others.extend(request.style().cloned().map(Condition::Style));
        let length = frames.min(trained);
        let mut known = None;
        if let Some(condition) = request.known_frames() {
            let read = condition.read(frames, length / CONTINUED_SHARE)?;
            let mut condition = condition.clone();
            condition.frames = read.frames.iter().map(|r| [r.start, r.end]).collect();
            others.push(Condition::KnownFrames(condition));
            known = Some(read);
        }
        let evaluation = &config.own::<CcMotionConfig>().evaluation;
        let path = path
            .map(|path| PathCondition::new(path, frames, &evaluation.path))
            .transpose()?;
        let must_join = known.is_some() || path.is_some();
        if (must_join || (is_song && frames > length))
            && targets(config).orientation == OrientationEncoding::CanonicalQuaternion
        {
            let message = "a run with `model.orientation_target = \"canonical_quaternion\"` samples \
                           each motion from its own first heading: windows of a song, known frames \
                           and paths do not fit together";
            let hint = "sample parts of a song (option `frames`), or train with `rotation_6d`";
            return Err(Error::usage(message, hint));
        }
        others.extend(request.path().cloned().map(Condition::Path));
        let windows = match must_join {
            true => Some(Windows::new(frames, length)),
            false => windows(config, frames),
        };
        let windows = windows.map(|windows| (windows, known));
        self.push(audio, others, windows, path);
        Ok(())
    }

    /// The record of a phrase.
    fn record(&self, run: &Run<'_>, job: usize, index: usize, motion: &Phrase) -> Record {
        let Task { windows, beats, .. } = &self.tasks[job];
        let windows = windows.as_ref();
        Record {
            beat_alignment: beat_alignment(&speed_peaks(motion), beats),
            post_processing: Some(self.post_processing()),
            windows: windows.map(|(windows, _)| WindowsRecord {
                frames: windows.length(),
                count: windows.len(),
                in_flight: WINDOWS_IN_FLIGHT,
            }),
            ..run.record(job, index)
        }
    }

    fn post_processing(&self) -> PostProcessConfig {
        match self.request.post_processing {
            Some(profile) => profile.into(),
            None => self.evaluation().postprocess.clone(),
        }
    }

    fn evaluation(&self) -> &EvaluationConfig {
        &self.trained.config().own::<CcMotionConfig>().evaluation
    }

    /// One sample for each held-out phrase, with a table of checks. The samples equal the first
    /// samples requested by the phrases' ids with the same seed.
    fn held_out(&self, run: &mut Run<'_>, generator: &Generator) -> Result<Summary, Error> {
        let sampling = &self.trained.config().sampling;
        let header = ["sample", "ccmotion", "strict", "fails"];
        let mut rows = vec![header.map(String::from).to_vec()];
        let (mut first, all) = (0, self.tasks.len());
        // Phrases of one length form a batch.
        let same_length = |a: &Task, b: &Task| a.audio.frames() == b.audio.frames();
        for tasks in self.tasks.chunk_by(same_length) {
            let conditions = tasks.iter().map(|task| {
                let seed = item_seed(self.request.seed, &task.name);
                let key = keys(seed, 1).next().expect("one key");
                (task.audio.clone(), key)
            });
            let mut samples = Vec::with_capacity(tasks.len());
            generator.sample_each(
                conditions,
                sampling,
                &mut |done, steps| {
                    run.sink
                        .advance("", first * steps + tasks.len() * done, all * steps)
                },
                &mut |sample| {
                    samples.push(sample);
                    Ok(())
                },
            )?;
            for (offset, sample) in samples.into_iter().enumerate() {
                let job = first + offset;
                let name = &self.tasks[job].name;
                let thresholds = &self.evaluation().thresholds;
                rows.push(checked(
                    name,
                    &sample.motion,
                    generator.statistics(),
                    thresholds,
                ));
                let record = self.record(run, job, 0, &sample.motion);
                run.pass(job, 0, generated(sample), record)?;
            }
            first += tasks.len();
        }
        Ok(Summary::Table(rows))
    }
}

impl Sampler for Phrases<'_> {
    fn jobs(&self) -> &[Job] {
        &self.jobs
    }

    fn extensions(&self) -> &'static [&'static str] {
        Generated::PHRASE
    }

    fn needs(&self) -> Result<Vec<Needs>, Error> {
        if self.request.held_out_items().is_some() {
            let lengths: BTreeSet<usize> = self.jobs.iter().map(|job| job.frames).collect();
            let needs = |frames| needs(self.trained, self.jobs.len(), frames, HELD_OUT_HINT);
            return lengths.into_iter().map(needs).collect();
        }
        let of_task = |task: &Task| {
            let (count, frames) = match &task.windows {
                Some((windows, _)) => (windows.len().min(WINDOWS_IN_FLIGHT), windows.length()),
                None => (self.request.count, task.audio.frames()),
            };
            needs(self.trained, count, frames, HINT)
        };
        self.tasks.iter().map(of_task).collect()
    }

    fn sample(&self, run: &mut Run<'_>) -> Result<Option<Summary>, Error> {
        let generator =
            Generator::load(self.trained)?.with(self.post_processing(), self.request.style())?;
        if self.request.held_out_items().is_some() {
            return self.held_out(run, &generator).map(Some);
        }
        let (sampling, count) = (&self.trained.config().sampling, self.request.count);
        for (job, task) in self.tasks.iter().enumerate() {
            let too_fast = |path: &PathCondition| path.too_fast(generator.statistics());
            if let Some(doubt) = task.path.as_ref().and_then(too_fast) {
                run.sink.warning(&doubt);
            }
            let seed = item_seed(self.request.seed, &task.name);
            if let Some((windows, known)) = &task.windows {
                let windowed = WindowedSampling {
                    audio: &task.audio,
                    windows: windows.clone(),
                    known: known.as_ref(),
                    path: task.path.as_ref().map(|path| &path.followed),
                    in_flight: WINDOWS_IN_FLIGHT,
                };
                for (index, key) in keys(seed, count).enumerate() {
                    let on_windows = &mut |done, all| {
                        let before = index.saturating_mul(all);
                        let wanted = count.saturating_mul(all);
                        run.sink
                            .advance("windows", before.saturating_add(done), wanted)
                    };
                    let sample = generator.sample_windowed(&windowed, sampling, key, on_windows)?;
                    let path = task.path.as_ref();
                    let record = Record {
                        path: path.map(|path| path.record(&sample.motion)),
                        ..self.record(run, job, index, &sample.motion)
                    };
                    run.pass(job, index, generated(sample), record)?;
                }
                continue;
            }
            let (mut index, run) = (0, RefCell::new(&mut *run));
            generator.sample_each(
                repeat_n(task.audio.clone(), count).zip(keys(seed, count)),
                sampling,
                &mut |done, all| run.borrow_mut().sink.advance("", done, all),
                &mut |sample| {
                    let mut run = run.borrow_mut();
                    let record = self.record(&run, job, index, &sample.motion);
                    index += 1;
                    run.pass(job, index - 1, generated(sample), record)
                },
            )?;
        }
        Ok(None)
    }
}

fn generated(sample: Sample) -> Generated {
    Generated::Phrase {
        motion: sample.motion,
        raw: sample.raw,
    }
}

/// A line of both profiles' verdicts.
fn checked(
    name: &str,
    motion: &Phrase,
    statistics: &Statistics,
    thresholds: &SanityThresholds,
) -> Vec<String> {
    let strict = check(motion, Profile::Strict, Some(statistics));
    let reports = [check_thresholds(motion, thresholds), strict];
    let checks = reports.iter().flat_map(|report| &report.checks);
    let failed = checks.filter(|check| !check.passed);
    let mut failed: Vec<&str> = failed.map(|check| check.name).collect();
    failed.dedup();
    let verdict = |report: &Report| if report.passed { "ok" } else { "FAIL" };
    let [ccmotion, strict] = reports.each_ref().map(verdict);
    let failed = failed.join(", ");
    [name, ccmotion, strict, &failed].map(String::from).to_vec()
}

/// The condition of a phrase of a dataset.
fn of_phrase(phrase: &PhraseItem, data: &DataConfig) -> Audio {
    Audio {
        name: phrase.id.clone(),
        features: phrase.audio.clone(),
        condition: Condition::Item {
            id: phrase.id.clone(),
            source: data.source.clone(),
        },
    }
}

/// The audio conditions, cut to the requested number of frames.
fn audio(
    request: &Request,
    config: &Config,
    sink: &mut dyn SampleSink,
) -> Result<Vec<Audio>, Error> {
    let conditions = request.conditions.iter();
    let mut single = conditions.filter_map(|condition| match condition {
        Condition::AudioFeatures(file) => Some(of_features(file, config)),
        Condition::Song { file, start, beats } => {
            Some(of_song(file, *start, beats, request.frames, config))
        }
        _ => None,
    });
    let mut found = match single.next() {
        Some(audio) => vec![audio?],
        None => of_phrases(request, config, sink)?,
    };
    let Some(frames) = request.frames else {
        return Ok(found);
    };
    for audio in &mut found {
        let found = audio.features.frames();
        if frames == 0 || frames > found {
            let message = format!(
                "option `frames` is {frames}, the condition `{}` has {}",
                audio.name,
                counted(found, "frame")
            );
            return Err(Error::usage(message, "ask for 1 up to that many"));
        }
        audio.features = audio.features.slice(0..frames);
    }
    Ok(found)
}

fn of_features(file: &Path, config: &Config) -> Result<Audio, Error> {
    Ok(Audio {
        name: "cond".to_string(),
        features: load_audio(file, config.data.audio_layout())?,
        condition: Condition::AudioFeatures(file.to_path_buf()),
    })
}

/// The features of a song from the requested start. The computation uses the whole song, because
/// features of a part are normalized differently from the training features.
fn of_song(
    song: &Path,
    begins: f64,
    known: &KnownBeats,
    frames: Option<usize>,
    config: &Config,
) -> Result<Audio, Error> {
    let layout = config.data.audio_layout();
    if let Some(option) = known.given().first() {
        if !layout.beats {
            return Err(Error::usage(
                format!("option `{option}` with a run without beat features"),
                "leave it out; data.audio_features = [\"ccmotion\", \"beats\"] trains with them",
            ));
        }
        if unet1d(config).beats == Beats::Tracked {
            return Err(Error::usage(
                format!("option `{option}` with a run that tracks the beats itself"),
                "leave it out; `model.beats = \"given\"` trains models on known beats",
            ));
        }
    }
    let features = song_features(song, known)?.1;
    let audio = AudioFeatures::of_song(&features, layout, known.pulse(&features).as_ref());
    let start = begins * kinegrad_audio::FPS;
    let left = audio.frames() as f64 - start;
    let name = song.file_stem().unwrap_or_default().to_string_lossy();
    if !(start >= 0.0 && left >= 1.0) {
        let message = format!(
            "option `start` is {begins}, the song {name} has {:.1} seconds",
            audio.frames() as f64 / kinegrad_audio::FPS
        );
        return Err(Error::usage(message, "give a moment within the song"));
    }
    let start = start.round() as usize;
    let end = frames.map_or(usize::MAX, |frames| start + frames);
    Ok(Audio {
        name: name.into_owned(),
        features: audio.slice(start..end.min(audio.frames())),
        condition: Condition::Song {
            file: song.to_path_buf(),
            start: begins,
            beats: known.clone(),
        },
    })
}

/// The phrases that a request names, or the first held-out phrase.
fn of_phrases(
    request: &Request,
    config: &Config,
    sink: &mut dyn SampleSink,
) -> Result<Vec<Audio>, Error> {
    let mut data = config.data.clone();
    let item = request.item();
    if let Some((_, Some(source))) = item {
        data.kind = DataKind::Phrases;
        data.source = Some(source.to_owned());
    }
    let dataset = Dataset::<PhraseItem>::open_among(&data, &*sink.reading(), &Alone)?;
    let mut found = Vec::new();
    for side in [&dataset.validation, &dataset.train] {
        match item {
            None if found.is_empty() && !side.is_empty() => found.push(side.get(0)?),
            None => {}
            Some((pattern, _)) => {
                let chosen = side.filter(|id| kinegrad_data::matches(pattern, id));
                found.extend(chosen.load()?);
            }
        }
    }
    if found.is_empty() {
        let (wanted, _) = item.unwrap_or_default();
        let message = format!("the dataset has no phrase `{wanted}`");
        return Err(Error::usage(message, dataset.ids_hint()));
    }
    if item.is_none() {
        let side = match dataset.validation.is_empty() {
            true => "training phrase",
            false => "held-out phrase",
        };
        let id = &found[0].id;
        sink.note(&format!("no condition given: using {side} {id}"));
    }
    let found = found.iter();
    Ok(found.map(|phrase| of_phrase(phrase, &data)).collect())
}
