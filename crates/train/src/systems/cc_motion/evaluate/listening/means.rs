//! Means over phrases, with intervals over songs.

use std::collections::BTreeMap;

use kinegrad_motion::metrics::Estimate;
use serde::Serialize;

use super::Heard;
use super::measure::{MeasuredCondition, MeasuredPhrase, Score};
use crate::systems::cc_motion::evaluate::Measures;

/// Alignment of moments of the motions with the beats of the phrases' own music, and by chance.
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
    /// The alignment of scores with the songs of their phrases: of what each has of its own, and by
    /// chance.
    fn of<'a>(
        scores: impl Iterator<Item = (&'a str, &'a Score)> + Clone,
        pair: fn(&Score) -> [Option<f64>; 2],
        seed: u64,
    ) -> Self {
        let estimate_of = |of: fn([Option<f64>; 2]) -> Option<f64>| {
            let values = scores.clone();
            estimate(
                values.filter_map(|(song, score)| Some((song, of(pair(score))?))),
                seed,
            )
        };
        Self {
            score: estimate_of(|[score, _]| score),
            chance: estimate_of(|[_, chance]| chance),
            above_chance: estimate_of(|[score, chance]| Some(score? - chance?)),
        }
    }
}

/// How motions fall in with the beats.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Alignments {
    /// The moments at which the root is slowest.
    pub beat_alignment: Alignment,
    /// Those at which it is fastest.
    pub peak_alignment: Alignment,
}

impl Alignments {
    /// Those of scores with the songs of their phrases.
    pub(super) fn of<'a>(
        scores: impl Iterator<Item = (&'a str, &'a Score)> + Clone,
        seed: u64,
    ) -> Self {
        Self {
            beat_alignment: Alignment::of(
                scores.clone(),
                |score| [score.beat_alignment, score.chance_alignment],
                seed,
            ),
            peak_alignment: Alignment::of(
                scores,
                |score| [score.peak_alignment, score.chance_peak_alignment],
                seed,
            ),
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
    /// How the samples fall in with the beats.
    #[serde(flatten)]
    pub alignments: Alignments,
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
            alignments: Alignments::of(scores, seed),
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

/// The mean of what the network's tracker errs by, with an interval over songs.
pub(super) fn tracked(measured: &[MeasuredPhrase], seed: u64) -> Option<Estimate> {
    let values = measured.iter();
    let values = values.filter_map(|each| Some((each.song.as_str(), each.tracked_beat_error?)));
    estimate(values, seed)
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
    use super::*;

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
                peak_alignment: (heard == Heard::Own).then_some(0.7),
                chance_peak_alignment: (heard == Heard::Own).then_some(0.3),
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
                tracked_beat_error: None,
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
        let peaks = own.alignments.peak_alignment.above_chance.unwrap();
        assert!((peaks.mean - 0.4).abs() < 1e-12, "{peaks:?}");
        let apart = own.alignments.beat_alignment.above_chance.unwrap();
        assert!((apart.mean - 0.3).abs() < 1e-12 && apart.low > 0.29);
        assert_eq!(silence.alignments.beat_alignment.score, None);
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
            tracked_beat_error: None,
            conditions: vec![value(Heard::Own, 1.0, f64::NAN)],
        };
        let found = conditions_of(&[broken], 0);
        assert_eq!(found[0].beat_phase_error, None);
        assert_eq!(found[0].loss.unwrap().mean, 1.0);
    }
}
