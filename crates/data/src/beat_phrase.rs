//! Phrases with beats: the beat and bar phase of each frame.

use std::sync::Arc;

use kinegrad_audio::Pulse;
use kinegrad_audio::beats::track_near;
use kinegrad_audio::pulse::BEAT_FEATURES;
use kinegrad_motion::metrics::phase_error;
use kinegrad_motion::motion_measures::phase_steps;
use kinegrad_motion::phrase::PHASE;
use kinegrad_motion::quantiles::percentile;
use kinegrad_motion::{FPS, Phrase, circular};

use crate::{AUDIO_CHANNELS, PhraseItem, Songs};

/// Beats in a bar if the number is neither stated nor measured.
const COMMON_TIME: f64 = 4.0;

/// Largest relative distance of the measured number of beats in a bar from a whole number. Tempi
/// are means over a take, so the tempo of a phrase differs slightly.
const TOLERANCE: f64 = 0.1;

/// Fewest tracked beats of a phrase.
const FEWEST_TRACKED: usize = 4;

/// A phrase whose phase channel has beats.
#[derive(Clone, Debug)]
pub struct BeatPhrase {
    /// The phrase.
    pub phrase: Arc<PhraseItem>,
    /// Its song.
    pub song: String,
    /// Beats in a bar.
    pub beats_per_bar: f64,
    /// True if `beats_per_bar` is a guess.
    pub guessed: bool,
    /// The phase channel: the bar phase of the music in each frame.
    pub bars: Vec<f64>,
}

impl BeatPhrase {
    /// The phrase with the song's name and tempo. The beats in a bar are `stated`, else measured,
    /// else four. `None` if the phrase's phase advances by less than a beat.
    pub fn new(phrase: Arc<PhraseItem>, songs: &Songs, stated: Option<f64>) -> Option<Self> {
        let measured = || {
            let tempo = songs.tempo(&phrase.id);
            beats_in_a_bar(&phrase.motion, tempo.map(|tempo| tempo / 60.0 / FPS))
                .or_else(|| beats_in_a_bar(&phrase.motion, beat_step(&phrase)))
        };
        let known = stated.or_else(measured);
        let beats_per_bar = known.unwrap_or(COMMON_TIME);
        let advance = phase_steps(&phrase.motion).iter().sum::<f64>();
        (advance * beats_per_bar >= 1.0).then(|| Self {
            song: songs.song(&phrase.id),
            beats_per_bar,
            guessed: known.is_none(),
            bars: bars(&phrase.motion),
            phrase,
        })
    }

    /// Number of beats from the first frame to each frame.
    pub fn beats(&self) -> Vec<f64> {
        let steps = phase_steps(&self.phrase.motion);
        let mut beats = vec![0.0];
        for step in steps {
            beats.push(beats[beats.len() - 1] + step * self.beats_per_bar);
        }
        beats
    }

    /// Times of the beats in seconds, interpolated between frames in proportion to the beat phase.
    pub fn beat_times(&self) -> Vec<f64> {
        let first = self.bars[0] * self.beats_per_bar;
        // A phase that moves backward passes each beat only once.
        let mut furthest = f64::NEG_INFINITY;
        let beats = self.beats().into_iter().map(|beat| {
            furthest = furthest.max(first + beat);
            furthest
        });
        let beats: Vec<f64> = beats.collect();
        let crossed = |t: usize| {
            let (before, after) = (beats[t - 1], beats[t]);
            let beat = after.floor();
            (before < beat || (t == 1 && before == beat)).then(|| {
                let share = (beat - before) / (after - before);
                (t as f64 - 1.0 + share) / FPS
            })
        };
        (1..beats.len()).filter_map(crossed).collect()
    }

    /// Mean distance, in beats, between the beat phases of `motion` and of the phrase, 0 to 0.5. NaN
    /// for a phase that is not finite.
    pub fn phase_error(&self, motion: &Phrase) -> f64 {
        phase_error(&bars(motion), &self.bars, self.beats_per_bar)
    }

    /// Mean distance, in beats, between the beats of the phase channel and the beats tracked in the
    /// music near the tempo of the phase, 0 to 0.5. `None` if the tracker finds fewer than four
    /// beats, whose distance is too uncertain.
    pub fn tracked_error(&self) -> Option<f64> {
        let seconds = (self.bars.len() - 1) as f64 / FPS;
        let tempo = 60.0 * self.beats().last()? / seconds;
        let tracked = track_near(self.phrase.audio.onset_strength(), tempo);
        if tracked.frames.len() < FEWEST_TRACKED {
            return None;
        }
        let pulse = Pulse::tracked(&tracked)?;
        let positions = (0..self.bars.len()).map(|t| pulse.position(t as f64 / FPS));
        let beats = self.bars.iter().map(|bar| bar * self.beats_per_bar);
        let (positions, beats): (Vec<f64>, Vec<f64>) = positions.zip(beats).unzip();
        Some(phase_error(&positions, &beats, 1.0))
    }
}

/// The bar phase in each frame of a motion.
pub fn bars(motion: &Phrase) -> Vec<f64> {
    let phase = |t: usize| f64::from(motion.frame(t)[PHASE]);
    (0..motion.frames()).map(phase).collect()
}

/// The whole number of beats in a bar: the ratio of `beat_step`, in beats per frame, and the bar
/// phase's step in `motion`; `None` if the ratio is not near a whole number.
fn beats_in_a_bar(motion: &Phrase, beat_step: Option<f64>) -> Option<f64> {
    let steps = phase_steps(motion);
    if steps.is_empty() {
        return None;
    }
    let ratio = beat_step? / percentile(steps, 50.0);
    let whole = ratio.round();
    (ratio.is_finite() && whole >= 1.0 && (ratio / whole - 1.0).abs() <= TOLERANCE).then_some(whole)
}

/// The median advance of the beat phase per frame in the phrase's beat features.
fn beat_step(phrase: &PhraseItem) -> Option<f64> {
    if !phrase.audio.layout().beats || phrase.frames() < 2 {
        return None;
    }
    let row = |name: &str| {
        let place = BEAT_FEATURES.iter().position(|known| *known == name);
        phrase
            .audio
            .channel(AUDIO_CHANNELS + place.expect("a beat feature"))
    };
    let phase = row("beat_sin").iter().zip(row("beat_cos"));
    let phase: Vec<f64> = phase
        .map(|(sine, cosine)| f64::from(*sine).atan2(f64::from(*cosine)) / std::f64::consts::TAU)
        .collect();
    let steps = phase
        .windows(2)
        .map(|pair| circular::step(pair[0], pair[1]));
    Some(percentile(steps.collect(), 50.0)).filter(|step| *step > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{AudioLayout, synthetic};

    /// A synthetic phrase with a phase that starts at `start` and advances by `bars` per second.
    fn with_phase(index: usize, frames: usize, start: f64, bars: f64) -> PhraseItem {
        let mut phrase = synthetic::phrase(index, frames, 1);
        for t in 0..frames {
            let phase = (start + bars * t as f64 / FPS).rem_euclid(1.0);
            phrase.motion.frame_mut(t)[PHASE] = phase as f32;
        }
        phrase
    }

    fn beat_phrase(phrase: PhraseItem, stated: Option<f64>) -> Option<BeatPhrase> {
        BeatPhrase::new(Arc::new(phrase), &Songs::default(), stated)
    }

    #[test]
    fn beats_of_a_bar_are_stated_or_found_in_beat_features_or_four() {
        // 96 beats per minute are 0.4 bars of four or 0.533 bars of three per second.
        let pulse = Pulse::even(-0.4, 60.0 / 96.0).unwrap();
        for (beats_per_bar, start) in [(3.0, 0.9), (4.0, 0.2)] {
            let mut phrase = with_phase(0, 90, start, 1.6 / beats_per_bar);
            let plain = beat_phrase(phrase.clone(), None).unwrap();
            assert_eq!((plain.beats_per_bar, plain.guessed), (4.0, true));
            let stated = beat_phrase(phrase.clone(), Some(2.0)).unwrap();
            assert_eq!((stated.beats_per_bar, stated.guessed), (2.0, false));
            phrase.audio = phrase.audio.with_beats(Some(&pulse));
            let measured = beat_phrase(phrase, None).unwrap();
            assert_eq!(
                (measured.beats_per_bar, measured.guessed),
                (beats_per_bar, false)
            );
            let beats = measured.beats();
            assert_eq!((beats.len(), beats[0]), (90, 0.0));
            assert!((beats[60] - 3.2).abs() < 1e-4, "{}", beats[60]);
        }
    }

    #[test]
    fn beats_fall_where_the_phase_passes_them() {
        for (beats_per_bar, start) in [(3.0, 0.9), (4.0, 0.0), (4.0, 0.2)] {
            // 96 beats a minute.
            let phrase = with_phase(0, 90, start, 1.6 / beats_per_bar);
            let found = beat_phrase(phrase, Some(beats_per_bar))
                .unwrap()
                .beat_times();
            let first = (f64::ceil(start * beats_per_bar) - start * beats_per_bar) / 1.6;
            assert_eq!(
                found.len(),
                1 + ((89.0 / FPS - first) * 1.6) as usize,
                "{found:?}"
            );
            for (beat, time) in found.iter().enumerate() {
                let expected = first + beat as f64 / 1.6;
                assert!((time - expected).abs() < 1e-4, "{time} {expected}");
            }
        }
    }

    #[test]
    fn tempi_are_divided_by_the_advance_of_the_phase() {
        let waltz = with_phase(0, 60, 0.5, 0.5);
        let of_tempo = |tempo: f64| beats_in_a_bar(&waltz.motion, Some(tempo / 60.0 / FPS));
        assert_eq!(of_tempo(90.0), Some(3.0));
        assert_eq!(of_tempo(93.0), Some(3.0));
        assert_eq!(of_tempo(105.0), None);
        assert_eq!(of_tempo(5.0), None);
        assert_eq!(beats_in_a_bar(&waltz.motion, None), None);
        let still = with_phase(0, 60, 0.5, 0.0);
        assert_eq!(beats_in_a_bar(&still.motion, Some(0.05)), None);
    }

    #[test]
    fn phrases_of_less_than_a_beat_are_none() {
        assert!(beat_phrase(with_phase(0, 60, 0.0, 0.0), None).is_none());
        // 23 steps of 1 / 100 bars are 0.92 beats.
        assert!(beat_phrase(with_phase(0, 24, 0.9, 0.3), None).is_none());
        let enough = beat_phrase(with_phase(0, 30, 0.9, 0.3), None).unwrap();
        assert_eq!(enough.song, "synthetic_00000");
        let one = synthetic::phrase_in(AudioLayout::WITH_BEATS, 0, 1, 1);
        assert!(beat_phrase(one, None).is_none());
    }
}
