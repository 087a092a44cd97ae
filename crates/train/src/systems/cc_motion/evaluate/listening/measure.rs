//! What is measured of each phrase and condition, and the means of it.

use std::collections::BTreeMap;

use kinegrad_audio::beats::track;
use kinegrad_motion::metrics::{
    Estimate, beat_alignment, chance_alignment, kinematic_beats, phase_error,
};
use kinegrad_motion::{FPS, Motion};
use kinegrad_random::{Key, Purpose};
use serde::Serialize;

use super::Heard;
use super::phrases::{Listened, bars};
use crate::systems::cc_motion::evaluate::Measures;

/// How the samples of a phrase with one condition fall in with the music: means over the samples.
/// Phases are compared in cycles, 0 to 0.5; NaN where a sample's is not finite.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Score {
    /// Distance of the beat phase from that of the phrase's own music, beats.
    pub beat_phase_error: f64,
    /// The same of the bar phase, bars.
    pub bar_phase_error: f64,
    /// Distance of the beat phase from that of the music that was heard, beats.
    pub heard_beat_phase_error: Option<f64>,
    /// The same of the bar phase, bars.
    pub heard_bar_phase_error: Option<f64>,
    /// Beat alignment with the phrase's own music; mean over the samples that have beats.
    pub beat_alignment: Option<f64>,
    /// The same of their beats moved by random offsets.
    pub chance_alignment: Option<f64>,
}

/// A phrase to dance to.
pub(super) struct Dancing<'a> {
    to: &'a Listened,
    /// Beats of its music, seconds.
    music: Vec<f64>,
}

impl<'a> Dancing<'a> {
    pub fn to(listened: &'a Listened) -> Self {
        Self {
            to: listened,
            music: track(listened.phrase.audio.onset_strength()).times(),
        }
    }

    /// The score of samples, at least one, that heard music of these bar phases and beats in a bar,
    /// if it had beats.
    pub fn score(&self, samples: &[Motion], heard: Option<&(Vec<f64>, f64)>, seed: u64) -> Score {
        let mean = |of: &dyn Fn(&Motion) -> f64| {
            samples.iter().map(of).sum::<f64>() / samples.len() as f64
        };
        let error = |expected: &[f64], cycles: f64| {
            mean(&|motion| phase_error(&bars(motion), expected, cycles))
        };
        let seconds = self.to.phrase.frames() as f64 / FPS;
        let key = Key::new(seed, Purpose::BeatOffset).named(&self.to.phrase.id);
        let aligned: Vec<(f64, f64)> = samples
            .iter()
            .filter_map(|motion| {
                let beats = kinematic_beats(motion);
                let score = beat_alignment(&beats, &self.music)?;
                Some((score, chance_alignment(&beats, &self.music, seconds, key)?))
            })
            .collect();
        let aligned_mean = |of: fn(&(f64, f64)) -> f64| {
            let sum = aligned.iter().map(of).sum::<f64>();
            (!aligned.is_empty()).then(|| sum / aligned.len() as f64)
        };
        Score {
            beat_phase_error: error(&self.to.bars, self.to.beats_per_bar),
            bar_phase_error: error(&self.to.bars, 1.0),
            heard_beat_phase_error: heard.map(|(bars, beats)| error(bars, *beats)),
            heard_bar_phase_error: heard.map(|(bars, _)| error(bars, 1.0)),
            beat_alignment: aligned_mean(|(score, _)| *score),
            chance_alignment: aligned_mean(|(_, chance)| *chance),
        }
    }
}

/// What was measured of a phrase.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeasuredPhrase {
    /// Its id.
    pub id: String,
    /// Its song.
    pub song: String,
    /// Beats in a bar of it.
    pub beats_per_bar: f64,
    /// The values by what was heard.
    pub conditions: Vec<MeasuredCondition>,
}

/// What was measured of a phrase with something heard.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeasuredCondition {
    /// What was heard.
    pub heard: Heard,
    /// The loss at high noise.
    pub loss: f64,
    /// The samples' score.
    #[serde(flatten)]
    pub score: Score,
}

impl MeasuredPhrase {
    /// A phrase with nothing measured yet.
    pub(super) fn new(listened: &Listened) -> Self {
        Self {
            id: listened.phrase.id.clone(),
            song: listened.song.clone(),
            beats_per_bar: listened.beats_per_bar,
            conditions: Vec::new(),
        }
    }

    fn with(&self, heard: Heard) -> Option<&MeasuredCondition> {
        self.conditions.iter().find(|each| each.heard == heard)
    }
}

/// Beat alignment with the phrases' own music, and by chance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Alignment {
    /// The score; `None` where no motion has beats.
    pub score: Option<Estimate>,
    /// The score of the same beats moved by random offsets.
    pub chance: Option<Estimate>,
    /// By how much the score is above that of chance, motion by motion.
    pub above_chance: Option<Estimate>,
}

impl Alignment {
    /// The alignment of scores with the songs of their phrases.
    pub(super) fn of<'a>(
        scores: impl Iterator<Item = (&'a str, &'a Score)> + Clone,
        seed: u64,
    ) -> Self {
        let estimate_of = |of: fn(&Score) -> Option<f64>| {
            let values = scores.clone();
            estimate(
                values.filter_map(|(song, score)| Some((song, of(score)?))),
                seed,
            )
        };
        Self {
            score: estimate_of(|score| score.beat_alignment),
            chance: estimate_of(|score| score.chance_alignment),
            above_chance: estimate_of(|score| {
                Some(score.beat_alignment? - score.chance_alignment?)
            }),
        }
    }
}

/// The means of what was measured with something heard, with intervals over songs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Condition {
    /// What was heard.
    pub heard: Heard,
    /// The loss at high noise.
    pub loss: Option<Estimate>,
    /// Distance of the samples' beat phase from that of the phrase's own music, beats.
    pub beat_phase_error: Option<Estimate>,
    /// The same of the bar phase, bars.
    pub bar_phase_error: Option<Estimate>,
    /// Distance of the beat phase from that of the music that was heard, where that has beats.
    pub heard_beat_phase_error: Option<Estimate>,
    /// The same of the bar phase.
    pub heard_bar_phase_error: Option<Estimate>,
    /// Beat alignment of the samples.
    pub beat_alignment: Alignment,
    /// What was measured with the own music less this, phrase by phrase; `None` of the own music.
    pub own_minus: Option<Differences>,
}

/// Means of paired differences, with intervals over songs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Differences {
    /// Of the loss.
    pub loss: Option<Estimate>,
    /// Of the beat-phase error.
    pub beat_phase_error: Option<Estimate>,
    /// Of the bar-phase error.
    pub bar_phase_error: Option<Estimate>,
}

/// The means over phrases of every condition that any of them has.
pub(super) fn conditions_of(measured: &[MeasuredPhrase], seed: u64) -> Vec<Condition> {
    let condition = |heard: Heard| {
        // With the own music beside it.
        let pairs = measured.iter().filter_map(|phrase| {
            let own = phrase.with(Heard::Own)?;
            Some((phrase.song.as_str(), own, phrase.with(heard)?))
        });
        pairs.clone().next()?;
        let mean = |of: fn(&MeasuredCondition) -> Option<f64>| {
            let values = pairs.clone();
            estimate(
                values.filter_map(|(song, _, this)| Some((song, of(this)?))),
                seed,
            )
        };
        let difference = |of: fn(&MeasuredCondition) -> f64| {
            let values = pairs.clone();
            estimate(
                values.map(|(song, own, this)| (song, of(own) - of(this))),
                seed,
            )
        };
        let scores = pairs.clone().map(|(song, _, this)| (song, &this.score));
        Some(Condition {
            heard,
            loss: mean(|each| Some(each.loss)),
            beat_phase_error: mean(|each| Some(each.score.beat_phase_error)),
            bar_phase_error: mean(|each| Some(each.score.bar_phase_error)),
            heard_beat_phase_error: mean(|each| each.score.heard_beat_phase_error),
            heard_bar_phase_error: mean(|each| each.score.heard_bar_phase_error),
            beat_alignment: Alignment::of(scores, seed),
            own_minus: (heard != Heard::Own).then(|| Differences {
                loss: difference(|each| each.loss),
                beat_phase_error: difference(|each| each.score.beat_phase_error),
                bar_phase_error: difference(|each| each.score.bar_phase_error),
            }),
        })
    };
    Heard::ALL.into_iter().filter_map(condition).collect()
}

/// Samples with the own music at one guidance scale.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AtScale {
    /// The scale.
    pub guidance_scale: f64,
    /// Distance of the beat phase from that of the music, beats.
    pub beat_phase_error: Option<Estimate>,
    /// The same of the bar phase, bars.
    pub bar_phase_error: Option<Estimate>,
    /// What every evaluation measures, of the post-processed samples.
    pub measures: Measures,
}

impl AtScale {
    /// Means of scores with the songs of their phrases, and the measures of the same samples.
    pub(super) fn new<'a>(
        guidance_scale: f64,
        scores: impl Iterator<Item = (&'a str, &'a Score)> + Clone,
        measures: Measures,
        seed: u64,
    ) -> Self {
        let mean = |of: fn(&Score) -> f64| {
            estimate(scores.clone().map(|(song, score)| (song, of(score))), seed)
        };
        Self {
            guidance_scale,
            beat_phase_error: mean(|score| score.beat_phase_error),
            bar_phase_error: mean(|score| score.bar_phase_error),
            measures,
        }
    }
}

/// The mean of values of phrases, each with its song.
fn estimate<'a>(values: impl Iterator<Item = (&'a str, f64)>, seed: u64) -> Option<Estimate> {
    let mut songs: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for (song, value) in values {
        songs.entry(song).or_default().push(value);
    }
    Estimate::of(&songs.into_values().collect::<Vec<_>>(), seed)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use kinegrad_data::{Phrase, Songs, synthetic};
    use kinegrad_motion::phrase::PHASE;

    use super::*;

    /// A phrase of so many frames that begins late in a bar of `rate` bars a second.
    fn listened(id: &str, frames: usize, rate: f64, beats_per_bar: u32) -> Listened {
        let mut phrase = Phrase {
            id: id.to_owned(),
            ..synthetic::phrase(frames, frames, 1)
        };
        phrase.motion = moved(&phrase.motion, |t| 0.9 + rate * t as f64 / FPS);
        Listened::new(
            Arc::new(phrase),
            &Songs::default(),
            Some(f64::from(beats_per_bar)),
        )
        .expect("beats")
    }

    /// The motion with another phase.
    fn moved(motion: &Motion, phase: impl Fn(usize) -> f64) -> Motion {
        let mut motion = motion.clone();
        for t in 0..motion.frames() {
            motion.frame_mut(t)[PHASE] = phase(t).rem_euclid(1.0) as f32;
        }
        motion
    }

    #[test]
    fn dancers_are_scored_by_their_phase_against_the_music() {
        for (beats_per_bar, frames) in [(3, 97), (4, 120), (4, 61)] {
            let listened = listened("a_0", frames, 0.53, beats_per_bar);
            let dancing = Dancing::to(&listened);
            let beats = f64::from(beats_per_bar);
            let shifted = |beats_late: f64| {
                let music = listened.bars.clone();
                moved(&listened.phrase.motion, move |t| {
                    music[t] + beats_late / beats
                })
            };
            let score = |motion: Motion| dancing.score(&[motion], None, 0);
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
            // Another tempo, out of step again and again.
            let other = score(moved(&listened.phrase.motion, |t| 3.1 * t as f64 / FPS));
            assert!((other.beat_phase_error - 0.25).abs() < 0.04, "{other:?}");
            // Two samples: the mean.
            let both = dancing.score(&[shifted(0.0), shifted(0.5)], None, 0);
            assert!((both.beat_phase_error - 0.25).abs() < 1e-5, "{both:?}");
            // Who follows music half a beat ahead is right by what was heard.
            let ahead: Vec<f64> = listened.bars.iter().map(|bar| bar + 0.5 / beats).collect();
            let heard = dancing.score(&[shifted(0.5)], Some(&(ahead, beats)), 0);
            assert!(heard.heard_beat_phase_error.unwrap() < 1e-5, "{heard:?}");
            assert!((heard.beat_phase_error - 0.5).abs() < 1e-5);
            let mut broken = shifted(0.0);
            broken.frame_mut(3)[PHASE] = f32::NAN;
            assert!(score(broken).beat_phase_error.is_nan());
        }
    }

    fn value(heard: Heard, loss: f64, error: f64) -> MeasuredCondition {
        MeasuredCondition {
            heard,
            loss,
            score: Score {
                beat_phase_error: error,
                bar_phase_error: error / 4.0,
                heard_beat_phase_error: (heard == Heard::HalfBeat).then_some(0.01),
                heard_bar_phase_error: None,
                beat_alignment: (heard == Heard::Own).then_some(0.5),
                chance_alignment: (heard == Heard::Own).then_some(0.2),
            },
        }
    }

    #[test]
    fn differences_are_of_each_phrase_and_means_over_all() {
        // Three phrases of one song and one of another, with losses that differ more between
        // phrases than between conditions.
        let songs = ["a", "a", "a", "b"];
        let measured: Vec<MeasuredPhrase> = songs
            .iter()
            .zip([1.0, 5.0, 9.0, 40.0])
            .map(|(song, loss)| MeasuredPhrase {
                id: format!("{song}_{loss}"),
                song: (*song).to_owned(),
                beats_per_bar: 4.0,
                conditions: vec![
                    value(Heard::Own, loss, 0.05),
                    value(Heard::Silence, loss + 0.5, 0.25),
                    value(Heard::HalfBeat, loss + 0.25, 0.45),
                ],
            })
            .collect();
        let found = conditions_of(&measured, 0);
        let heard: Vec<Heard> = found.iter().map(|each| each.heard).collect();
        assert_eq!(heard, [Heard::Own, Heard::Silence, Heard::HalfBeat]);
        let [own, silence, half] = &found[..] else {
            panic!("{found:?}")
        };
        assert_eq!(own.loss.unwrap().mean, 13.75);
        assert_eq!(own.own_minus, None);
        let apart = own.beat_alignment.above_chance.unwrap();
        assert!((apart.mean - 0.3).abs() < 1e-12 && apart.low > 0.29);
        assert_eq!(silence.beat_alignment.score, None);
        assert!(silence.loss.unwrap().high - silence.loss.unwrap().low > 10.0);
        let paired = silence.own_minus.as_ref().unwrap();
        let loss = paired.loss.unwrap();
        assert_eq!((loss.mean, loss.low, loss.high), (-0.5, -0.5, -0.5));
        assert!((paired.beat_phase_error.unwrap().mean + 0.2).abs() < 1e-12);
        assert!((half.beat_phase_error.unwrap().mean - 0.45).abs() < 1e-12);
        assert!((half.heard_beat_phase_error.unwrap().mean - 0.01).abs() < 1e-12);
        assert_eq!(silence.heard_beat_phase_error, None);
        assert_eq!(conditions_of(&measured, 0), found, "the same twice");
    }

    #[test]
    fn a_sample_that_is_not_finite_leaves_no_mean() {
        let broken = MeasuredPhrase {
            id: "a_0".to_owned(),
            song: "a".to_owned(),
            beats_per_bar: 4.0,
            conditions: vec![value(Heard::Own, 1.0, f64::NAN)],
        };
        let found = conditions_of(&[broken], 0);
        assert_eq!(found[0].beat_phase_error, None);
        assert_eq!(found[0].loss.unwrap().mean, 1.0);
    }
}
