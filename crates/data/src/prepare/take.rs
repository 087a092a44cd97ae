//! One take: from its files to phrases.

use std::collections::HashMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use kinegrad_motion::capture::{
    Beats, CaptureError, Joining, MarkerGaps, RootSource, RootTrack, Segment, TrackedBeats,
    assemble, join, stretches,
};
use kinegrad_motion::{FPS, Motion, Profile, check};
use serde::{Deserialize, Serialize};

use super::motion::{self, Capture};
use super::plan::{Plan, TakePlan};
use super::song::{LazySong, Song};
use crate::manifest::Flag;
use crate::{AudioFeatures, MAX_FRAMES, split};

/// A take with its files known.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Take {
    pub name: String,
    pub plan: TakePlan,
    /// The capture file of a whole take.
    pub motion: Option<PathBuf>,
    pub audio: Option<PathBuf>,
}

/// A phrase that was made.
pub(super) struct Made {
    pub id: String,
    pub motion: Motion,
    pub audio: AudioFeatures,
    pub motion_source: String,
    pub first_frame: usize,
    pub beats: Option<f64>,
    pub tempo: Option<f64>,
    pub flags: Vec<Flag>,
}

/// What became of a take.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub struct TakeReport {
    /// Its name.
    pub name: String,
    /// Phrases made.
    pub phrases: usize,
    /// Seconds of motion in them.
    pub seconds: f64,
    /// Why nothing could be made of it at all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
    /// What was left out.
    pub rejected: Vec<Rejection>,
    /// What a user should know of the rest.
    pub notes: Vec<String>,
    /// Where the plan states the beats: from the beginning of each bar to the nearest tracked
    /// beat, in milliseconds, positive where the music comes later.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub bar_offsets_ms: Vec<f64>,
}

/// Frames that no phrase holds.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Rejection {
    /// First of them on the take's time line.
    pub first_frame: usize,
    /// How many.
    pub frames: usize,
    /// Why.
    pub reason: String,
}

/// A root on the time line of the music.
struct Laid {
    track: RootTrack,
    /// Frames after a border between units.
    borders: Vec<usize>,
    /// The capture file of each frame, by its place in `files`.
    sources: Vec<Option<usize>>,
    files: Vec<String>,
    filled_gaps: bool,
    /// The frames that the plan wants filled; the track may end before.
    span: Range<usize>,
    /// Frames without a capture, and the file that is missing.
    missing: Vec<(Range<usize>, String)>,
    notes: Vec<String>,
}

impl Laid {
    /// Why frame `t` is in no phrase.
    fn reason(&self, t: usize, length: usize) -> String {
        if t >= self.track.frames() {
            return "the song has ended".to_owned();
        }
        if let Some((_, file)) = self.missing.iter().find(|(frames, _)| frames.contains(&t)) {
            return format!("no capture: {file}");
        }
        match self.track.valid()[t] {
            true => format!("left over between phrases of {length} frames"),
            false => "the capture does not tell the root".to_owned(),
        }
    }

    /// The frames that no phrase uses, those with the same reason together.
    fn rejections(&self, phrases: &[usize], length: usize) -> Vec<Rejection> {
        let mut used = vec![false; self.span.end];
        for &first in phrases {
            used[first..first + length].fill(true);
        }
        let mut rejections: Vec<Rejection> = Vec::new();
        for t in self.span.clone().filter(|&t| !used[t]) {
            let reason = self.reason(t, length);
            match rejections.last_mut() {
                Some(last) if last.first_frame + last.frames == t && last.reason == reason => {
                    last.frames += 1;
                }
                _ => rejections.push(Rejection {
                    first_frame: t,
                    frames: 1,
                    reason,
                }),
            }
        }
        rejections
    }
}

impl Take {
    /// Makes the phrases of this take.
    ///
    /// # Errors
    /// Why nothing can be made of it, in words that name the file.
    pub fn make(
        &self,
        plan: &Plan,
        song: Option<&LazySong>,
    ) -> Result<(Vec<Made>, TakeReport), String> {
        let song = song.map(LazySong::get).transpose()?;
        let laid = match &self.motion {
            Some(path) => self.lay_whole(path, song)?,
            None => self.lay_segments(plan, song)?,
        };
        let frames = laid.track.frames();
        let beats = self.beats(song);
        let phase = match &beats {
            Some(beats) => beats.phase(frames, FPS).map_err(|e| e.to_string())?,
            None => vec![0.0; frames],
        };
        let mut report = TakeReport {
            name: self.name.clone(),
            notes: laid.notes.clone(),
            bar_offsets_ms: self.bar_offsets(song),
            ..TakeReport::default()
        };
        if let Some(song) = song.filter(|song| song.skipped_packets > 0) {
            let count = song.skipped_packets;
            report.notes.push(format!(
                "{count} damaged packets of the song were passed over"
            ));
        }
        let mut made = Vec::new();
        let (length, hop) = (plan.phrases.frames, plan.phrases.hop);
        for stretch in stretches(&laid.track, &phase).map_err(|e| e.to_string())? {
            let phrases = stretch.phrases(0, length, hop).map_err(|e| e.to_string())?;
            for (first_frame, motion) in phrases {
                made.push(self.phrase(&laid, song, beats.as_ref(), first_frame, motion));
            }
        }
        if !laid.track.valid().contains(&true) {
            let reason = laid.reason(laid.span.start, length);
            return Err(format!("no frame of it can be used: {reason}"));
        }
        let starts: Vec<usize> = made.iter().map(|phrase| phrase.first_frame).collect();
        report.rejected = laid.rejections(&starts, length);
        report.phrases = made.len();
        report.seconds = made
            .iter()
            .map(|phrase| phrase.motion.frames())
            .sum::<usize>() as f64
            / FPS;
        Ok((made, report))
    }

    fn phrase(
        &self,
        laid: &Laid,
        song: Option<&Song>,
        beats: Option<&Beats>,
        first_frame: usize,
        motion: Motion,
    ) -> Made {
        let frames = first_frame..first_frame + motion.frames();
        let mut flags = Vec::new();
        let mut flag = |holds: bool, flag: Flag| flags.extend(holds.then_some(flag));
        flag(song.is_none(), Flag::NoAudio);
        flag(beats.is_none(), Flag::NoBeats);
        let joined = laid
            .borders
            .iter()
            .any(|border| (frames.start + 1..frames.end).contains(border));
        flag(joined, Flag::JoinedUnits);
        flag(laid.filled_gaps, Flag::FilledGaps);
        let sane = check(&motion, Profile::Document, None).is_ok_and(|report| report.passed);
        flag(!sane, Flag::FailsDocumentChecks);
        let (seconds, until) = (frames.start as f64 / FPS, frames.end as f64 / FPS);
        let (within, tempo) = match beats {
            None => (None, None),
            Some(Beats::Grid(grid)) => {
                let place = |moment: f64| {
                    let beat = (moment - grid.start_seconds) / grid.seconds_per_beat;
                    beat.clamp(0.0, grid.beats.unwrap_or(f64::INFINITY))
                };
                let beats = place(until) - place(seconds);
                (Some(beats), Some(60.0 / grid.seconds_per_beat))
            }
            Some(Beats::Tracked(tracked)) => {
                let inside = tracked
                    .seconds
                    .iter()
                    .filter(|beat| (seconds..until).contains(beat));
                (Some(inside.count() as f64), song.map(|song| song.tempo))
            }
        };
        let mut sources: Vec<&str> = laid.sources[frames.clone()]
            .iter()
            .flatten()
            .map(|&file| laid.files[file].as_str())
            .collect();
        sources.dedup();
        Made {
            id: format!("{}_{first_frame:05}", self.name),
            audio: match song {
                Some(song) => song.features.slice(frames),
                None => AudioFeatures::zeros(motion.frames()),
            },
            motion,
            motion_source: sources.join(", "),
            first_frame,
            beats: within,
            tempo,
            flags,
        }
    }

    /// The beats that the plan states, else those of the song.
    fn beats(&self, song: Option<&Song>) -> Option<Beats> {
        if let Some(grid) = self.plan.beats {
            return Some(Beats::Grid(grid));
        }
        let seconds = song?.beats.clone();
        (seconds.len() >= 2).then_some(Beats::Tracked(TrackedBeats {
            seconds,
            beats_per_bar: self.plan.beats_per_bar,
        }))
    }

    /// See [`TakeReport::bar_offsets_ms`].
    fn bar_offsets(&self, song: Option<&Song>) -> Vec<f64> {
        let (Some(grid), Some(song)) = (self.plan.beats, song) else {
            return Vec::new();
        };
        let end = song.features.frames() as f64 / FPS;
        let beats = grid.beats.unwrap_or(f64::INFINITY);
        (0u32..)
            .map(|bar| f64::from(bar) * f64::from(grid.beats_per_bar))
            .take_while(|&beat| beat < beats)
            .map(|beat| grid.start_seconds + beat * grid.seconds_per_beat)
            .take_while(|&start| start < end)
            .filter_map(|start| {
                let offsets = song.beats.iter().map(|beat| beat - start);
                let nearest = offsets.min_by(|a, b| a.abs().total_cmp(&b.abs()))?;
                Some((nearest * 1e6).round() / 1e3)
            })
            .collect()
    }

    /// A capture file from one moment to another, laid on the song from a third.
    fn lay_whole(&self, path: &Path, song: Option<&Song>) -> Result<Laid, String> {
        let Capture { source, gaps } = motion::read(path, &self.plan)?;
        let rate = source.rate();
        let last_frame = (source.frames() - 1) as f64;
        let from = self.plan.motion_start_seconds;
        let to = self.plan.motion_end_seconds.unwrap_or(f64::INFINITY);
        let to = to.min(last_frame / rate);
        if from > to {
            return Err(format!(
                "{}: it ends at {:.3} s, motion_start_seconds is {from}",
                path.display(),
                last_frame / rate
            ));
        }
        let start = self.plan.audio_start_seconds;
        // A last moment that rounding puts just beyond the end is still the end.
        let wanted = ((start + to - from) * FPS + 1e-6).floor() as usize;
        let wanted = wanted.saturating_add(1);
        let frames = frames_until(wanted, song)?;
        let poses = (0..frames).map(|t| {
            let moment = t as f64 / FPS - start + from;
            let inside = (from - 1e-9..=to + 1e-6 / FPS).contains(&moment);
            let frame = (moment * rate).clamp(0.0, last_frame);
            inside.then(|| source.sample(frame)).flatten()
        });
        Ok(Laid {
            track: RootTrack::from_poses(poses.collect(), FPS).map_err(|e| e.to_string())?,
            borders: Vec::new(),
            sources: vec![Some(0); frames],
            files: vec![self.plan.motion.clone().unwrap_or_default()],
            filled_gaps: filled(&gaps),
            span: ((start * FPS).ceil() as usize).min(wanted)..wanted,
            missing: Vec::new(),
            notes: gap_notes(&self.name, &gaps),
        })
    }

    /// The plan's segments, end to end on its beats.
    fn lay_segments(&self, plan: &Plan, song: Option<&Song>) -> Result<Laid, String> {
        let grid = self.plan.beats.ok_or("segments without beats")?;
        let mut files: Vec<String> = Vec::new();
        let mut captures: Vec<Option<Capture>> = Vec::new();
        let mut known: HashMap<&str, usize> = HashMap::new();
        let (mut missing, mut notes) = (Vec::new(), Vec::new());
        let mut segments = Vec::new();
        let mut start_seconds = grid.start_seconds;
        for segment in &self.plan.segments {
            let seconds = segment.beats * grid.seconds_per_beat;
            let file = match known.get(segment.motion.as_str()) {
                Some(&file) => file,
                None => {
                    let path = plan.resolve(&segment.motion);
                    let capture = path
                        .exists()
                        .then(|| motion::read(&path, &self.plan))
                        .transpose()?;
                    known.insert(&segment.motion, files.len());
                    files.push(segment.motion.clone());
                    captures.push(capture);
                    files.len() - 1
                }
            };
            match captures[file] {
                Some(_) => segments.push(Segment {
                    take: file,
                    capture_frames: segment.frames[0]..segment.frames[1],
                    start_seconds,
                    seconds,
                }),
                None => {
                    let frame = |seconds: f64| (seconds * FPS - 1e-6).ceil().max(0.0) as usize;
                    let frames = frame(start_seconds)..frame(start_seconds + seconds);
                    missing.push((frames, segment.motion.clone()));
                }
            }
            start_seconds += seconds;
        }
        let wanted = (start_seconds * FPS).ceil().max(1.0) as usize;
        let frames = frames_until(wanted, song)?;
        let mut places = vec![0; captures.len()];
        let mut sources: Vec<&dyn RootSource> = Vec::new();
        let mut names = Vec::new();
        for (index, capture) in captures.iter().enumerate() {
            if let Some(capture) = capture {
                places[index] = sources.len();
                sources.push(capture.source.as_ref());
                names.push(files[index].clone());
                notes.extend(gap_notes(&files[index], &capture.gaps));
            }
        }
        for segment in &mut segments {
            segment.take = places[segment.take];
        }
        let (assembly, track, borders) =
            laid_and_joined(&sources, &segments, frames, &plan.joining)
                .map_err(|e| e.to_string())?;
        Ok(Laid {
            track,
            borders,
            sources: assembly,
            files: names,
            filled_gaps: captures.iter().flatten().any(|c| filled(&c.gaps)),
            span: ((grid.start_seconds * FPS - 1e-6).ceil().max(0.0) as usize).min(wanted)..wanted,
            missing,
            notes,
        })
    }
}

/// The frames of a time line that ends with its song, if it has one.
fn frames_until(wanted: usize, song: Option<&Song>) -> Result<usize, String> {
    let frames = song.map_or(wanted, |song| wanted.min(song.features.frames()));
    if wanted > MAX_FRAMES {
        return Err(format!("{wanted} frames found, {MAX_FRAMES} allowed"));
    }
    Ok(frames)
}

/// The take of each frame, the track without jumps, and the frames after a border.
#[expect(clippy::type_complexity, reason = "three answers of one joining")]
fn laid_and_joined(
    sources: &[&dyn RootSource],
    segments: &[Segment],
    frames: usize,
    joining: &Joining,
) -> Result<(Vec<Option<usize>>, RootTrack, Vec<usize>), CaptureError> {
    let assembly = assemble(sources, segments, frames)?;
    let (track, borders) = join(&assembly, joining)?;
    Ok((assembly.takes, track, borders))
}

/// Whether any marker was interpolated.
fn filled(gaps: &[MarkerGaps]) -> bool {
    gaps.iter().any(|gap| gap.filled_frames > 0)
}

fn gap_notes(file: &str, gaps: &[MarkerGaps]) -> Vec<String> {
    gaps.iter()
        .map(|gap| {
            format!(
                "{file}: marker {} missing in {} frames, {} of them filled, longest gap {}",
                gap.marker, gap.missing_frames, gap.filled_frames, gap.longest_gap_frames
            )
        })
        .collect()
}

/// The takes of a plan, patterns in file names resolved.
///
/// # Errors
/// What is wrong: a pattern without a file, a song that is not there, a name given twice.
pub(super) fn resolve(plan: &Plan, takes: Vec<TakePlan>) -> Result<Vec<Take>, String> {
    let mut resolved: Vec<Take> = Vec::new();
    for take in takes {
        if let Err(problem) = take.check() {
            let name = take.name.as_deref().unwrap_or_default();
            return Err(format!("take `{name}`: {problem}"));
        }
        let motions: Vec<Option<PathBuf>> = match &take.motion {
            None => vec![None],
            Some(pattern) => matching(&plan.resolve(pattern), &ANY)?
                .into_iter()
                .map(Some)
                .collect(),
        };
        for motion in motions {
            let stem = motion.as_deref().and_then(Path::file_stem);
            let stem = stem.unwrap_or_default().to_string_lossy();
            let name = take
                .name
                .as_deref()
                .unwrap_or("{name}")
                .replace("{name}", &stem);
            let longest_id = format!("{name}_{MAX_FRAMES}");
            crate::check_id(&longest_id).map_err(|error| error.to_string())?;
            if resolved.iter().any(|other| other.name == name) {
                return Err(format!(
                    "two takes have the name `{name}`: give one another `name`"
                ));
            }
            let audio = match take.audio.as_str() {
                "none" => None,
                path => {
                    let path = plan.resolve(&path.replace("{name}", &stem));
                    let mut found = matching(&path, &SONGS)?;
                    if found.len() > 1 {
                        return Err(format!(
                            "take `{name}`: {} songs match {}",
                            found.len(),
                            path.display()
                        ));
                    }
                    found.pop()
                }
            };
            let mut plan_of_take = take.clone();
            if let (Some(pattern), Some(found)) = (&take.motion, &motion) {
                let file = found.file_name().unwrap_or_default();
                let named = Path::new(pattern).with_file_name(file);
                plan_of_take.motion = Some(named.to_string_lossy().into_owned());
            }
            resolved.push(Take {
                name,
                plan: plan_of_take,
                motion,
                audio,
            });
        }
    }
    Ok(resolved)
}

/// Endings of songs; a `*` in a song's name finds no other file.
const SONGS: [&str; 5] = ["mp3", "wav", "flac", "ogg", "oga"];

/// Any ending.
const ANY: [&str; 0] = [];

/// The files whose names match the last part of `path` and, where a pattern found them, have one
/// of the `endings`; sorted, at least one. Hidden files do not match a pattern.
fn matching(path: &Path, endings: &[&str]) -> Result<Vec<PathBuf>, String> {
    let missing = || format!("there is no file {}", path.display());
    let pattern = path.file_name().unwrap_or_default().to_string_lossy();
    if !pattern.contains('*') {
        return match path.is_file() {
            true => Ok(vec![path.to_owned()]),
            false => Err(missing()),
        };
    }
    let folder = match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let entries = std::fs::read_dir(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let mut found: Vec<PathBuf> = entries
        .flatten()
        .filter(|entry| split::matches(&pattern, &entry.file_name().to_string_lossy()))
        .map(|entry| entry.path())
        .filter(|path| path.is_file())
        .filter(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let ending = path.extension().unwrap_or_default().to_string_lossy();
            let known = endings
                .iter()
                .any(|known| ending.eq_ignore_ascii_case(known));
            !name.starts_with('.') && (endings.is_empty() || known)
        })
        .collect();
    found.sort();
    if let Some(odd) = found.iter().find(|path| path.to_str().is_none()) {
        return Err(format!("{}: its name is not UTF-8", odd.display()));
    }
    if found.is_empty() {
        return Err(missing());
    }
    Ok(found)
}
