//! The beats that segments are aligned with: the song's beats if the song has the stated number,
//! otherwise even beats.

use kinegrad_audio::Pulse;

use super::report::GridReport;
use super::song::Song;
use super::span::{Span, TOLERANCE};
use crate::plan::{Grid, TakePlan};
use crate::{BeatGrid, Beats, TrackedBeats};

/// Beats in a bar if a plan does not state them.
const BEATS_PER_BAR: u32 = 4;

/// The beats of a take.
#[derive(Default)]
pub(super) struct Timeline {
    /// The beats of the phase; none if they are unknown.
    pub beats: Option<Beats>,
    /// The beats of the beat features.
    pub pulse: Option<Pulse>,
    /// The beats that segments are aligned with; the first segment starts on beat 0.
    pub segment_beats: Option<Pulse>,
    /// Tempo of tracked beats in beats per minute.
    pub tempo: Option<f64>,
    /// Agreement of stated and tracked beats, for segments with a song.
    pub report: Option<GridReport>,
    /// Notes for the report.
    pub notes: Vec<String>,
}

impl Timeline {
    /// The beats of a recording: the stated beats, else the beats of the song. The song's beat
    /// nearest to the stated downbeat starts a bar.
    pub fn of_recording(plan: &TakePlan, song: Option<&Song>) -> Self {
        if let Some(grid) = plan.beats {
            let even = Pulse::even(grid.start_seconds, grid.seconds_per_beat);
            return Self {
                beats: Some(Beats::Grid(grid)),
                pulse: even.map(|even| even.with_downbeat(grid.beats_per_bar, grid.start_seconds)),
                ..Self::default()
            };
        }
        let beats_per_bar = plan.beats_per_bar.unwrap_or(BEATS_PER_BAR);
        let song_beats = song.and_then(|song| Pulse::tracked(&song.beats));
        let pulse = song_beats.map(|pulse| match plan.downbeat_seconds {
            Some(downbeat) => pulse.with_downbeat(beats_per_bar, downbeat),
            None => pulse,
        });
        let beats = pulse.as_ref().map(|pulse| {
            // Without a downbeat, the first beat starts a bar.
            let bar = f64::from(beats_per_bar);
            let first = pulse.bars().map_or(0.0, |bars| {
                let first = bars.downbeat.rem_euclid(bar);
                if first > 0.0 { first - bar } else { first }
            });
            let count = pulse.seconds().len() + beats_per_bar as usize;
            Beats::Tracked(TrackedBeats {
                seconds: pulse.from_beat(first, count).seconds().to_vec(),
                beats_per_bar,
            })
        });
        Self {
            beats,
            pulse,
            tempo: song.map(|song| song.beats.tempo),
            ..Self::default()
        }
    }

    /// The beats for segments of `count` stated, even beats. If the song has this number of beats,
    /// the song's beats are used unless `wanted` excludes them. Fails if the numbers differ and
    /// `wanted` requires the song's beats.
    pub fn of_segments(
        stated: BeatGrid,
        count: f64,
        song: Option<&Song>,
        wanted: Option<Grid>,
    ) -> Result<Self, String> {
        let refused = |problem: &str| match wanted {
            Some(Grid::Tracked) => Err(format!(
                "grid = \"tracked\": {problem} (correct `beats`, or align the segments with even \
                 beats: grid = \"uniform\")"
            )),
            _ => Ok(format!(
                "{problem}: its segments are aligned with even beats"
            )),
        };
        let mut timeline = Self {
            beats: Some(Beats::Grid(stated)),
            segment_beats: Pulse::even(stated.start_seconds, stated.seconds_per_beat),
            ..Self::default()
        };
        let Some(song) = song else {
            if wanted == Some(Grid::Tracked) {
                refused("the take has no song")?;
            }
            return Ok(timeline);
        };
        let span = Span::new(stated, count, song.features.frames());
        let song_beats = span.song_beats(song);
        let Some(pulse) = Pulse::tracked(&song_beats) else {
            let note = refused("no beats are tracked in the song")?;
            timeline.notes.push(note);
            return Ok(timeline);
        };
        let origin = pulse.position(stated.start_seconds).round();
        let mut report = span.compare(&song_beats, &pulse, origin);
        let tracked = report.tracked_beats;
        let agree = span.agree(tracked);
        if !agree {
            let (stated, percent) = (report.stated_beats, 100.0 * TOLERANCE);
            timeline.notes.push(refused(&format!(
                "{tracked} beats are tracked where {stated:.1} are stated, more than {percent:.0} % \
                 apart"
            ))?);
        }
        if !agree || wanted == Some(Grid::Uniform) {
            timeline.pulse = Some(pulse);
            timeline.report = Some(report);
            return Ok(timeline);
        }
        if song_beats.tempo != song.beats.tempo {
            timeline.notes.push(format!(
                "beats were tracked at {:.1} per minute, and with the stated number at {:.1}",
                song.beats.tempo, report.tracked_tempo
            ));
        }
        let segment_beats = pulse.from_beat(origin, count.ceil() as usize + 1);
        let beats = Beats::Tracked(TrackedBeats {
            seconds: segment_beats.seconds().to_vec(),
            beats_per_bar: stated.beats_per_bar,
        });
        let tempo = report.tracked_tempo;
        report.grid = Grid::Tracked;
        report.concentration = span.concentration(&beats, &pulse);
        let first = pulse.moment(origin);
        Ok(Self {
            beats: Some(beats),
            pulse: Some(pulse.with_downbeat(stated.beats_per_bar, first)),
            segment_beats: Some(segment_beats),
            tempo: Some(tempo),
            report: Some(report),
            notes: timeline.notes,
        })
    }

    /// Both ends and the tracked beats in between: a segment's speed may change at each.
    pub fn knots(&self, from: f64, to: f64) -> Vec<f64> {
        let mut knots = vec![from];
        if matches!(self.beats, Some(Beats::Tracked(_))) {
            let between = (1..).map(|k| from.floor() + f64::from(k));
            knots.extend(between.take_while(|beat| *beat < to));
        }
        knots.push(to);
        knots
    }
}

#[cfg(test)]
mod tests;
