//! The music of a synthetic phrase: tempo, bars, moves, energy and features.

use std::f64::consts::{PI, TAU};

use kinegrad_audio::Pulse;
use kinegrad_motion::FPS;
use kinegrad_random::Key;

use crate::audio_layout::{AUDIO_CHANNELS, AudioLayout};
use crate::features::AudioFeatures;

/// Number of moves.
pub const MOVES: usize = 4;

/// Beats of a bar.
pub const BEATS_PER_BAR: f64 = 4.0;

// Streams below a phrase's key.
const SCORE: u64 = 0;
const BARS: u64 = 1;
const NOISE: u64 = 2;

/// Standard deviation of the noise in every feature.
const FEATURE_NOISE: f64 = 0.02;

const MEL: usize = 0;
const CHROMA: usize = 128;
const MFCC: usize = 140;
const RMS: usize = 160;
const CENTROID: usize = 161;
const ONSET: usize = 162;

/// The chord of each move, as pitch classes.
const CHORDS: [[usize; 3]; MOVES] = [[0, 4, 7], [5, 9, 0], [7, 11, 2], [9, 0, 4]];

/// A score, from which features are computed.
#[derive(Clone, Debug)]
pub struct Music {
    beats_per_second: f64,
    /// Beat at frame 0, at least one bar.
    first_beat: f64,
    energy: f64,
    swell: f64,
    bars: Key,
}

impl Music {
    /// The music of the phrase with this key: 84 to 132 beats per minute.
    pub fn new(phrase: Key) -> Self {
        let samples = phrase.at(SCORE).uniforms(4);
        let [tempo, beat, energy, swell] = [0, 1, 2, 3].map(|i| f64::from(samples[i]));
        Self {
            beats_per_second: (84.0 + 48.0 * tempo) / 60.0,
            first_beat: BEATS_PER_BAR * (1.0 + beat),
            energy: 0.9 + 0.5 * energy,
            swell: TAU * swell,
            bars: phrase.at(BARS),
        }
    }

    /// Number of beats before frame `t`; a multiple of four begins a bar.
    pub fn beat(&self, t: usize) -> f64 {
        self.first_beat + t as f64 / FPS * self.beats_per_second
    }

    /// The beats and bars of `frames` frames.
    pub fn pulse(&self, frames: usize) -> Option<Pulse> {
        let moment = |beat: f64| (beat - self.first_beat) / self.beats_per_second;
        let last = self.beat(frames).ceil() as usize;
        // Beat 0 is more than a bar before the first frame.
        let beats = (0..=last).map(|beat| moment(beat as f64)).collect();
        Some(Pulse::new(beats)?.with_downbeat(BEATS_PER_BAR as u32, moment(0.0)))
    }

    /// Loudness and movement size around 1, with a period of four bars.
    pub fn energy(&self, beat: f64) -> f64 {
        self.energy + 0.12 * (TAU * beat / 16.0 + self.swell).sin()
    }

    /// Share of each move. Each bar has one move; moves blend over the beat at the bar line, with
    /// two continuous derivatives.
    pub fn moves(&self, beat: f64) -> [f64; MOVES] {
        let line = (beat / BEATS_PER_BAR).round();
        let since_line = beat - BEATS_PER_BAR * line;
        let u = (since_line + 0.5).clamp(0.0, 1.0);
        let share = u * u * u * (10.0 + u * (6.0 * u - 15.0));
        let mut moves = [0.0; MOVES];
        moves[self.move_of_bar(line - 1.0)] += 1.0 - share;
        moves[self.move_of_bar(line)] += share;
        moves
    }

    fn move_of_bar(&self, bar: f64) -> usize {
        self.bars.at(bar as u64).integers(1, MOVES)[0]
    }

    /// The audio features `[163, frames]`: onset peaks on the beats (strongest on the downbeat),
    /// decaying loudness, noise, and a chord, spectrum and brightness for each move.
    pub fn features(&self, frames: usize, phrase: Key) -> AudioFeatures {
        let noise = phrase.at(NOISE).normals(AUDIO_CHANNELS * frames);
        let mut features = AudioFeatures::silence(AudioLayout::CCMOTION, frames);
        for t in 0..frames {
            let column = self.frame_features(t);
            for (channel, value) in column.into_iter().enumerate() {
                let noise = f64::from(noise[channel * frames + t]);
                let noisy = (value + FEATURE_NOISE * noise).clamp(0.0, 1.0);
                features.channel_mut(channel)[t] = noisy as f32;
            }
        }
        fill_mfcc(&mut features);
        features
    }

    /// All features of a frame except the MFCC, in [0, 1].
    fn frame_features(&self, t: usize) -> [f64; AUDIO_CHANNELS] {
        let beat = self.beat(t);
        let moves = self.moves(beat);
        let loudness = self.energy(beat) / 1.6;
        let seconds_since_beat = beat.fract() / self.beats_per_second;
        let decay = (-seconds_since_beat / 0.12).exp();
        let off_beat = (-((beat + 0.5).fract() / self.beats_per_second) / 0.06).exp();
        let nearest = beat.round();
        let frames_off = (beat - nearest) / self.beats_per_second * FPS;
        let accent = match nearest % BEATS_PER_BAR == 0.0 {
            true => 1.0,
            false => 0.65,
        };
        let onset = accent * (-(frames_off / 1.2).powi(2)).exp();

        let mut column = [0.0; AUDIO_CHANNELS];
        for (kind, share) in moves.into_iter().enumerate() {
            let centre = 26.0 + 24.0 * kind as f64;
            for (band, value) in column[MEL..CHROMA].iter_mut().enumerate() {
                *value += 0.8 * share * loudness * (-((band as f64 - centre) / 9.0).powi(2)).exp();
            }
            for pitch in CHORDS[kind] {
                column[CHROMA + pitch] += 0.9 * share;
            }
            column[CENTROID] += share * (0.2 + 0.2 * kind as f64);
        }
        for (band, value) in column[MEL..CHROMA].iter_mut().enumerate() {
            match band {
                0..14 => *value += 0.9 * loudness * decay,
                112.. => *value += 0.6 * loudness * off_beat,
                _ => {}
            }
        }
        column[RMS] = loudness * (0.3 + 0.6 * decay);
        column[CENTROID] += 0.1 * onset;
        column[ONSET] = onset;
        column
    }
}

/// The MFCCs: the first 20 cosine coefficients of the mel bands, each with zero mean and unit
/// deviation.
fn fill_mfcc(features: &mut AudioFeatures) {
    let frames = features.frames();
    for coefficient in 0..RMS - MFCC {
        let mut values = vec![0.0; frames];
        for band in MEL..CHROMA {
            let angle = PI * coefficient as f64 * (band as f64 + 0.5) / 128.0;
            for (sum, &value) in values.iter_mut().zip(features.channel(band)) {
                *sum += angle.cos() * f64::from(value);
            }
        }
        let mean = values.iter().sum::<f64>() / frames as f64;
        let squares = values.iter().map(|value| (value - mean).powi(2));
        let std = (squares.sum::<f64>() / frames as f64).sqrt().max(1e-6);
        let row = features.channel_mut(MFCC + coefficient);
        for (target, value) in row.iter_mut().zip(values) {
            *target = ((value - mean) / std) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kinegrad_random::Purpose;

    fn music(index: u64) -> (Music, Key) {
        let key = Key::new(1, Purpose::Synthetic).at(index);
        (Music::new(key), key)
    }

    #[test]
    fn onsets_peak_on_the_beats_and_nowhere_else() {
        for index in 0..8 {
            let (music, key) = music(index);
            let features = music.features(240, key);
            let beats: Vec<usize> = (1..239)
                .filter(|&t| music.beat(t).round() - music.beat(t - 1).round() == 1.0)
                .collect();
            assert!(beats.len() >= 10);
            for (t, &onset) in features.channel(ONSET).iter().enumerate() {
                let frames_off =
                    (music.beat(t) - music.beat(t).round()).abs() / music.beats_per_second * FPS;
                match frames_off {
                    off if off <= 0.5 => assert!(onset > 0.4, "{}", onset),
                    off if off >= 4.0 => assert!(onset < 0.15, "{}", onset),
                    _ => {}
                }
            }
        }
    }

    #[test]
    fn moves_follow_from_the_features() {
        let mut seen = [0; MOVES];
        for index in 0..16 {
            let (music, key) = music(index);
            let features = music.features(120, key);
            for t in 0..120 {
                let moves = music.moves(music.beat(t));
                assert!((moves.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                let Some(kind) = moves.iter().position(|&share| share == 1.0) else {
                    continue;
                };
                seen[kind] += 1;
                let loudness = |kind: usize| {
                    CHORDS[kind]
                        .iter()
                        .map(|pitch| features.channel(CHROMA + pitch)[t])
                        .sum::<f32>()
                };
                assert!((0..MOVES).all(|other| other == kind || loudness(other) < loudness(kind)));
            }
        }
        assert!(seen.iter().all(|&frames| frames > 50), "{seen:?}");
    }

    #[test]
    fn features_stay_in_their_ranges() {
        let (music, key) = music(3);
        let features = music.features(120, key);
        for channel in (0..AUDIO_CHANNELS).filter(|channel| !(MFCC..RMS).contains(channel)) {
            assert!(
                features
                    .channel(channel)
                    .iter()
                    .all(|value| (0.0..=1.0).contains(value))
            );
        }
        for channel in MFCC..RMS {
            let values = features.channel(channel);
            let square = values.iter().map(|value| value * value).sum::<f32>() / 120.0;
            assert!((square - 1.0).abs() < 1e-3, "{square}");
        }
    }

    #[test]
    fn blends_are_smooth_across_the_bar_line() {
        let (music, _) = music(0);
        let step = 1e-4;
        for beat in (0..8000).map(|i| 4.0 + f64::from(i) / 1000.0) {
            for (now, then) in music.moves(beat).into_iter().zip(music.moves(beat + step)) {
                // The steepest slope of the blend is 15/8 per beat.
                assert!(
                    (now - then).abs() <= 1.9 * step,
                    "beat {beat}: {now} {then}"
                );
            }
        }
    }
}
