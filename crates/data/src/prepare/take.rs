//! One take: from its files to phrases.

use kinegrad_motion::capture::{Beats, Stretch, TrackedBeats, stretches};
use kinegrad_motion::{FPS, Motion, Profile, check};

use super::lay::Laid;
use super::plan::Plan;
use super::report::{Rejection, TakeReport, capture_error};
use super::resolve::Take;
use super::song::{LazySong, Song};
use crate::AudioFeatures;
use crate::manifest::Flag;

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

/// A take on the time line of its music, to cut phrases from.
pub(super) struct Ready<'a> {
    take: &'a Take,
    song: Option<&'a Song>,
    beats: Option<Beats>,
    laid: Laid,
    stretches: Vec<Stretch>,
    /// Frames of a phrase.
    length: usize,
    /// Each phrase's stretch and its first frame there.
    places: Vec<(usize, usize)>,
}

impl Take {
    /// Reads the take's files and lays its motion on the music.
    ///
    /// # Errors
    /// Why nothing can be made of it, in words that name the file.
    pub fn ready<'a>(
        &'a self,
        plan: &Plan,
        song: Option<&'a LazySong>,
    ) -> Result<Ready<'a>, String> {
        let song = song.map(LazySong::get).transpose()?;
        let laid = match &self.motion {
            Some(path) => Laid::whole(self, path, song)?,
            None => Laid::segments(self, plan, song)?,
        };
        let (length, hop) = (plan.phrases.frames, plan.phrases.hop);
        if !laid.track.valid().contains(&true) {
            let reason = laid.reason(laid.span.start, true, length);
            return Err(format!("no frame of it can be used: {reason}"));
        }
        let frames = laid.track.positions().len();
        let beats = self.beats(song);
        let phase = match &beats {
            Some(beats) => beats.phase(frames, FPS).map_err(capture_error)?,
            None => vec![0.0; frames],
        };
        let stretches = stretches(&laid.track, &phase).map_err(capture_error)?;
        let mut places = Vec::new();
        for (index, stretch) in stretches.iter().enumerate() {
            let starts = stretch.starts(0, length, hop).map_err(capture_error)?;
            places.extend(starts.into_iter().map(|start| (index, start)));
        }
        Ok(Ready {
            take: self,
            song,
            beats,
            laid,
            stretches,
            length,
            places,
        })
    }

    /// The beats that the plan states, else those of the song.
    fn beats(&self, song: Option<&Song>) -> Option<Beats> {
        if let Some(grid) = self.plan.beats {
            return Some(Beats::Grid(grid));
        }
        let seconds = song?.beats.clone();
        (seconds.len() >= 2).then_some(Beats::Tracked(TrackedBeats {
            seconds,
            beats_per_bar: self.plan.beats_per_bar(),
        }))
    }

    /// See [`TakeReport::bar_offsets_ms`].
    fn bar_offsets(&self, song: Option<&Song>) -> Vec<f64> {
        let (Some(grid), Some(song)) = (self.plan.beats, song) else {
            return Vec::new();
        };
        let (Some(first), Some(last)) = (song.beats.first(), song.beats.last()) else {
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
                let offsets = song.beats.iter().map(|beat| beat - start);
                let nearest = offsets.min_by(|a, b| a.abs().total_cmp(&b.abs()))?;
                Some((nearest * 1e6).round() / 1e3)
            })
            .collect()
    }
}

impl Ready<'_> {
    /// Number of phrases.
    pub fn phrases(&self) -> usize {
        self.places.len()
    }

    /// Makes phrase `index`.
    ///
    /// # Errors
    /// The frames that give none, and why.
    pub fn phrase(&self, index: usize) -> Result<Made, Rejection> {
        let (stretch, start) = self.places[index];
        let stretch = &self.stretches[stretch];
        let first_frame = stretch.first_frame() + start;
        let frames = first_frame..first_frame + self.length;
        let rejected = |reason: String| Rejection {
            first_frame,
            frames: self.length,
            reason,
        };
        let motion = stretch
            .phrase(start..start + self.length)
            .map_err(|error| rejected(capture_error(error)))?;
        if !motion.as_slice().iter().all(|value| value.is_finite()) {
            let reason = "its numbers are too large for single precision";
            return Err(rejected(reason.to_owned()));
        }
        let (beats, tempo) = self.beats_within(frames.start as f64, frames.end as f64);
        Ok(Made {
            id: format!("{}_{first_frame:05}", self.take.name),
            audio: match self.song {
                Some(song) => song.features.slice(frames.clone()),
                None => AudioFeatures::zeros(self.length),
            },
            motion_source: self.laid.sources_of(&frames),
            flags: self.flags(&motion, &frames),
            motion,
            first_frame,
            beats,
            tempo,
        })
    }

    fn flags(&self, motion: &Motion, frames: &std::ops::Range<usize>) -> Vec<Flag> {
        let mut borders = self.laid.borders.iter();
        let joined = borders.any(|border| (frames.start + 1..frames.end).contains(border));
        let damaged = self.song.is_some_and(|song| song.damage.is_some());
        let sane = check(motion, Profile::Document, None).is_ok_and(|report| report.passed);
        let flags = [
            (self.song.is_none(), Flag::NoAudio),
            (self.beats.is_none(), Flag::NoBeats),
            (joined, Flag::JoinedUnits),
            (self.laid.filled_gaps, Flag::FilledGaps),
            (!sane, Flag::FailsDocumentChecks),
            (damaged, Flag::DamagedAudio),
        ];
        let held = flags.into_iter().filter(|(holds, _)| *holds);
        held.map(|(_, flag)| flag).collect()
    }

    /// Beats between two frames, and the tempo.
    fn beats_within(&self, start: f64, end: f64) -> (Option<f64>, Option<f64>) {
        let (seconds, until) = (start / FPS, end / FPS);
        match &self.beats {
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
                let tempo = self.song.map(|song| song.tempo);
                (Some(inside.count() as f64), tempo)
            }
        }
    }

    /// The report of the take, with the phrases that could not be made, and how many of the others
    /// fail CC-MotionGen's checks.
    pub fn report(&self, unmade: Vec<Rejection>, failing_checks: usize) -> TakeReport {
        let all = self.places.iter();
        let first_frame = |&(stretch, start): &(usize, usize)| -> usize {
            self.stretches[stretch].first_frame() + start
        };
        let starts: Vec<usize> = all.map(first_frame).collect();
        let mut rejected = self.laid.rejections(&starts, self.length);
        let phrases = self.phrases() - unmade.len();
        rejected.extend(unmade);
        rejected.sort_by_key(|rejection| rejection.first_frame);
        let mut notes = self.laid.notes.clone();
        notes.extend(self.song.and_then(|song| song.damage.clone()));
        if failing_checks > 0 {
            notes.push(format!(
                "{failing_checks} of its phrases fail CC-MotionGen's sanity checks (flag \
                 fails_document_checks)"
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
        }
    }
}
