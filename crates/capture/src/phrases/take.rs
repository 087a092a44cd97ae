//! One take: from its files to phrases.

use std::cell::OnceCell;
use std::collections::BTreeSet;
use std::ops::Range;

use kinegrad_data::manifest::{Flag, ManifestRow};
use kinegrad_data::{AudioFeatures, AudioLayout, Digest, features_bytes, motion_bytes};
use kinegrad_motion::{FPS, Phrase, Profile, check};

use super::align::AlignedTrack;
use super::grid::Timeline;
use super::report::TakeReport;
use super::resolve::Take;
use super::song::Song;
use crate::plan::Plan;
use crate::prepare::Rejection;
use crate::prepare::files::bytes;
use crate::{Beats, Stretch, stretches};

/// Version of the algorithm. A new version makes all takes again.
const MAKER: &str = "kinegrad phrases 6";

/// A phrase with the contents of its motion file and its audio feature file.
pub(super) struct NewPhrase {
    pub row: ManifestRow,
    pub motion: Vec<u8>,
    pub audio: Vec<u8>,
}

/// A take aligned with its music.
pub(super) struct AlignedTake<'a> {
    take: &'a Take,
    song: Option<&'a Song>,
    timeline: Timeline,
    features: Option<AudioFeatures>,
    layout: AudioLayout,
    aligned: AlignedTrack,
    stretches: Vec<Stretch>,
    /// Frames of a phrase.
    length: usize,
    /// Stretch and first frame within it of each phrase.
    places: Vec<(usize, usize)>,
}

impl Take {
    /// A checksum of the take's files and its part of the plan, independent of the plan's folder.
    pub fn key(&self, plan: &Plan) -> Result<Digest, String> {
        let wanted = (&self.name, &self.plan, &plan.phrases, &plan.joining);
        let text = serde_json::to_string(&wanted).expect("plain data");
        let mut parts = vec![MAKER.as_bytes().to_vec(), text.into_bytes()];
        let segments = self.plan.segments.iter();
        let names: BTreeSet<&str> = segments.map(|segment| segment.motion.as_str()).collect();
        let segments = names.into_iter().map(|name| (name, plan.resolve(name)));
        let others = self.motion.iter().chain(&self.audio);
        let others = others.map(|path| ("", path.clone()));
        // A segment whose file is missing is a gap.
        for (name, file) in segments.filter(|(_, path)| path.exists()).chain(others) {
            parts.push(name.as_bytes().to_vec());
            parts.push(Digest::of(&bytes(&file)?).as_bytes().to_vec());
        }
        Ok(Digest::of_parts(parts.iter().map(Vec::as_slice)))
    }

    /// Reads the take's files, and the song unless another take has read it, and aligns the motion
    /// with the music.
    pub fn align<'a>(
        &'a self,
        plan: &Plan,
        song: &'a OnceCell<Result<Song, String>>,
    ) -> Result<AlignedTake<'a>, String> {
        let song = self.audio.as_deref().map(|path| {
            let read = song.get_or_init(|| Song::read(path));
            read.as_ref().map_err(String::clone)
        });
        let song = song.transpose()?;
        let timeline = self.timeline(song)?;
        let aligned = match &self.motion {
            Some(path) => AlignedTrack::recording(self, path, song)?,
            None => AlignedTrack::segments(self, plan, song, &timeline)?,
        };
        let (length, hop) = (plan.phrases.frames, plan.phrases.hop);
        if !aligned.track.valid.contains(&true) {
            let reason = aligned.reason(aligned.span.start, true, length);
            return Err(format!("no frame of it can be used: {reason}"));
        }
        let frames = aligned.track.positions.len();
        let phase = match &timeline.beats {
            Some(beats) => beats.phase(frames, FPS).map_err(|e| e.with_hint())?,
            None => vec![0.0; frames],
        };
        let stretches = stretches(&aligned.track, &phase).map_err(|e| e.with_hint())?;
        let mut places = Vec::new();
        for (index, stretch) in stretches.iter().enumerate() {
            let starts = stretch.starts(0, length, hop).map_err(|e| e.with_hint())?;
            places.extend(starts.into_iter().map(|start| (index, start)));
        }
        let layout = AudioLayout::of(&plan.phrases.audio_features);
        let features = song.map(|song| match layout.beats {
            true => song.features.with_beats(timeline.pulse.as_ref()),
            false => song.features.clone(),
        });
        Ok(AlignedTake {
            take: self,
            song,
            timeline,
            features,
            layout,
            aligned,
            stretches,
            length,
            places,
        })
    }

    fn timeline(&self, song: Option<&Song>) -> Result<Timeline, String> {
        let plan = &self.plan;
        match plan.beats {
            Some(stated) if self.motion.is_none() => {
                let count = plan.segments.iter().map(|segment| segment.beats).sum();
                Timeline::of_segments(stated, count, song, plan.grid)
            }
            _ => Ok(Timeline::of_recording(plan, song)),
        }
    }

    /// See [`TakeReport::bar_offsets_ms`].
    fn bar_offsets(&self, song: Option<&Song>) -> Vec<f64> {
        let (Some(grid), Some(song)) = (self.plan.beats, song) else {
            return Vec::new();
        };
        let tracked = song.beats.times();
        let (Some(first), Some(last)) = (tracked.first(), tracked.last()) else {
            return Vec::new();
        };
        let beats = grid.beats.unwrap_or(f64::INFINITY);
        (0u32..)
            .map(|bar| f64::from(bar) * f64::from(grid.beats_per_bar))
            .take_while(|&beat| beat < beats)
            .map(|beat| grid.start_seconds + beat * grid.seconds_per_beat)
            .take_while(|&start| start < last + grid.seconds_per_beat)
            .filter(|&start| start > first - grid.seconds_per_beat)
            .filter_map(|start| {
                let offsets = tracked.iter().map(|beat| beat - start);
                let nearest = offsets.min_by(|a, b| a.abs().total_cmp(&b.abs()))?;
                Some((nearest * 1e6).round() / 1e3)
            })
            .collect()
    }
}

impl AlignedTake<'_> {
    /// The range of phrase numbers.
    pub fn phrases(&self) -> Range<usize> {
        0..self.places.len()
    }

    /// Makes phrase `index`.
    pub fn phrase(&self, index: usize) -> Result<NewPhrase, Rejection> {
        let (stretch, start) = self.places[index];
        let stretch = &self.stretches[stretch];
        let first_frame = stretch.first_frame + start;
        let frames = first_frame..first_frame + self.length;
        let rejected = |reason: String| Rejection {
            first_frame,
            frames: self.length,
            reason,
        };
        let motion = stretch.phrase(start..start + self.length);
        let motion = motion.map_err(|error| rejected(error.with_hint()))?;
        if !motion.as_slice().iter().all(|value| value.is_finite()) {
            let reason = "its numbers are too large for single precision";
            return Err(rejected(reason.to_owned()));
        }
        let (beats, tempo) = self.beats_within(&frames);
        let flags = self.flags(&motion, &frames);
        let motion = motion_bytes(&motion);
        let audio = features_bytes(&match &self.features {
            Some(features) => features.slice(frames.clone()),
            None => AudioFeatures::silence(self.layout, self.length),
        });
        let row = ManifestRow {
            id: format!("{}_{first_frame:05}", self.take.name),
            motion_source: self.aligned.sources_of(&frames),
            audio_source: self.song.map(|_| self.take.plan.audio.clone()),
            first_frame: first_frame as i64,
            frames: self.length as i64,
            fps: FPS,
            beats,
            tempo,
            split: None,
            motion_bytes: motion.len() as i64,
            motion_sha256: Digest::of(&motion),
            audio_bytes: audio.len() as i64,
            audio_sha256: Digest::of(&audio),
            audio_features: Some(self.layout.groups()),
            label: self.take.plan.label.clone(),
            flags,
        };
        Ok(NewPhrase { row, motion, audio })
    }

    fn flags(&self, motion: &Phrase, frames: &Range<usize>) -> Vec<Flag> {
        let mut borders = self.aligned.borders.iter();
        let joined = borders.any(|border| (frames.start + 1..frames.end).contains(border));
        let damaged = self.song.is_some_and(|song| song.damage.is_some());
        let sane = check(motion, Profile::Ccmotion, None).passed;
        let flags = [
            (self.song.is_none(), Flag::NoAudio),
            (self.timeline.beats.is_none(), Flag::NoBeats),
            (joined, Flag::JoinedUnits),
            (self.aligned.filled_gaps, Flag::FilledGaps),
            (!sane, Flag::FailsCcmotionChecks),
            (damaged, Flag::DamagedAudio),
        ];
        let set = flags.into_iter().filter(|(holds, _)| *holds);
        set.map(|(_, flag)| flag).collect()
    }

    /// Number of beats in `frames`, and the tempo.
    fn beats_within(&self, frames: &Range<usize>) -> (Option<f64>, Option<f64>) {
        let (seconds, until) = (frames.start as f64 / FPS, frames.end as f64 / FPS);
        match &self.timeline.beats {
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
                let beats = tracked.seconds.iter();
                let inside = beats.filter(|beat| (seconds..until).contains(beat));
                (Some(inside.count() as f64), self.timeline.tempo)
            }
        }
    }

    /// The report of the take, with the phrases that could not be made and the number of phrases that
    /// fail CC-MotionGen's checks.
    pub fn report(&self, unmade: Vec<Rejection>, failing_checks: usize) -> TakeReport {
        let places = self.places.iter();
        let starts = places.map(|&(stretch, start)| self.stretches[stretch].first_frame + start);
        let starts: Vec<usize> = starts.collect();
        let mut rejected = self.aligned.rejections(&starts, self.length);
        let phrases = self.places.len() - unmade.len();
        rejected.extend(unmade);
        rejected.sort_by_key(|rejection| rejection.first_frame);
        let mut notes = [&self.aligned.notes[..], &self.timeline.notes].concat();
        notes.extend(self.song.and_then(|song| song.damage.clone()));
        if failing_checks > 0 {
            notes.push(format!(
                "{failing_checks} of its phrases fail CC-MotionGen's sanity checks (flag \
                 fails_ccmotion_checks)"
            ));
        }
        TakeReport {
            name: self.take.name.clone(),
            phrases,
            seconds: (phrases * self.length) as f64 / FPS,
            failure: None,
            rejected,
            notes,
            bar_offsets_ms: self.take.bar_offsets(self.song),
            grid: self.timeline.report.clone(),
        }
    }
}
