//! What is in a dataset, and what is wrong with it.

use std::collections::BTreeSet;
use std::sync::Arc;

use kinegrad_motion::{CHANNELS, FPS, Profile, TrainingStatistics, check};
use serde::Serialize;

use crate::features::AUDIO_CHANNELS;
use crate::split::Split;
use crate::summary::{summarise_audio, summarise_motion};
use crate::survey::{OpenProgress, Survey};
use crate::{ChannelSummary, DataConfig, Error, Phrase};

/// The contents of a dataset. Numbers describe the phrases that can be used.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Inspection {
    /// The dataset's address, or `synthetic`.
    pub source: String,
    /// Phrases that can be used.
    pub phrases: usize,
    /// Phrases that cannot be used.
    pub bad_phrases: usize,
    /// Training phrases.
    pub train: usize,
    /// Phrases held out for validation.
    pub validation: usize,
    /// Frames of all phrases together.
    pub frames: usize,
    /// Their length in hours.
    pub hours: f64,
    /// Frames per second.
    pub fps: f64,
    /// Frames of the shortest phrase.
    pub shortest_frames: usize,
    /// Frames of the longest phrase.
    pub longest_frames: usize,
    /// Channels of the motion.
    pub motion_channels: usize,
    /// Channels of the stacked audio features.
    pub audio_channels: usize,
    /// Each channel of the motion, in the dataset's units.
    pub motion: Vec<ChannelSummary>,
    /// Each array of audio features, its rows taken together.
    pub audio: Vec<ChannelSummary>,
    /// What is wrong with single phrases, by id.
    pub problems: Vec<Problem>,
    /// What is odd about the dataset as a whole.
    pub warnings: Vec<String>,
}

/// Something wrong with a phrase.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Problem {
    /// The phrase.
    pub id: String,
    /// What is wrong, in words.
    pub problem: String,
    /// Whether the phrase cannot be used for it.
    pub unusable: bool,
}

/// Looks at every phrase of the dataset that `config` describes, whatever `on_bad_phrase` says.
///
/// A phrase that can be read is held against both profiles of the sanity checks, the strict one
/// with the statistics of the training phrases (of all phrases, where none is left to train on).
///
/// # Errors
/// As [`Dataset::open`](crate::Dataset::open), but never for a single bad phrase.
pub fn inspect(config: &DataConfig, progress: OpenProgress) -> Result<Inspection, Error> {
    config.validate()?;
    let split = Split::new(&config.validation)?;
    let mut survey = Survey::phrases(config)?;
    survey.tolerates_changes = true;
    let outcomes = survey.meet_all(progress, |_, met| (met.entry.side, met.item, met.note))?;
    let listed: Vec<&str> = outcomes.iter().map(|(id, _)| id.as_str()).collect();
    let mut warnings = survey.warnings;
    warnings.extend(split.idle_entries(&listed));
    let mut problems = Vec::new();
    let mut phrases = Vec::new();
    let mut held_out = BTreeSet::new();
    for (id, outcome) in outcomes {
        match outcome {
            Ok((side, phrase, note)) => {
                if split.holds_out(&id, side) {
                    held_out.insert(id.clone());
                }
                problems.extend(note.map(|problem| Problem {
                    id,
                    problem,
                    unusable: false,
                }));
                phrases.push(phrase);
            }
            Err(cause) => {
                problems.push(Problem {
                    id,
                    problem: cause.to_string(),
                    unusable: true,
                });
            }
        }
    }
    let bad_phrases = problems.iter().filter(|problem| problem.unusable).count();
    let train = phrases.len() - held_out.len();
    if train == 0 {
        warnings.push("no phrase is left to train on".to_owned());
    }
    problems.extend(failed_checks(&phrases, |phrase| {
        train == 0 || !held_out.contains(&phrase.id)
    }));
    problems.sort_by(|a, b| a.id.cmp(&b.id));
    let frames: usize = phrases.iter().map(|phrase| phrase.frames()).sum();
    Ok(Inspection {
        source: survey.source,
        phrases: phrases.len(),
        bad_phrases,
        train,
        validation: held_out.len(),
        frames,
        hours: frames as f64 / FPS / 3600.0,
        fps: FPS,
        shortest_frames: phrases
            .iter()
            .map(|phrase| phrase.frames())
            .min()
            .unwrap_or(0),
        longest_frames: phrases
            .iter()
            .map(|phrase| phrase.frames())
            .max()
            .unwrap_or(0),
        motion_channels: CHANNELS,
        audio_channels: AUDIO_CHANNELS,
        motion: summarise_motion(&phrases),
        audio: summarise_audio(&phrases),
        problems,
        warnings,
    })
}

/// Every sanity check that a phrase fails, one line each. `reference` picks the phrases that the
/// strict profile compares with.
fn failed_checks(phrases: &[Arc<Phrase>], reference: impl Fn(&Phrase) -> bool) -> Vec<Problem> {
    let references = phrases
        .iter()
        .filter(|phrase| reference(phrase))
        .map(|phrase| &phrase.motion);
    let Ok(statistics) = TrainingStatistics::compute(references) else {
        return Vec::new();
    };
    let mut problems = Vec::new();
    for phrase in phrases {
        for profile in [Profile::Strict, Profile::Document] {
            let checks = check(&phrase.motion, profile, Some(&statistics))
                .map(|report| report.checks)
                .unwrap_or_default();
            problems.extend(
                checks
                    .into_iter()
                    .filter(|check| !check.passed)
                    .map(|check| Problem {
                        id: phrase.id.clone(),
                        problem: format!(
                            "fails the {profile} check {}: {}, {} allowed",
                            check.name, check.message, check.threshold
                        ),
                        unusable: false,
                    }),
            );
        }
    }
    problems
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{features_path, motion_path};
    use crate::{read_motion, synthetic, write_features, write_motion};
    use kinegrad_motion::phrase::{PHASE, QUATERNION};
    use std::fs;

    #[test]
    fn counts_and_statistics_are_those_of_the_phrases() {
        let folder = tempfile::tempdir().unwrap();
        synthetic::write_dataset(folder.path(), 5, 30, 3).unwrap();
        let mut config = DataConfig {
            source: Some(folder.path().display().to_string()),
            ..DataConfig::default()
        };
        config.validation.patterns = vec!["*3".into(), "*4".into()];
        let found = inspect(&config, &|_, _| {}).unwrap();
        assert_eq!(
            (
                found.phrases,
                found.bad_phrases,
                found.train,
                found.validation
            ),
            (5, 0, 3, 2)
        );
        assert_eq!(
            (found.frames, found.shortest_frames, found.longest_frames),
            (150, 30, 30)
        );
        assert!((found.hours - 5.0 / 3600.0).abs() < 1e-12);
        let made = synthetic::phrases(5, 30, 3);
        let heights: Vec<f64> = made
            .iter()
            .flat_map(|phrase| (0..30).map(|t| f64::from(phrase.motion.frame(t)[1])))
            .collect();
        let mean = heights.iter().sum::<f64>() / 150.0;
        let height = &found.motion[1];
        assert_eq!(height.name, "position.y");
        assert!((height.mean - mean).abs() < 1e-9);
        assert_eq!(height.max, heights.iter().copied().fold(f64::MIN, f64::max));
        let names: Vec<&str> = found
            .audio
            .iter()
            .map(|summary| summary.name.as_str())
            .collect();
        assert_eq!(
            names,
            [
                "mel",
                "chroma",
                "mfcc",
                "rms",
                "spectral_centroid",
                "onset_strength"
            ]
        );
        let mfcc = &found.audio[2];
        assert!(mfcc.mean.abs() < 1e-5 && (mfcc.std - 1.0).abs() < 1e-3);
        assert!(
            found.problems.is_empty() && found.warnings.is_empty(),
            "{found:?}"
        );
    }

    #[test]
    fn every_kind_of_problem_is_listed_and_none_stops_the_rest() {
        let folder = tempfile::tempdir().unwrap();
        synthetic::write_dataset(folder.path(), 8, 30, 3).unwrap();
        let id = synthetic::id;
        let change = |index: usize, change: &dyn Fn(&mut kinegrad_motion::Motion)| {
            let path = folder.path().join(motion_path(&id(index)));
            let mut motion = read_motion(&path).unwrap();
            change(&mut motion);
            write_motion(&path, &motion).unwrap();
        };
        change(0, &|motion| motion.frame_mut(5)[2] = f32::NAN);
        change(1, &|motion| motion.frame_mut(5)[QUATERNION].fill(0.9));
        change(2, &|motion| {
            motion.frame_mut(5)[QUATERNION]
                .iter_mut()
                .for_each(|q| *q = -*q)
        });
        change(3, &|motion| motion.frame_mut(5)[PHASE] = 1.5);
        change(4, &|motion| {
            (0..30).for_each(|t| motion.frame_mut(t)[3] += 20.0)
        });
        let features = folder.path().join(features_path(&id(5)));
        write_features(&features, &synthetic::phrase(5, 20, 3).audio).unwrap();
        fs::write(folder.path().join(features_path(&id(6))), b"PK").unwrap();
        let source = Some(folder.path().display().to_string());
        let found = inspect(
            &DataConfig {
                source,
                ..DataConfig::default()
            },
            &|_, _| {},
        )
        .unwrap();
        assert_eq!((found.phrases, found.bad_phrases), (6, 2));
        for (index, expected) in [
            (0, "NaN in frame 5, channel position.z"),
            (1, "strict check quaternion_norm"),
            (2, "strict check quaternion_sign"),
            (3, "document check phase"),
            (4, "document check velocity_coherence"),
            (5, "motion has 30 frames, audio 20"),
            (6, "not a readable .npz archive"),
        ] {
            let listed: Vec<&Problem> = found
                .problems
                .iter()
                .filter(|problem| problem.id == id(index))
                .collect();
            assert!(
                listed.iter().any(|p| p.problem.contains(expected)),
                "{index}: {listed:?}"
            );
        }
        assert!(found.problems.iter().all(|problem| problem.id != id(7)));
        assert!(found.problems.is_sorted_by_key(|problem| &problem.id));
    }

    #[test]
    fn a_dataset_without_one_usable_phrase_is_still_described() {
        let folder = tempfile::tempdir().unwrap();
        for part in ["motion/a", "audio_features/a"] {
            fs::create_dir_all(folder.path().join(part)).unwrap();
        }
        let source = Some(folder.path().display().to_string());
        let found = inspect(
            &DataConfig {
                source,
                ..DataConfig::default()
            },
            &|_, _| {},
        )
        .unwrap();
        assert_eq!((found.phrases, found.bad_phrases, found.frames), (0, 1, 0));
        assert!(found.motion.is_empty() && found.audio.is_empty());
        assert_eq!(found.warnings, ["no phrase is left to train on"]);
    }

    #[test]
    fn synthetic_datasets_are_described_without_files() {
        let config = DataConfig {
            kind: crate::DataKind::Synthetic,
            ..DataConfig::default()
        };
        let found = inspect(&config, &|_, _| {}).unwrap();
        assert_eq!(
            (found.source.as_str(), found.phrases, found.frames),
            ("synthetic", 64, 7680)
        );
        assert!(found.problems.is_empty(), "{:?}", found.problems);
    }
}
