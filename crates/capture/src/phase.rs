//! The musical phase: position in the bar.

use kinegrad_audio::pulse::position;
use kinegrad_settings::InvalidSetting;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::error::{require, require_positive};

/// Even beats.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BeatGrid {
    /// Time of the first beat in seconds of the music. It begins a bar.
    pub start_seconds: f64,
    /// Length of a beat in seconds, positive.
    pub seconds_per_beat: f64,
    /// Beats in a bar, at least 1.
    pub beats_per_bar: u32,
    /// Number of beats; without it, the grid has no end. Before the start and after the end the
    /// phase is 0.
    pub beats: Option<f64>,
}

/// Beats as a beat tracker found them.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackedBeats {
    /// Times of the beats in seconds of music, at least two, increasing; the first starts a bar.
    /// Before the first beat and after the last, beats continue at the distance of the nearest two.
    pub seconds: Vec<f64>,
    /// Beats in a bar, at least 1.
    pub beats_per_bar: u32,
}

/// The beats of a piece of music.
#[derive(Clone, Debug, PartialEq)]
pub enum Beats {
    /// Even beats.
    Grid(BeatGrid),
    /// Tracked beats.
    Tracked(TrackedBeats),
}

impl Beats {
    /// The phase of frames `0..frames` at `fps` per second, `[frames]`: the part of the bar that
    /// has passed, from 0 to below 1.
    ///
    /// # Errors
    /// [`Error::Setting`] if a number is out of range.
    pub fn phase(&self, frames: usize, fps: f64) -> Result<Vec<f64>, Error> {
        self.check()?;
        let phase = |seconds: f64| match self {
            Self::Grid(grid) => {
                let beat = (seconds - grid.start_seconds) / grid.seconds_per_beat;
                let outside = beat < 0.0 || grid.beats.is_some_and(|beats| beat >= beats);
                let beat = if outside { 0.0 } else { beat };
                part_of_bar(beat, grid.beats_per_bar)
            }
            Self::Tracked(beats) => {
                part_of_bar(position(&beats.seconds, seconds), beats.beats_per_bar)
            }
        };
        Ok((0..frames).map(|t| phase(t as f64 / fps)).collect())
    }

    /// Checks every number.
    ///
    /// # Errors
    /// The error names the number out of range.
    pub fn check(&self) -> Result<(), InvalidSetting> {
        let beats_per_bar = match self {
            Self::Grid(grid) => {
                let allowed = "a positive number of seconds";
                require_positive("seconds_per_beat", grid.seconds_per_beat, allowed)?;
                let start = grid.start_seconds;
                let allowed = "a finite number of seconds";
                require(start.is_finite(), "start_seconds", start, allowed)?;
                let beats = grid.beats.unwrap_or_default();
                let allowed = "a number of beats, or none for no end";
                require(beats >= 0.0, "beats", beats, allowed)?;
                grid.beats_per_bar
            }
            Self::Tracked(beats) => {
                let seconds = &beats.seconds;
                // False for NaN.
                let increasing = seconds.windows(2).all(|pair| pair[0] < pair[1]);
                let finite = seconds.iter().all(|s| s.is_finite());
                let found = format!("a list of {} times", seconds.len());
                let allowed = "at least two finite times, each after the last";
                let sound = increasing && finite && seconds.len() >= 2;
                require(sound, "seconds", found, allowed)?;
                beats.beats_per_bar
            }
        };
        let key = "beats_per_bar";
        require(beats_per_bar > 0, key, beats_per_bar, "at least 1")
    }
}

fn part_of_bar(beat: f64, beats_per_bar: u32) -> f64 {
    let bars = beat / f64::from(beats_per_bar);
    // Not `rem_euclid`, which gives 1 for a tiny negative number.
    let part = bars - bars.floor();
    if part < 1.0 { part } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: &[f64], expected: &[f64]) {
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
    }

    fn grid() -> BeatGrid {
        BeatGrid {
            start_seconds: 1.0,
            seconds_per_beat: 0.5,
            beats_per_bar: 4,
            beats: Some(6.0),
        }
    }

    #[test]
    fn a_grid_counts_bars_within_its_span() {
        let phase = Beats::Grid(grid()).phase(10, 2.0).unwrap();
        close(
            &phase,
            &[0.0, 0.0, 0.0, 0.25, 0.5, 0.75, 0.0, 0.25, 0.0, 0.0],
        );
        let endless = BeatGrid {
            beats: None,
            ..grid()
        };
        let phase = Beats::Grid(endless).phase(10, 2.0).unwrap();
        close(&phase[6..], &[0.0, 0.25, 0.5, 0.75]);
    }

    #[test]
    fn tracked_beats_are_joined_by_lines_and_continue_at_the_ends() {
        let beats = TrackedBeats {
            seconds: vec![1.0, 1.5, 2.5],
            beats_per_bar: 3,
        };
        let phase = Beats::Tracked(beats).phase(9, 2.0).unwrap();
        // Beats -2, -1, 0, 1, 1.5, 2, 2.5, 3, 3.5.
        let beats = [1.0, 2.0, 0.0, 1.0, 1.5, 2.0, 2.5, 0.0, 0.5];
        close(&phase, &beats.map(|beat| beat / 3.0));
    }

    #[test]
    fn the_phase_stays_below_one() {
        for beat in [-1e-300, -1e-17, 4.0 - 1e-16, 1e300] {
            let part = part_of_bar(beat, 4);
            assert!((0.0..1.0).contains(&part), "{beat}: {part}");
        }
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        let tracked = |seconds: &[f64]| {
            Beats::Tracked(TrackedBeats {
                seconds: seconds.to_vec(),
                beats_per_bar: 4,
            })
        };
        let bad = [
            tracked(&[]),
            tracked(&[1.0]),
            tracked(&[1.0, 1.0]),
            tracked(&[1.0, f64::NAN]),
            tracked(&[1.0, f64::INFINITY]),
            Beats::Grid(BeatGrid {
                seconds_per_beat: 0.0,
                ..grid()
            }),
            Beats::Grid(BeatGrid {
                beats_per_bar: 0,
                ..grid()
            }),
            Beats::Grid(BeatGrid {
                beats: Some(-1.0),
                ..grid()
            }),
            Beats::Grid(BeatGrid {
                start_seconds: f64::NAN,
                ..grid()
            }),
        ];
        for beats in bad {
            assert!(beats.phase(1, 30.0).is_err(), "{beats:?}");
        }
    }
}
