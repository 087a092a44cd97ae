//! Means over phrases, with intervals over songs.

use std::collections::BTreeMap;

use kinegrad_motion::metrics::Estimate;
use kinegrad_train::evaluation::{Metrics, Number};
use serde_json::{Value, json};

use super::audio_variant::AudioVariant;
use super::scores::{MeasuredCondition, MeasuredPhrase, Score};

/// A metric: name in files (a dot separates two levels), title in tables, and value.
type Metric<T> = (&'static str, &'static str, fn(&T) -> Option<f64>);

/// Distances between the phases of the samples and of the phrases' own music.
pub(super) const PHASE_ERRORS: [Metric<Score>; 2] = [
    ("beat_phase_error", "beat-phase error, beats", |s| {
        Some(s.beat_phase_error)
    }),
    ("bar_phase_error", "bar-phase error, bars", |s| {
        Some(s.bar_phase_error)
    }),
];

/// Distances from the phases of conditioning music with beats.
const CONDITION_PHASE_ERRORS: [Metric<Score>; 2] = [
    (
        "condition_beat_phase_error",
        "beat-phase error to the conditioning music, beats",
        |s| s.condition_beat_phase_error,
    ),
    (
        "condition_bar_phase_error",
        "bar-phase error to the conditioning music, bars",
        |s| s.condition_bar_phase_error,
    ),
];

/// Alignments of moments of the motions with the beats of the phrases' own music. Each has the
/// score, the score of the moments moved by random offsets, and the difference per motion.
pub(super) const ALIGNMENTS: [Metric<Score>; 6] = [
    ("beat_alignment.score", "beat alignment", |s| {
        s.beat_alignment
    }),
    ("beat_alignment.chance", "beat alignment by chance", |s| {
        s.chance_alignment
    }),
    (
        "beat_alignment.above_chance",
        "beat alignment above chance",
        |s| Some(s.beat_alignment? - s.chance_alignment?),
    ),
    (
        "peak_alignment.score",
        "beat alignment of speed peaks",
        |s| s.peak_alignment,
    ),
    (
        "peak_alignment.chance",
        "beat alignment of speed peaks by chance",
        |s| s.chance_peak_alignment,
    ),
    (
        "peak_alignment.above_chance",
        "beat alignment of speed peaks above chance",
        |s| Some(s.peak_alignment? - s.chance_peak_alignment?),
    ),
];

/// Metrics for comparing each phrase's values with own music and with other audio.
const DIFFERENCES: [Metric<MeasuredCondition>; 3] = [
    ("own_minus.loss", "own minus this: loss", |c| Some(c.loss)),
    (
        "own_minus.beat_phase_error",
        "own minus this: beat-phase error",
        |c| Some(c.score.beat_phase_error),
    ),
    (
        "own_minus.bar_phase_error",
        "own minus this: bar-phase error",
        |c| Some(c.score.bar_phase_error),
    ),
];

/// The mean of a metric over phrases, with an interval over songs.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Mean {
    /// Name in files.
    pub name: &'static str,
    /// Title in tables.
    pub title: &'static str,
    /// `None` without values, or with a value that is not finite.
    pub estimate: Option<Estimate>,
}

impl Mean {
    /// The mean of the phrases' values; each value has its song.
    pub fn of<'a>(
        name: &'static str,
        title: &'static str,
        values: impl Iterator<Item = (&'a str, f64)>,
        seed: u64,
    ) -> Self {
        let mut songs: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        for (song, value) in values {
            songs.entry(song).or_default().push(value);
        }
        Self {
            name,
            title,
            estimate: Estimate::of(&songs.into_values().collect::<Vec<_>>(), seed),
        }
    }

    /// The means of scores, each with its phrase's song.
    pub fn of_scores(metrics: &[Metric<Score>], scores: &[(&str, &Score)], seed: u64) -> Vec<Self> {
        let means = metrics.iter().map(|&(name, title, value)| {
            let values = scores.iter();
            let values = values.filter_map(|(song, score)| Some((*song, value(score)?)));
            Self::of(name, title, values, seed)
        });
        means.collect()
    }
}

/// The means by name, in two levels.
pub(super) fn to_json(means: &[Mean]) -> Value {
    let mut json = json!({});
    for mean in means {
        match mean.name.split_once('.') {
            Some((outer, inner)) => json[outer][inner] = json!(mean.estimate),
            None => json[mean.name] = json!(mean.estimate),
        }
    }
    json
}

impl Metrics for Mean {
    /// The mean with its interval for tables; the mean and the interval's ends for files.
    fn rows(&self) -> Vec<Number> {
        let (name, estimate) = (self.name, self.estimate);
        let shown = estimate
            .map(|Estimate { mean, low, high }| format!("{mean:.4} ({low:.4} to {high:.4})"));
        let value = estimate.map(|estimate| estimate.mean);
        vec![
            Number::shown(format!("{name}.mean"), value, self.title, shown),
            Number::in_files(format!("{name}.low"), estimate.map(|each| each.low)),
            Number::in_files(format!("{name}.high"), estimate.map(|each| each.high)),
        ]
    }
}

/// The means for every audio variant of any phrase.
pub(super) fn means_by_variant(
    measured: &[MeasuredPhrase],
    seed: u64,
) -> Vec<(AudioVariant, Vec<Mean>)> {
    let means = |variant: AudioVariant| {
        let values = measured.iter().filter_map(|phrase| {
            let own = phrase.with(AudioVariant::Own)?;
            Some((phrase.song.as_str(), own, phrase.with(variant)?))
        });
        let values: Vec<_> = values.collect();
        let scores = values.iter().map(|(song, _, this)| (*song, &this.score));
        let scores: Vec<(&str, &Score)> = scores.collect();
        let losses = values.iter().map(|(song, _, this)| (*song, this.loss));
        let mut means = vec![Mean::of("loss", "loss at high noise", losses, seed)];
        means.extend(Mean::of_scores(&PHASE_ERRORS, &scores, seed));
        means.extend(Mean::of_scores(&CONDITION_PHASE_ERRORS, &scores, seed));
        if variant != AudioVariant::Own {
            means.extend(DIFFERENCES.iter().map(|&(name, title, value)| {
                let values = values.iter();
                let differences = values
                    .filter_map(|(song, own, this)| Some((*song, value(own)? - value(this)?)));
                Mean::of(name, title, differences, seed)
            }));
        }
        means.extend(Mean::of_scores(&ALIGNMENTS, &scores, seed));
        (!values.is_empty()).then_some((variant, means))
    };
    AudioVariant::ALL.into_iter().filter_map(means).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimate(means: &[Mean], name: &str) -> Option<Estimate> {
        let found = means.iter().find(|mean| mean.name == name);
        found.expect(name).estimate
    }

    fn value(audio: AudioVariant, loss: f64, error: f64) -> MeasuredCondition {
        MeasuredCondition {
            audio,
            loss,
            score: Score {
                beat_phase_error: error,
                bar_phase_error: error / 4.0,
                condition_beat_phase_error: (audio == AudioVariant::HalfBeat).then_some(0.01),
                condition_bar_phase_error: None,
                beat_alignment: (audio == AudioVariant::Own).then_some(0.5),
                chance_alignment: (audio == AudioVariant::Own).then_some(0.2),
                peak_alignment: (audio == AudioVariant::Own).then_some(0.7),
                chance_peak_alignment: (audio == AudioVariant::Own).then_some(0.3),
            },
        }
    }

    #[test]
    fn differences_are_of_each_phrase_and_means_over_all() {
        // Three phrases of one song and one phrase of another. Losses differ more between phrases
        // than between conditions.
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
                    value(AudioVariant::Own, loss, 0.05),
                    value(AudioVariant::Silence, loss + 0.5, 0.25),
                    value(AudioVariant::HalfBeat, loss + 0.25, 0.45),
                ],
            })
            .collect();
        let found = means_by_variant(&measured, 0);
        let variants: Vec<AudioVariant> = found.iter().map(|(variant, _)| *variant).collect();
        assert_eq!(
            variants,
            [
                AudioVariant::Own,
                AudioVariant::Silence,
                AudioVariant::HalfBeat
            ]
        );
        let [(_, own), (_, silence), (_, half)] = &found[..] else {
            panic!("{found:?}")
        };
        assert_eq!(estimate(own, "loss").unwrap().mean, 13.75);
        assert!(own.iter().all(|mean| !mean.name.starts_with("own_minus")));
        let peaks = estimate(own, "peak_alignment.above_chance").unwrap();
        assert!((peaks.mean - 0.4).abs() < 1e-12, "{peaks:?}");
        let apart = estimate(own, "beat_alignment.above_chance").unwrap();
        assert!((apart.mean - 0.3).abs() < 1e-12 && apart.low > 0.29);
        assert_eq!(estimate(silence, "beat_alignment.score"), None);
        let loss = estimate(silence, "loss").unwrap();
        assert!(loss.high - loss.low > 10.0);
        let loss = estimate(silence, "own_minus.loss").unwrap();
        assert_eq!((loss.mean, loss.low, loss.high), (-0.5, -0.5, -0.5));
        let mean = |means: &[Mean], name| estimate(means, name).unwrap().mean;
        assert!((mean(silence, "own_minus.beat_phase_error") + 0.2).abs() < 1e-12);
        assert!((mean(half, "beat_phase_error") - 0.45).abs() < 1e-12);
        assert!((mean(half, "condition_beat_phase_error") - 0.01).abs() < 1e-12);
        assert_eq!(estimate(silence, "condition_beat_phase_error"), None);
        assert_eq!(means_by_variant(&measured, 0), found, "the same twice");
        let json = to_json(half);
        assert_eq!(json["own_minus"]["loss"]["mean"], -0.25);
        assert!(json["beat_alignment"]["score"].is_null());
    }

    #[test]
    fn a_sample_that_is_not_finite_leaves_no_mean() {
        let broken = MeasuredPhrase {
            id: "a_0".to_owned(),
            song: "a".to_owned(),
            beats_per_bar: 4.0,
            tracked_beat_error: None,
            conditions: vec![value(AudioVariant::Own, 1.0, f64::NAN)],
        };
        let (_, own) = &means_by_variant(&[broken], 0)[0];
        assert_eq!(estimate(own, "beat_phase_error"), None);
        assert_eq!(estimate(own, "loss").unwrap().mean, 1.0);
    }
}
