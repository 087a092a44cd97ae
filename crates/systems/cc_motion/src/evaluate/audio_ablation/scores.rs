//! Scores of the samples of a phrase against the beats of its music.

use kinegrad_data::{BeatPhrase, bars};
use kinegrad_motion::metrics::{
    beat_alignment, chance_alignment, kinematic_beats, phase_error, speed_peaks,
};
use kinegrad_motion::{FPS, Phrase};
use kinegrad_random::{Key, Purpose};
use serde::{Deserialize, Serialize};

use super::audio_variant::AudioVariant;

/// Means over the samples of a phrase and one audio variant. Distances of phases are in cycles, 0
/// to 0.5; NaN if a sample's phase is not finite.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Score {
    /// Distance between the beat phases of sample and own music, beats.
    pub beat_phase_error: f64,
    /// The same of the bar phase, bars.
    pub bar_phase_error: f64,
    /// Distance between the beat phases of sample and conditioning music, beats.
    pub condition_beat_phase_error: Option<f64>,
    /// The same of the bar phase, bars.
    pub condition_bar_phase_error: Option<f64>,
    /// Alignment of the root's speed minima with the own music's beats; mean over samples with
    /// minima.
    pub beat_alignment: Option<f64>,
    /// Alignment of the minima moved by random offsets.
    pub chance_alignment: Option<f64>,
    /// Alignment of the speed maxima.
    pub peak_alignment: Option<f64>,
    /// Alignment of the maxima moved by random offsets.
    pub chance_peak_alignment: Option<f64>,
}

/// The score of at least one sample; `condition` has the bar phases and the beats in a bar of
/// conditioning music with beats.
pub fn score(
    phrase: &BeatPhrase,
    samples: &[Phrase],
    condition: Option<&(Vec<f64>, f64)>,
    seed: u64,
) -> Score {
    let music = phrase.beat_times();
    let mean =
        |of: &dyn Fn(&Phrase) -> f64| samples.iter().map(of).sum::<f64>() / samples.len() as f64;
    let error = |expected: &[f64], cycles: f64| {
        mean(&|motion| phase_error(&bars(motion), expected, cycles))
    };
    let seconds = phrase.phrase.frames() as f64 / FPS;
    let key = Key::new(seed, Purpose::BeatOffset).named(&phrase.phrase.id);
    let aligned = |moments: fn(&Phrase) -> Vec<f64>| {
        let both = samples.iter().map(moments).filter_map(|moments| {
            let score = beat_alignment(&moments, &music)?;
            Some((score, chance_alignment(&moments, &music, seconds, key)?))
        });
        let (scores, chances): (Vec<f64>, Vec<f64>) = both.unzip();
        [scores, chances].map(|values| {
            let sum = values.iter().sum::<f64>();
            (!values.is_empty()).then(|| sum / values.len() as f64)
        })
    };
    let [beat_alignment, chance_alignment] = aligned(kinematic_beats);
    let [peak_alignment, chance_peak_alignment] = aligned(speed_peaks);
    Score {
        beat_phase_error: error(&phrase.bars, phrase.beats_per_bar),
        bar_phase_error: error(&phrase.bars, 1.0),
        condition_beat_phase_error: condition.map(|(bars, beats)| error(bars, *beats)),
        condition_bar_phase_error: condition.map(|(bars, _)| error(bars, 1.0)),
        beat_alignment,
        chance_alignment,
        peak_alignment,
        chance_peak_alignment,
    }
}

/// The values of a phrase.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct MeasuredPhrase {
    /// Its id.
    pub id: String,
    /// Its song.
    pub song: String,
    /// Beats in a bar.
    pub beats_per_bar: f64,
    /// Error of the tracked beat phase, beats; `None` without a tracker.
    pub tracked_beat_error: Option<f64>,
    /// The values for each audio variant.
    pub conditions: Vec<MeasuredCondition>,
}

/// The values of a phrase and an audio variant.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct MeasuredCondition {
    /// The audio.
    pub audio: AudioVariant,
    /// The loss at high noise.
    pub loss: f64,
    /// The samples' score.
    #[serde(flatten)]
    pub score: Score,
}

impl MeasuredPhrase {
    /// The values for a variant.
    pub(super) fn with(&self, variant: AudioVariant) -> Option<&MeasuredCondition> {
        self.conditions.iter().find(|each| each.audio == variant)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use kinegrad_data::{PhraseItem, Songs, synthetic};
    use kinegrad_motion::phrase::PHASE;

    use super::*;

    /// A phrase of `frames` frames that begins late in a bar, with `rate` bars per second.
    fn phrase_of(id: &str, frames: usize, rate: f64, beats_per_bar: u32) -> BeatPhrase {
        let mut phrase = PhraseItem {
            id: id.to_owned(),
            ..synthetic::phrase(frames, frames, 1)
        };
        phrase.motion = moved(&phrase.motion, |t| 0.9 + rate * t as f64 / FPS);
        BeatPhrase::new(
            Arc::new(phrase),
            &Songs::default(),
            Some(f64::from(beats_per_bar)),
        )
        .expect("beats")
    }

    /// The motion with another phase.
    fn moved(motion: &Phrase, phase: impl Fn(usize) -> f64) -> Phrase {
        let mut motion = motion.clone();
        for t in 0..motion.frames() {
            motion.frame_mut(t)[PHASE] = phase(t).rem_euclid(1.0) as f32;
        }
        motion
    }

    #[test]
    fn samples_are_scored_by_their_phase_against_the_music() {
        for (beats_per_bar, frames) in [(3, 97), (4, 120), (4, 61)] {
            let phrase = phrase_of("a_0", frames, 0.53, beats_per_bar);
            let beats = f64::from(beats_per_bar);
            let shifted = |beats_late: f64| {
                let music = phrase.bars.clone();
                moved(&phrase.phrase.motion, move |t| {
                    music[t] + beats_late / beats
                })
            };
            let score = |motion: Phrase| super::score(&phrase, &[motion], None, 0);
            assert!(score(shifted(0.0)).beat_phase_error < 1e-6);
            let half = score(shifted(0.5));
            assert!((half.beat_phase_error - 0.5).abs() < 1e-5, "{half:?}");
            assert!(
                (half.bar_phase_error - 0.5 / beats).abs() < 1e-6,
                "{half:?}"
            );
            let whole = score(shifted(1.0));
            assert!(whole.beat_phase_error < 1e-5, "{whole:?}");
            assert!(
                (whole.bar_phase_error - 1.0 / beats).abs() < 1e-6,
                "{whole:?}"
            );
            // Another tempo, which repeatedly drifts out of phase.
            let other = score(moved(&phrase.phrase.motion, |t| 3.1 * t as f64 / FPS));
            assert!((other.beat_phase_error - 0.25).abs() < 0.04, "{other:?}");
            // Two samples: the mean.
            let both = super::score(&phrase, &[shifted(0.0), shifted(0.5)], None, 0);
            assert!((both.beat_phase_error - 0.25).abs() < 1e-5, "{both:?}");
            // A sample half a beat ahead follows music half a beat ahead.
            let ahead: Vec<f64> = phrase.bars.iter().map(|bar| bar + 0.5 / beats).collect();
            let conditioned = super::score(&phrase, &[shifted(0.5)], Some(&(ahead, beats)), 0);
            assert!(
                conditioned.condition_beat_phase_error.unwrap() < 1e-5,
                "{conditioned:?}"
            );
            assert!((conditioned.beat_phase_error - 0.5).abs() < 1e-5);
            let mut broken = shifted(0.0);
            broken.frame_mut(3)[PHASE] = f32::NAN;
            assert!(score(broken).beat_phase_error.is_nan());
        }
    }
}
