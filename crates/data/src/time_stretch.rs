//! Time stretch of audio features.

use std::f64::consts::TAU;
use std::ops::Range;

use kinegrad_motion::circular::step;
use kinegrad_motion::time_stretch::{between, frames_at_speed};

use crate::audio_layout::AUDIO_CHANNELS;
use crate::features::AudioFeatures;

// Rows of the beat features.
const BEAT: Range<usize> = 0..2;
const BAR: Range<usize> = 2..4;
const BAR_KNOWN: usize = 4;
const MARK: usize = 5;
const TEMPO: usize = 6;

/// The features of music played at `speed`, at the times of
/// [`at_speed`](kinegrad_motion::time_stretch::at_speed), with unchanged pitch. Beat marks and
/// tempo change with the speed.
pub(crate) fn at_speed(audio: &AudioFeatures, speed: f64) -> AudioFeatures {
    let from = audio.frames();
    let frames = frames_at_speed(from, speed);
    let moments: Vec<_> = (0..frames)
        .map(|t| between(from, speed * t as f64))
        .collect();
    let mixed = |row: &[f32]| -> Vec<f32> {
        let mix = |&(a, b, fraction): &(usize, usize, f64)| {
            (1.0 - fraction) * f64::from(row[a]) + fraction * f64::from(row[b])
        };
        moments.iter().map(|moment| mix(moment) as f32).collect()
    };
    let mut values: Vec<f32> = (0..audio.channels())
        .flat_map(|channel| mixed(audio.channel(channel)))
        .collect();
    if audio.layout().beats {
        let beats = &mut values[AUDIO_CHANNELS * frames..];
        let source = |row: usize| audio.channel(AUDIO_CHANNELS + row);
        for circle in [BEAT, BAR] {
            let places = unwrapped(source(circle.start), source(circle.start + 1));
            let place = |moment: f64| position(&places, moment);
            for t in 0..frames {
                let moment = speed * t as f64;
                let Some(at) = place(moment) else {
                    continue;
                };
                beats[circle.start * frames + t] = (TAU * at).sin() as f32;
                beats[(circle.start + 1) * frames + t] = (TAU * at).cos() as f32;
                if circle == BEAT {
                    // A beat mark covers beats within half a frame.
                    let [first, last] =
                        [-0.5, 0.5].map(|half| place(moment + half * speed).map(f64::floor));
                    beats[MARK * frames + t] = f32::from(u8::from(first < last));
                }
            }
        }
        for (t, &(a, _, _)) in moments.iter().enumerate() {
            beats[BAR_KNOWN * frames + t] = source(BAR_KNOWN)[a];
            // Channel `TEMPO` is the logarithm of the tempo; zero without beats.
            if source(BEAT.start)[a].hypot(source(BEAT.start + 1)[a]) > 0.5 {
                beats[TEMPO * frames + t] += speed.log2() as f32;
            }
        }
    }
    AudioFeatures::new(frames, values).expect("as many channels as before")
}

/// Unwrapped positions on a circle from sines and cosines; `None` where both are zero.
fn unwrapped(sine: &[f32], cosine: &[f32]) -> Vec<Option<f64>> {
    let mut before: Option<f64> = None;
    let place = |(&s, &c): (&f32, &f32)| {
        let place = (s.hypot(c) > 0.5).then(|| f64::from(s.atan2(c)) / TAU);
        before = place.map(|place| before.map_or(place, |before| before + step(before, place)));
        before
    };
    sine.iter().zip(cosine).map(place).collect()
}

/// The interpolated or extrapolated position at `moment`, in frames.
fn position(places: &[Option<f64>], moment: f64) -> Option<f64> {
    if places.len() < 2 {
        return places[0];
    }
    let from = (moment.max(0.0) as usize).min(places.len() - 2);
    let (a, b) = (places[from]?, places[from + 1]?);
    Some(a + (moment - from as f64) * (b - a))
}

#[cfg(test)]
mod tests {
    use kinegrad_audio::Pulse;
    use kinegrad_audio::pulse::BEAT_FEATURES;

    use super::*;
    use crate::AudioLayout;

    #[test]
    fn the_rows_are_those_of_the_beat_features() {
        let names = [BEAT.start, BAR.start, BAR_KNOWN, MARK, TEMPO].map(|row| BEAT_FEATURES[row]);
        assert_eq!(names, ["beat_sin", "bar_sin", "bar_known", "beat", "tempo"]);
    }

    #[test]
    fn beats_are_those_of_the_faster_song() {
        let beats: Vec<f64> = (0..20).map(|beat| 0.13 + 0.5 * f64::from(beat)).collect();
        for speed in [0.8, 1.0, 1.25] {
            let pulse = |speed: f64| {
                let beats = beats.iter().map(|beat| beat / speed).collect();
                Pulse::new(beats).unwrap().with_downbeat(4, 0.63 / speed)
            };
            let song =
                AudioFeatures::silence(AudioLayout::CCMOTION, 200).with_beats(Some(&pulse(1.0)));
            let played = at_speed(&song, speed);
            let expected = AudioFeatures::silence(AudioLayout::CCMOTION, played.frames())
                .with_beats(Some(&pulse(speed)));
            assert_eq!(played.frames(), frames_at_speed(200, speed));
            for (row, name) in BEAT_FEATURES.iter().enumerate() {
                let pairs = [&played, &expected].map(|f| f.channel(AUDIO_CHANNELS + row));
                for (t, (a, b)) in pairs[0].iter().zip(pairs[1]).enumerate() {
                    assert!((a - b).abs() < 1e-4, "{speed} {name} of {t}: {a} not {b}");
                }
            }
        }
    }

    #[test]
    fn each_beat_is_marked_once_whatever_the_intervals() {
        // All intervals differ from their neighbors.
        let beats: Vec<f64> = (0..20)
            .map(|beat| 0.13 + 0.5 * f64::from(beat) + 0.04 * f64::from(beat * 7 % 3))
            .collect();
        for speed in [0.5, 0.8, 1.25, 2.0] {
            let pulse = |speed: f64| Pulse::new(beats.iter().map(|beat| beat / speed).collect());
            let song =
                AudioFeatures::silence(AudioLayout::CCMOTION, 300).with_beats(pulse(1.0).as_ref());
            let played = at_speed(&song, speed);
            let expected = AudioFeatures::silence(AudioLayout::CCMOTION, played.frames())
                .with_beats(pulse(speed).as_ref());
            let [found, expected] = [played, expected].map(|features| {
                let marks = features.channel(AUDIO_CHANNELS + MARK).to_vec();
                (0..marks.len())
                    .filter(|&t| marks[t] > 0.0)
                    .collect::<Vec<_>>()
            });
            assert_eq!(found.len(), expected.len(), "{speed}");
            for (a, b) in found.iter().zip(&expected) {
                assert!(a.abs_diff(*b) <= 1, "{speed}: {found:?} {expected:?}");
            }
        }
    }

    #[test]
    fn what_sounds_is_the_same_at_other_moments() {
        let ramp: Vec<f32> = (0..AUDIO_CHANNELS * 11).map(|i| (i % 11) as f32).collect();
        let song = AudioFeatures::new(11, ramp).unwrap();
        let played = at_speed(&song, 2.5);
        assert_eq!(played.frames(), 5);
        for channel in [0, 130, 162] {
            assert_eq!(played.channel(channel), [0.0, 2.5, 5.0, 7.5, 10.0]);
        }
        assert_eq!(at_speed(&song, 1.0), song);
        // A song without known beats has no beats at another speed.
        let silent = AudioFeatures::silence(AudioLayout::WITH_BEATS, 9);
        let played = at_speed(&silent, 0.5);
        assert!(played.as_slice().iter().all(|value| *value == 0.0));
        assert_eq!(played.frames(), 17);
    }
}
