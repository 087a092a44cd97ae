//! The metrics of one set of phrases.

use std::sync::Arc;

use kinegrad_audio::beats::track;
use kinegrad_data::{AudioFeatures, BeatAgreement, BeatPhrase, PhraseItem, bars};
use kinegrad_motion::derivatives::mean_jerk_norm;
use kinegrad_motion::metrics::{
    Estimate, FeatureMoments, beat_alignment, diversity, frechet_distance, kinematic_beats, mean,
    phase_error, trajectory_features,
};
use kinegrad_motion::{
    Phrase, Profile, Report, SanityThresholds, Statistics, Value, check, check_thresholds,
    phrase_statistics,
};
use serde::Serialize;

use super::movement::{MovementSpread, movement_spreads};
use super::terms::{LossTerm, loss_terms};

/// The metrics of one set of phrases; `None` (`null` in JSON) for metrics that cannot be computed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Measures {
    /// Mean distance between motions of different phrases in training standard deviations, over all
    /// pairs with the same seed, then over seeds. Needs two phrases.
    pub diversity: Option<f64>,
    /// Mean distance between two samples of one phrase. Needs two seeds.
    pub same_phrase_diversity: Option<f64>,
    /// Fréchet distance to the used held-out phrases. Needs two of each.
    pub frechet_held_out: Option<f64>,
    /// Fréchet distance to the training phrases. Needs two of each.
    pub frechet_training: Option<f64>,
    /// Beat alignment with the phrase's own music for any condition; mean over motions with beats.
    pub beat_alignment: Option<f64>,
    /// Mean distance between the beat phases of the motions and of their phrases, in beats, with its
    /// interval over songs. By chance 0.25.
    pub beat_phase_error: Option<Estimate>,
    /// Mean jerk norm of the acceleration channels, meters per second cubed.
    pub mean_jerk: Option<f64>,
    /// The movement, measured only on positions, quaternions and phase.
    pub movement: Vec<MovementSpread>,
    /// The losses of end-to-end fine-tuning.
    pub losses: Vec<LossTerm>,
    /// CC-MotionGen's checks.
    pub ccmotion: ProfileRates,
    /// The strict checks.
    pub strict: ProfileRates,
}

/// The results of a set of phrases in the checks of a profile.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProfileRates {
    /// Share of phrases that pass all checks, 0 to 1.
    pub pass_rate: f64,
    /// The checks, in the order of the profile.
    pub checks: Vec<CheckRate>,
}

/// The results of a set of phrases in one check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CheckRate {
    /// Name of the check.
    pub name: &'static str,
    /// Share of phrases that pass, 0 to 1.
    pub pass_rate: f64,
    /// Mean of the measured value, in the units of the check; for ranges, the means of both ends.
    pub value: Value,
}

impl ProfileRates {
    /// The rates of reports, at least one.
    fn of(reports: &[Report]) -> Self {
        let all = reports.len() as f64;
        let share = |passed: usize| passed as f64 / all;
        let mut checks: Vec<CheckRate> = Vec::new();
        for named in reports.iter().flat_map(|report| &report.checks) {
            if checks.iter().any(|rate| rate.name == named.name) {
                continue;
            }
            // Reports of `ccmotion` contain the check `finite` only if the check fails; else the
            // value is 0.
            let lines = || reports.iter().filter_map(|report| report.check(named.name));
            let failed = lines().filter(|check| !check.passed).count();
            checks.push(CheckRate {
                name: named.name,
                pass_rate: share(reports.len() - failed),
                value: mean_value(lines().map(|check| check.value), all),
            });
        }
        Self {
            pass_rate: share(reports.iter().filter(|report| report.passed).count()),
            checks,
        }
    }

    /// The check with this name.
    pub fn check(&self, name: &str) -> Option<&CheckRate> {
        self.checks.iter().find(|check| check.name == name)
    }
}

fn mean_value(values: impl Iterator<Item = Value>, count: f64) -> Value {
    let sum = values.reduce(|sum, value| match (sum, value) {
        (Value::Number(sum), Value::Number(value)) => Value::Number(sum + value),
        (Value::Range(sum), Value::Range(value)) => {
            Value::Range([sum[0] + value[0], sum[1] + value[1]])
        }
        _ => unreachable!("a check measures the same kind of value in every phrase"),
    });
    match sum.expect("a check of this name") {
        Value::Number(sum) => Value::Number(sum / count),
        Value::Range([low, high]) => Value::Range([low / count, high / count]),
    }
}

/// The beats of one condition, with which the phases of its samples are compared.
pub(super) enum Beats {
    /// Those of the phase channel of a phrase.
    Phrase(BeatPhrase),
    /// Those tracked in a song.
    Tracked {
        /// The song.
        song: String,
        /// Beats in a bar of the samples.
        beats_per_bar: f64,
        /// Number of beats up to each frame.
        positions: Vec<f64>,
    },
}

impl Beats {
    fn song(&self) -> &str {
        match self {
            Self::Phrase(phrase) => &phrase.song,
            Self::Tracked { song, .. } => song,
        }
    }

    /// Mean distance of the beat phases of `motion`, in beats.
    fn error(&self, motion: &Phrase) -> f64 {
        match self {
            Self::Phrase(phrase) => phrase.phase_error(motion),
            Self::Tracked {
                beats_per_bar,
                positions,
                ..
            } => {
                let beats: Vec<f64> = bars(motion).iter().map(|bar| bar * beats_per_bar).collect();
                phase_error(&beats, positions, 1.0)
            }
        }
    }
}

/// The real motion and music that samples are compared with.
pub(super) struct Reference<'a> {
    statistics: Statistics,
    thresholds: SanityThresholds,
    /// The held-out phrases; `None` for songs without motion.
    phrases: Option<&'a [Arc<PhraseItem>]>,
    held_out: Option<FeatureMoments>,
    training: Option<FeatureMoments>,
    /// Beats of each held-out phrase's music, seconds.
    music: Vec<Vec<f64>>,
    /// The beats of each condition, if it has beats.
    beats: Vec<Option<Beats>>,
}

impl<'a> Reference<'a> {
    /// The reference of these phrases, in units of the run's `statistics`. Missing movement
    /// measures of the statistics come from the `training` phrases, or from the held-out phrases
    /// without training phrases.
    pub fn new(
        held_out: &'a [Arc<PhraseItem>],
        training: &[Arc<PhraseItem>],
        statistics: &Statistics,
    ) -> Self {
        let moments = |phrases: &[Arc<PhraseItem>]| {
            let motions = phrases.iter().map(|phrase| &phrase.motion);
            feature_moments(motions, statistics)
        };
        let mut with_movement = statistics.clone();
        if statistics.movement.is_empty() {
            let phrases = if training.is_empty() {
                held_out
            } else {
                training
            };
            let measured = phrase_statistics(phrases.iter().map(|phrase| &phrase.motion));
            let movement = measured.map(|measured| measured.movement);
            with_movement.movement = movement.unwrap_or_default();
        }
        Self {
            statistics: with_movement,
            thresholds: SanityThresholds::default(),
            phrases: Some(held_out),
            held_out: moments(held_out),
            training: moments(training),
            music: music(held_out.iter().map(|phrase| &phrase.audio)),
            beats: held_out.iter().map(|_| None).collect(),
        }
    }

    /// The reference of music without motion: no distance to real motion can be computed.
    pub fn of_music<'m>(
        music: impl Iterator<Item = &'m AudioFeatures>,
        beats: Vec<Option<Beats>>,
        statistics: &Statistics,
    ) -> Self {
        Self {
            statistics: statistics.clone(),
            thresholds: SanityThresholds::default(),
            phrases: None,
            held_out: None,
            training: None,
            music: self::music(music),
            beats,
        }
    }

    /// With bounds of the profile `ccmotion`.
    pub fn with_thresholds(mut self, thresholds: SanityThresholds) -> Self {
        self.thresholds = thresholds;
        self
    }

    /// With the phases of the held-out phrases; `None` for a phrase without beats.
    pub fn with_phases(mut self, phases: Vec<Option<BeatPhrase>>) -> Self {
        let beats = phases.into_iter();
        self.beats = beats.map(|phrase| phrase.map(Beats::Phrase)).collect();
        self
    }

    /// The metrics of at least one motion per condition. `motions` has one list per condition,
    /// in order, all of equal length; at least one condition is needed.
    pub fn measure(&self, motions: &[Vec<Phrase>]) -> Measures {
        let all = || motions.iter().flatten();
        let rates = |report: &dyn Fn(&Phrase) -> Report| {
            ProfileRates::of(&all().map(report).collect::<Vec<_>>())
        };
        let strict = |motion: &Phrase| check(motion, Profile::Strict, Some(&self.statistics));
        let seeds = motions.first().map_or(0, Vec::len);
        let diversity = |samples: Vec<&Phrase>| diversity(&samples, &self.statistics);
        let by_seed = (0..seeds).map(|seed| {
            let samples = motions.iter().map(|samples| &samples[seed]);
            diversity(samples.collect())
        });
        let by_phrase = motions
            .iter()
            .map(|samples| diversity(samples.iter().collect()));
        let alignment = motions
            .iter()
            .zip(&self.music)
            .flat_map(|(samples, music)| {
                let aligned = move |motion| beat_alignment(&kinematic_beats(motion), music);
                samples.iter().filter_map(aligned).map(Some)
            });
        let beats = motions.iter().zip(&self.beats);
        let phase_errors = beats.filter_map(|(samples, beats)| {
            let beats = beats.as_ref()?;
            let error = |motion| Some(beats.error(motion));
            Some((beats.song().to_owned(), mean(samples.iter().map(error))?))
        });
        let agreement = BeatAgreement::of(phase_errors);
        let moments = feature_moments(all(), &self.statistics);
        let frechet = |reference: &Option<FeatureMoments>| {
            Some(frechet_distance(moments.as_ref()?, reference.as_ref()?))
        };
        Measures {
            diversity: mean(by_seed),
            same_phrase_diversity: mean(by_phrase),
            frechet_held_out: frechet(&self.held_out),
            frechet_training: frechet(&self.training),
            beat_alignment: mean(alignment),
            beat_phase_error: agreement.map(|agreement| agreement.error),
            mean_jerk: mean(all().map(|motion| Some(mean_jerk_norm(motion)))),
            movement: movement_spreads(all()),
            losses: loss_terms(motions, self.phrases),
            ccmotion: rates(&|motion| check_thresholds(motion, &self.thresholds)),
            strict: rates(&strict),
        }
    }
}

/// The beats tracked in each music, seconds.
fn music<'m>(music: impl Iterator<Item = &'m AudioFeatures>) -> Vec<Vec<f64>> {
    let beats = music.map(|audio| track(audio.onset_strength()).times());
    beats.collect()
}

fn feature_moments<'a>(
    motions: impl Iterator<Item = &'a Phrase>,
    statistics: &Statistics,
) -> Option<FeatureMoments> {
    let features = motions.map(|motion| trajectory_features(motion, statistics));
    FeatureMoments::compute(&features.collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use kinegrad_data::synthetic;
    use kinegrad_motion::phrase::{CHANNELS, PHASE, POSITION};

    use super::*;

    fn phrases(range: std::ops::Range<usize>) -> Vec<Arc<PhraseItem>> {
        range
            .map(|index| Arc::new(synthetic::phrase(index, 60, 1)))
            .collect()
    }

    fn motions(phrases: &[Arc<PhraseItem>], seeds: usize) -> Vec<Vec<Phrase>> {
        phrases
            .iter()
            .map(|phrase| vec![phrase.motion.clone(); seeds])
            .collect()
    }

    fn statistics(phrases: &[Arc<PhraseItem>]) -> Statistics {
        kinegrad_motion::phrase_statistics(phrases.iter().map(|phrase| &phrase.motion)).unwrap()
    }

    /// The phrase, moved by `metres` along x in every frame.
    fn moved(phrase: &PhraseItem, metres: f64) -> Phrase {
        let mut motion = phrase.motion.clone();
        for t in 0..motion.frames() {
            let [x, y, z] = motion.vector(t, POSITION);
            motion.set_vector(t, POSITION, [x + metres, y, z]);
        }
        motion
    }

    #[test]
    fn real_phrases_are_no_distance_from_themselves_and_pass() {
        let (held_out, training) = (phrases(0..6), phrases(6..30));
        let statistics = statistics(&training);
        let reference = Reference::new(&held_out, &training, &statistics);
        let real = reference.measure(&motions(&held_out, 1));
        assert!(real.frechet_held_out.unwrap() < 1e-5);
        assert!(real.frechet_training.unwrap() > 0.01);
        assert!(real.diversity.unwrap() > 0.1);
        assert_eq!(real.same_phrase_diversity, None);
        assert!(real.beat_alignment.unwrap() > 0.0);
        assert_eq!((real.ccmotion.pass_rate, real.strict.pass_rate), (1.0, 1.0));
        let jerk = real.strict.check("jerk").unwrap().value;
        assert_eq!(jerk, Value::Number(real.mean_jerk.unwrap()));
    }

    #[test]
    fn movement_missing_in_statistics_is_that_of_the_training_phrases() {
        let (held_out, training) = (phrases(0..3), phrases(3..12));
        let whole = statistics(&training);
        let old = Statistics {
            movement: Default::default(),
            ..whole.clone()
        };
        let of = |statistics| {
            let reference = Reference::new(&held_out, &training, statistics);
            reference.measure(&motions(&held_out, 1))
        };
        assert_eq!(of(&old), of(&whole));
    }

    #[test]
    fn pairs_of_phrases_share_a_seed_and_pairs_of_seeds_a_phrase() {
        let (held_out, training) = (phrases(0..2), phrases(2..10));
        let statistics = statistics(&training);
        let reference = Reference::new(&held_out, &training, &statistics);
        let [a, b] = [0, 1].map(|index| held_out[index].clone());
        // Seed 1 is seed 0 moved by three meters, so phrases have the same distance under both
        // seeds.
        let samples = [&a, &b].map(|phrase| vec![phrase.motion.clone(), moved(phrase, 3.0)]);
        let measures = reference.measure(&samples);
        let apart = diversity(&[&a.motion, &b.motion], &statistics).unwrap();
        assert!((measures.diversity.unwrap() - apart).abs() < 1e-6);
        // One of nine channels differs by the same amount in every frame.
        let expected = 3.0 / statistics.std[0] / 3.0;
        assert!((measures.same_phrase_diversity.unwrap() - expected).abs() < 1e-6);
    }

    #[test]
    fn metrics_that_need_more_phrases_are_missing() {
        let (held_out, training) = (phrases(0..1), phrases(1..9));
        let statistics = statistics(&training);
        let reference = Reference::new(&held_out, &training, &statistics);
        let one = reference.measure(&motions(&held_out, 1));
        let json = serde_json::to_value(&one).unwrap();
        for key in [
            "diversity",
            "same_phrase_diversity",
            "frechet_held_out",
            "frechet_training",
        ] {
            assert!(json[key].is_null(), "{key}: {}", json[key]);
        }
        assert!(json["mean_jerk"].is_number() && json["beat_alignment"].is_number());
        // Two samples of one phrase have a covariance; a single phrase has no covariance.
        let two = reference.measure(&motions(&held_out, 2));
        assert_eq!((two.diversity, two.frechet_held_out), (None, None));
        assert_eq!(two.same_phrase_diversity, Some(0.0));
        assert!(two.frechet_training.is_some());
    }

    #[test]
    fn rates_and_values_are_means_over_all_samples() {
        let (held_out, training) = (phrases(0..2), phrases(2..10));
        let statistics = statistics(&training);
        let reference = Reference::new(&held_out, &training, &statistics);
        let mut samples = motions(&held_out, 2);
        samples[1][0].frame_mut(3)[PHASE] = 3.0;
        samples[0][1].frame_mut(7)[CHANNELS - 1] = f32::NAN;
        let measures = reference.measure(&samples);
        let phase = measures.strict.check("phase").unwrap();
        assert_eq!(phase.pass_rate, 0.75);
        let highest = |motion: &Phrase| {
            let phases = (0..motion.frames()).map(|t| f64::from(motion.frame(t)[PHASE]));
            phases.fold(f64::NEG_INFINITY, f64::max)
        };
        let expected = samples.iter().flatten().map(highest).sum::<f64>() / 4.0;
        let Value::Range([_, high]) = phase.value else {
            panic!("{:?}", phase.value)
        };
        assert!((high - expected).abs() < 1e-12);
        // In the profile `ccmotion`, one of four reports has the line.
        for profile in [&measures.ccmotion, &measures.strict] {
            let finite = profile.check("finite").unwrap();
            assert_eq!(finite.pass_rate, 0.75);
            assert_eq!(finite.value, Value::Number(0.25));
            assert_eq!(profile.pass_rate, 0.5);
        }
    }
}
