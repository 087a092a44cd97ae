//! Beats by dynamic programming over an onset envelope.
//!
//! ```text
//! local = (o / std o) * exp(-0.5 (32 j / P)^2),  j = -P..P
//! cum[i] = local[i] + max_j ( cum[j] - 100 (ln(i - j) - ln P)^2 ),  i - 2P <= j <= i - P/2
//! ```
//! with `P` frames a beat. Source: Ellis, Beat tracking by dynamic programming, 2007; librosa 0.11
//! `beat.beat_track`.

use crate::FPS;
use crate::tempo::{self, FRAMES_PER_MINUTE, LAGS, Tempo};

/// Weight of the tempo in the score.
const TIGHTNESS: f64 = 100.0;
/// Smallest local score of the first beat, relative to the largest local score.
const FIRST_BEAT_SHARE: f64 = 0.01;
/// Taps of the centred smoothing filter in [`trim`].
const SMOOTHING: [f64; 3] = [0.5, 1.0, 0.5];

/// The tempo and the beats of a piece.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Beats {
    /// Beats per minute; 0 without an onset.
    pub tempo: f64,
    /// Frames of the beats, ascending.
    pub frames: Vec<usize>,
}

impl Beats {
    /// Times of the beats in seconds.
    pub fn times(&self) -> Vec<f64> {
        self.frames.iter().map(|&t| t as f64 / FPS).collect()
    }
}

/// Intermediate results of the dynamic programme.
#[derive(Clone, Debug, PartialEq)]
pub struct Search {
    /// Frames in a beat, `P`.
    pub frames_per_beat: usize,
    /// Smoothed envelope, `[T]`.
    pub local_score: Vec<f64>,
    /// Best score of a chain of beats that ends at each frame, `[T]`.
    pub cumulative_score: Vec<f64>,
    /// The previous beat of each frame's best chain, `[T]`.
    pub backlinks: Vec<Option<usize>>,
}

/// Tempo and beats of `onset_envelope`, `[T]` at [`FPS`] frames a second, any scale, any length. An
/// envelope of zeros, or with a value that is not finite, has no beats.
pub fn track(onset_envelope: &[f32]) -> Beats {
    track_at(onset_envelope, tempo::estimate)
}

/// [`track`] near a tempo of `bpm` beats per minute, without its half and double.
pub fn track_near(onset_envelope: &[f32], bpm: f64) -> Beats {
    track_at(onset_envelope, |onset| tempo::estimate_near(onset, bpm))
}

fn track_at(onset_envelope: &[f32], tempo: impl FnOnce(&[f32]) -> Tempo) -> Beats {
    if !has_onset(onset_envelope) {
        return Beats::default();
    }
    let tempo = tempo(onset_envelope);
    let search = Search::new(onset_envelope, &tempo);
    Beats {
        tempo: tempo.bpm,
        frames: search.beats(),
    }
}

fn has_onset(onset_envelope: &[f32]) -> bool {
    onset_envelope.iter().all(|v| v.is_finite()) && onset_envelope.iter().any(|&v| v != 0.0)
}

impl Search {
    /// Runs the dynamic programme at a fixed tempo.
    ///
    /// # Panics
    /// Panics unless a beat of this tempo lasts 1 to [`LAGS`] frames.
    pub fn new(onset_envelope: &[f32], tempo: &Tempo) -> Self {
        let frames_per_beat = (FRAMES_PER_MINUTE / tempo.bpm).round_ties_even() as usize;
        assert!((1..=LAGS).contains(&frames_per_beat), "a possible tempo");
        let local_score = local_score(onset_envelope, frames_per_beat);
        let (cumulative_score, backlinks) = link(&local_score, frames_per_beat);
        Self {
            frames_per_beat,
            local_score,
            cumulative_score,
            backlinks,
        }
    }

    /// Follows the links from the last beat and drops weak beats at both ends.
    pub fn beats(&self) -> Vec<usize> {
        let last = last_beat(&self.cumulative_score);
        let mut beats: Vec<usize> = std::iter::successors(last, |&i| self.backlinks[i]).collect();
        beats.reverse();
        trim(&self.local_score, beats)
    }
}

/// The envelope in units of its sample standard deviation, smoothed over one beat.
fn local_score(onset_envelope: &[f32], frames_per_beat: usize) -> Vec<f64> {
    let n = onset_envelope.len();
    let values = || onset_envelope.iter().map(|&v| f64::from(v));
    let mean = values().sum::<f64>() / n as f64;
    let squares: f64 = values().map(|v| (v - mean) * (v - mean)).sum();
    let deviation = if n > 1 {
        (squares / (n - 1) as f64).sqrt()
    } else {
        0.0
    };
    let scaled: Vec<f64> = values()
        .map(|v| v / (deviation + f64::from(f32::MIN_POSITIVE)))
        .collect();
    let weight = |j: usize| (-0.5 * (32.0 * j as f64 / frames_per_beat as f64).powi(2)).exp();
    let weights: Vec<f64> = (0..=frames_per_beat).map(weight).collect();
    (0..n)
        .map(|i| {
            let reach = i.saturating_sub(frames_per_beat)..n.min(i + frames_per_beat + 1);
            reach.map(|k| weights[k.abs_diff(i)] * scaled[k]).sum()
        })
        .collect()
}

/// Cumulative scores and links to the best previous beat.
fn link(local: &[f64], frames_per_beat: usize) -> (Vec<f64>, Vec<Option<usize>>) {
    let nearest = (frames_per_beat as f64 / 2.0).round_ties_even() as usize;
    let distances = nearest.max(1)..=2 * frames_per_beat;
    let penalty = |d: usize| {
        let stretch = (d as f64).ln() - (frames_per_beat as f64).ln();
        TIGHTNESS * stretch * stretch
    };
    let penalties: Vec<(usize, f64)> = distances.map(|d| (d, penalty(d))).collect();
    let threshold = FIRST_BEAT_SHARE * local.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mut cumulative: Vec<f64> = Vec::with_capacity(local.len());
    let mut links = Vec::with_capacity(local.len());
    let mut started = false;
    for (i, &score) in local.iter().enumerate() {
        let mut best: Option<(usize, f64)> = None;
        for &(distance, penalty) in penalties.iter().take_while(|(d, _)| *d <= i) {
            let candidate = cumulative[i - distance] - penalty;
            if best.is_none_or(|(_, so_far)| candidate > so_far) {
                best = Some((i - distance, candidate));
            }
        }
        cumulative.push(score + best.map_or(0.0, |(_, score)| score));
        started |= score >= threshold;
        links.push(best.filter(|_| started).map(|(j, _)| j));
    }
    (cumulative, links)
}

/// The last local maximum of at least half the median of all local maxima, else the final frame.
fn last_beat(cumulative: &[f64]) -> Option<usize> {
    let n = cumulative.len();
    let peaks: Vec<usize> = (1..n)
        .filter(|&i| {
            cumulative[i] > cumulative[i - 1]
                && cumulative
                    .get(i + 1)
                    .is_none_or(|&next| cumulative[i] >= next)
        })
        .collect();
    let mut heights: Vec<f64> = peaks.iter().map(|&i| cumulative[i]).collect();
    heights.sort_unstable_by(f64::total_cmp);
    let count = heights.len();
    let median = match count {
        0 => return n.checked_sub(1),
        _ if count.is_multiple_of(2) => (heights[count / 2 - 1] + heights[count / 2]) / 2.0,
        _ => heights[count / 2],
    };
    let strong = peaks.iter().rev().find(|&&i| cumulative[i] >= 0.5 * median);
    strong.copied().or(n.checked_sub(1))
}

/// Drops the beats before the first and after the last strong frame.
fn trim(local: &[f64], beats: Vec<usize>) -> Vec<usize> {
    let at = |i: usize| beats.get(i).map_or(0.0, |&beat| local[beat]);
    let smoothed: Vec<f64> = (0..beats.len() + 2)
        .take(local.len())
        .map(|i| {
            let before = if i == 0 { 0.0 } else { at(i - 1) };
            SMOOTHING[0] * before + SMOOTHING[1] * at(i) + SMOOTHING[2] * at(i + 1)
        })
        .collect();
    let power = smoothed.iter().map(|v| v * v).sum::<f64>() / smoothed.len().max(1) as f64;
    let threshold = 0.5 * power.sqrt();
    let strong = |&score: &f64| score > threshold;
    let first = local.iter().position(strong).unwrap_or(local.len());
    let last = local.iter().rposition(strong).unwrap_or(0);
    beats
        .into_iter()
        .filter(|beat| (first..=last).contains(beat))
        .collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn pulses_are_beats() {
        let pulses: Vec<f32> = (0..300).map(|t| f32::from(u8::from(t % 15 == 7))).collect();
        let beats = track(&pulses);
        assert_eq!(beats.tempo, 120.0);
        assert_eq!(beats.frames, (7..300).step_by(15).collect::<Vec<_>>());
        assert_eq!(beats.times()[1], 22.0 / 30.0);
    }

    #[test]
    fn a_stated_tempo_settles_the_octave() {
        // Beats at 69 a minute with slightly weaker eighths between them: 138 a minute.
        let pulses: Vec<f32> = (0..900)
            .map(|t| match t % 26 {
                3 => 1.0,
                16 => 0.9,
                _ => 0.0,
            })
            .collect();
        let every = |step| (3..900).step_by(step).collect::<Vec<_>>();
        assert_eq!(track(&pulses).frames, every(13));
        let halved = track_near(&pulses, 67.0);
        assert_eq!((halved.tempo, halved.frames), (1800.0 / 26.0, every(26)));
        assert_eq!(track_near(&pulses, 141.0), track(&pulses));
        assert_eq!(track_near(&[0.0; 50], 90.0), Beats::default());
        // Every stated tempo has an allowed lag.
        for bpm in [0.1, 5.0, 1799.0, 1e6] {
            assert!(track_near(&pulses, bpm).tempo > 0.0);
        }
    }

    #[test]
    fn silence_and_broken_envelopes_have_no_beats() {
        for envelope in [&[][..], &[0.0; 50], &[0.0, f32::NAN, 1.0]] {
            assert_eq!(track(envelope), Beats::default());
        }
    }

    proptest! {
        #[test]
        fn beats_lie_inside_any_envelope(
            envelope in prop::collection::vec(-1.0f32..30.0, 0..400),
        ) {
            let beats = track(&envelope);
            prop_assert!(beats.frames.windows(2).all(|pair| pair[0] < pair[1]));
            prop_assert!(beats.frames.iter().all(|&t| t < envelope.len()));
            prop_assert!(beats.tempo.is_finite());
        }
    }
}
