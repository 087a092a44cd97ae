//! Comparison of the stated beats of a take with the beats of its song.

use kinegrad_audio::beats::track_near;
use kinegrad_audio::{Beats as Tracked, Pulse};
use kinegrad_motion::{FPS, circular};

use super::report::GridReport;
use super::song::Song;
use crate::plan::Grid;
use crate::{BeatGrid, Beats};

/// Largest share by which stated and tracked beats may differ in number.
pub(super) const TOLERANCE: f64 = 0.02;

/// The part of a take within its song.
pub(super) struct Span {
    stated: BeatGrid,
    /// Its end in seconds of music.
    end: f64,
}

impl Span {
    /// The span of `count` stated beats in a song of `song_frames` frames.
    pub fn new(stated: BeatGrid, count: f64, song_frames: usize) -> Self {
        let danced = stated.start_seconds + count * stated.seconds_per_beat;
        Self {
            stated: BeatGrid {
                beats: None,
                ..stated
            },
            end: danced.min(song_frames as f64 / FPS),
        }
    }

    fn stated_beats(&self) -> f64 {
        let seconds = self.end - self.stated.start_seconds;
        (seconds / self.stated.seconds_per_beat).max(0.0)
    }

    /// Number of tracked beats within the span. The borders lie half a beat early, so a beat on a
    /// border counts despite the tracker's error.
    fn count(&self, tracked: &Tracked) -> usize {
        let half = self.stated.seconds_per_beat / 2.0;
        let inside = self.stated.start_seconds - half..self.end - half;
        let times = tracked.times();
        times.iter().filter(|time| inside.contains(time)).count()
    }

    /// True if the number of tracked beats agrees with the stated number.
    pub fn agree(&self, tracked: usize) -> bool {
        let stated = self.stated_beats();
        tracked > 0 && (tracked as f64 - stated).abs() <= TOLERANCE * stated
    }

    /// The tracked beats of the song. If the number disagrees, beats are tracked again near the
    /// stated tempo, because a tracker may find every beat twice or only every other beat.
    pub fn song_beats(&self, song: &Song) -> Tracked {
        if self.agree(self.count(&song.beats)) {
            return song.beats.clone();
        }
        let near = track_near(&song.onset, 60.0 / self.stated.seconds_per_beat);
        match self.agree(self.count(&near)) {
            true => near,
            false => song.beats.clone(),
        }
    }

    /// Compares the even beats with the `tracked` beats of `pulse`. The first even beat belongs to
    /// position `origin`.
    pub fn compare(&self, tracked: &Tracked, pulse: &Pulse, origin: f64) -> GridReport {
        let BeatGrid {
            start_seconds,
            seconds_per_beat,
            ..
        } = self.stated;
        let apart = |k: f64| pulse.moment(origin + k) - (start_seconds + k * seconds_per_beat);
        let last = self.stated_beats().floor() as usize;
        let differences = (0..=last).map(|k| apart(k as f64));
        let (least, most) = differences.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), d| {
            (a.min(d), b.max(d))
        });
        let concentration = self.concentration(&Beats::Grid(self.stated), pulse);
        let [from, to] = [start_seconds, self.end];
        GridReport {
            grid: Grid::Uniform,
            stated_beats: self.stated_beats(),
            tracked_beats: self.count(tracked),
            tracked_tempo: 60.0 * (pulse.position(to) - pulse.position(from)) / (to - from),
            offset_seconds: apart(0.0),
            drift_seconds: most - least,
            drift_beats: (most - least) / seconds_per_beat,
            uniform_concentration: concentration,
            concentration,
        }
    }

    /// Length of the mean of `exp(i d)` over the frames of the span, `d` the difference between the
    /// beat phase of `beats` and that of `pulse`.
    pub fn concentration(&self, beats: &Beats, pulse: &Pulse) -> f64 {
        let first = (self.stated.start_seconds.max(0.0) * FPS).ceil() as usize;
        let end = (self.end.max(0.0) * FPS) as usize;
        let Ok(phase) = beats.phase(end, FPS) else {
            return 0.0;
        };
        let beats_per_bar = f64::from(self.stated.beats_per_bar);
        let frames = phase.iter().enumerate().skip(first);
        circular::concentration(
            frames.map(|(t, phase)| phase * beats_per_bar - pulse.position(t as f64 / FPS)),
        )
    }
}
