//! Positions within beats and bars, and their beat features.
//!
//! The position is linear in time between beats; beyond the ends, beats continue at the distance of
//! the nearest two beats.

use std::f64::consts::TAU;

use crate::{Beats, FPS};

/// The rows of the beat features: sine and cosine of the position in the beat; sine and cosine of
/// the position in the bar, and 1 if the bars are known (all three 0 otherwise); 1 in the frame
/// nearest to a beat; the tempo in octaves above [`REFERENCE_BPM`].
pub const BEAT_FEATURES: [&str; 7] = [
    "beat_sin",
    "beat_cos",
    "bar_sin",
    "bar_cos",
    "bar_known",
    "beat",
    "tempo",
];

/// Beats per minute at tempo feature 0.
pub const REFERENCE_BPM: f64 = 120.0;

/// Beats on either side that the smoothing uses.
const REACH: usize = 4;

/// Largest shift of a smoothed beat in seconds: one frame, the precision of tracking.
const MOST_MOVED: f64 = 1.0 / FPS;

/// Beats on either side of a moment whose distances the local tempo averages.
const TEMPO_REACH: f64 = 2.0;

/// The beats of a song in seconds, with the bars if they are known.
#[derive(Clone, Debug, PartialEq)]
pub struct Pulse {
    seconds: Vec<f64>,
    bars: Option<Bars>,
}

/// The metre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bars {
    /// Beats in a bar, at least 1.
    pub beats_per_bar: u32,
    /// Position of a downbeat, in beats from the first.
    pub downbeat: f64,
}

impl Pulse {
    /// Beats at these `seconds`; `None` unless `seconds` has at least two finite, increasing
    /// values.
    pub fn new(seconds: Vec<f64>) -> Option<Self> {
        let increasing = seconds.windows(2).all(|pair| pair[0] < pair[1]);
        let sound = seconds.len() >= 2 && increasing && seconds.iter().all(|s| s.is_finite());
        sound.then_some(Self {
            seconds,
            bars: None,
        })
    }

    /// Even beats from `start` seconds on; `None` unless `seconds_per_beat` is positive.
    pub fn even(start: f64, seconds_per_beat: f64) -> Option<Self> {
        // Two beats are extrapolated on both sides.
        Self::new(vec![start, start + seconds_per_beat])
    }

    /// The smoothed beats of a tracker that rounds beats to frames. Each beat moves by at most a
    /// frame towards the line fitted to four beats on either side. `None` for fewer than two beats.
    pub fn tracked(beats: &Beats) -> Option<Self> {
        let tracked = beats.times();
        let smoothed = (0..tracked.len()).map(|k| {
            let around = k.saturating_sub(REACH)..tracked.len().min(k + REACH + 1);
            let line = fitted(&tracked[around.clone()], (k - around.start) as f64);
            line.clamp(tracked[k] - MOST_MOVED, tracked[k] + MOST_MOVED)
        });
        let mut smoothed: Vec<f64> = smoothed.collect();
        // Smoothing could reorder beats less than two frames apart.
        if smoothed.windows(2).any(|pair| pair[0] >= pair[1]) {
            smoothed = tracked;
        }
        Self::new(smoothed)
    }

    /// `count` beats (at least two) from position `first` on, extrapolated, without bars.
    pub fn from_beat(&self, first: f64, count: usize) -> Self {
        let moment = |k: usize| self.moment(first + k as f64);
        Self {
            seconds: (0..count.max(2)).map(moment).collect(),
            bars: None,
        }
    }

    /// The beats in bars of `beats_per_bar`, at least 1. A bar begins at the beat nearest to
    /// `downbeat` seconds.
    pub fn with_downbeat(self, beats_per_bar: u32, downbeat: f64) -> Self {
        let downbeat = self.position(downbeat).round();
        let bars = Some(Bars {
            beats_per_bar: beats_per_bar.max(1),
            downbeat,
        });
        Self { bars, ..self }
    }

    /// The bars, if they are known.
    pub fn bars(&self) -> Option<Bars> {
        self.bars
    }

    /// Moments of the beats, in seconds.
    pub fn seconds(&self) -> &[f64] {
        &self.seconds
    }

    /// Beats from the first beat to a moment.
    pub fn position(&self, seconds: f64) -> f64 {
        position(&self.seconds, seconds)
    }

    /// The moment of a position, the inverse of [`position`](Self::position).
    pub fn moment(&self, position: f64) -> f64 {
        let last = (position.floor().max(0.0) as usize).min(self.seconds.len() - 2);
        let (from, to) = (self.seconds[last], self.seconds[last + 1]);
        from + (position - last as f64) * (to - from)
    }

    /// Beats per minute around a moment.
    pub fn tempo(&self, seconds: f64) -> f64 {
        let position = self.position(seconds);
        let [from, to] = [-TEMPO_REACH, TEMPO_REACH].map(|beats| self.moment(position + beats));
        60.0 * 2.0 * TEMPO_REACH / (to - from)
    }

    /// The rows of [`BEAT_FEATURES`] for frames `0..frames` at [`FPS`] per second, channel-major
    /// `[7, frames]`.
    pub fn features(&self, frames: usize) -> Vec<f32> {
        let mut rows = vec![0.0; BEAT_FEATURES.len() * frames];
        for t in 0..frames {
            let seconds = t as f64 / FPS;
            let position = self.position(seconds);
            let half = 0.5 / FPS;
            let [before, after] = [seconds - half, seconds + half].map(|s| self.position(s));
            let (bar, known) = match self.bars {
                Some(Bars {
                    beats_per_bar,
                    downbeat,
                }) => ((position - downbeat) / f64::from(beats_per_bar), 1.0),
                None => (0.0, 0.0),
            };
            let values = [
                (TAU * position).sin(),
                (TAU * position).cos(),
                known * (TAU * bar).sin(),
                known * (TAU * bar).cos(),
                known,
                f64::from(u8::from(before.floor() < after.floor())),
                (self.tempo(seconds) / REFERENCE_BPM).log2(),
            ];
            for (row, value) in values.into_iter().enumerate() {
                rows[row * frames + t] = value as f32;
            }
        }
        rows
    }
}

/// Beats from the first of increasing `beats` to a moment.
///
/// # Panics
/// Panics on fewer than two beats.
pub fn position(beats: &[f64], seconds: f64) -> f64 {
    let started = beats.partition_point(|beat| *beat <= seconds);
    let last = started.saturating_sub(1).min(beats.len() - 2);
    let (from, to) = (beats[last], beats[last + 1]);
    last as f64 + (seconds - from) / (to - from)
}

/// The least-squares line through `values` at 0, 1, ..., evaluated at `place`.
fn fitted(values: &[f64], place: f64) -> f64 {
    let n = values.len() as f64;
    let centre = (n - 1.0) / 2.0;
    let mean = values.iter().sum::<f64>() / n;
    let (mut products, mut squares) = (0.0, 0.0);
    for (i, value) in values.iter().enumerate() {
        products += (i as f64 - centre) * (value - mean);
        squares += (i as f64 - centre).powi(2);
    }
    match squares > 0.0 {
        true => mean + products / squares * (place - centre),
        false => mean,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn pulse() -> Pulse {
        Pulse::new(vec![1.0, 1.5, 2.5, 3.0]).unwrap()
    }

    fn row(features: &[f32], name: &str) -> Vec<f32> {
        let frames = features.len() / BEAT_FEATURES.len();
        let row = BEAT_FEATURES.iter().position(|known| *known == name);
        features[row.unwrap() * frames..][..frames].to_vec()
    }

    #[test]
    fn positions_are_linear_between_beats_and_beyond_the_ends() {
        for (seconds, position) in [
            (0.5, -1.0),
            (1.0, 0.0),
            (1.25, 0.5),
            (2.0, 1.5),
            (3.0, 3.0),
            (3.75, 4.5),
        ] {
            assert!((pulse().position(seconds) - position).abs() < 1e-12);
            assert!((pulse().moment(position) - seconds).abs() < 1e-12);
        }
    }

    #[test]
    fn too_few_or_disordered_beats_are_refused() {
        for bad in [&[][..], &[1.0], &[1.0, 1.0], &[2.0, 1.0], &[0.0, f64::NAN]] {
            assert_eq!(Pulse::new(bad.to_vec()), None, "{bad:?}");
        }
    }

    #[test]
    fn beats_from_one_on_keep_the_moments() {
        let later = pulse().from_beat(-1.0, 3);
        assert_eq!(later.seconds(), [0.5, 1.0, 1.5]);
        let even = Pulse::even(0.5, 0.25).unwrap();
        assert_eq!((even.position(2.0), even.moment(-2.0)), (6.0, 0.0));
        assert_eq!(Pulse::even(0.5, 0.0), None);
    }

    #[test]
    fn features_are_zero_for_bars_without_a_downbeat() {
        let frames = 100;
        let unknown = pulse().features(frames);
        for name in ["bar_sin", "bar_cos", "bar_known"] {
            assert!(row(&unknown, name).iter().all(|v| *v == 0.0), "{name}");
        }
        // The beat at 2.5 s begins a bar of three, so the beat at 1 s does not.
        let known = pulse().with_downbeat(3, 2.4).features(frames);
        assert!(row(&known, "bar_known").iter().all(|v| *v == 1.0));
        let (sine, cosine) = (row(&known, "bar_sin"), row(&known, "bar_cos"));
        assert!(sine[75].abs() < 1e-6 && (cosine[75] - 1.0).abs() < 1e-6);
        assert!((f64::from(sine[30]) - (TAU / 3.0).sin()).abs() < 1e-6);
        for name in ["beat_sin", "beat_cos", "beat", "tempo"] {
            assert_eq!(row(&known, name), row(&unknown, name));
        }
    }

    #[test]
    fn every_beat_marks_its_nearest_frame() {
        let pulse = Pulse::new(vec![0.11, 0.53, 1.02, 1.48]).unwrap();
        let features = pulse.features(46);
        let marked: Vec<usize> = (0..46)
            .filter(|&t| row(&features, "beat")[t] == 1.0)
            .collect();
        // 3.3, 15.9, 30.6 and 44.4 frames.
        assert_eq!(marked, [3, 16, 31, 44]);
        let slow = Pulse::new((0..9).map(f64::from).collect()).unwrap();
        let octaves = row(&slow.features(200), "tempo");
        assert!(
            octaves.iter().all(|v| (v + 1.0).abs() < 1e-6),
            "60 a minute"
        );
    }

    #[test]
    fn rounding_to_frames_is_smoothed_away_and_a_change_of_tempo_is_not() {
        let even: Vec<f64> = (0..60).map(|k| 0.2 + 0.4688 * f64::from(k)).collect();
        let frames = |times: &[f64]| Beats {
            tempo: 128.0,
            frames: times.iter().map(|s| (s * FPS).round() as usize).collect(),
        };
        let smoothed = Pulse::tracked(&frames(&even)).unwrap();
        for (k, pair) in smoothed.seconds().windows(2).enumerate() {
            assert!((pair[1] - pair[0] - 0.4688).abs() < 0.006, "{k}: {pair:?}");
        }
        let slower: Vec<f64> = (1..40).map(|k| even[59] + 0.7 * f64::from(k)).collect();
        let all = [even, slower].concat();
        let smoothed = Pulse::tracked(&frames(&all)).unwrap();
        for (found, expected) in smoothed.seconds().iter().zip(&all) {
            assert!((found - expected).abs() < 1.5 / FPS, "{found} {expected}");
        }
    }

    proptest! {
        #[test]
        fn a_position_maps_back_to_its_time(
            gaps in prop::collection::vec(0.05f64..2.0, 2..40),
            at in -5.0f64..60.0,
        ) {
            let seconds = gaps.iter().scan(0.0, |sum, gap| { *sum += gap; Some(*sum) });
            let pulse = Pulse::new(seconds.collect()).unwrap();
            prop_assert!((pulse.moment(pulse.position(at)) - at).abs() < 1e-9);
        }
    }
}
