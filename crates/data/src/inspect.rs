//! Summary and problems of a dataset.

use std::ops::Range;

use kinegrad_motion::{ChannelMoments, Measured, Profile, Representation, Statistics};
use serde::Serialize;

use crate::humanml::Clip;
use crate::item::Item;
use crate::survey::{Gathered, Listable, OpenProgress, Sides};
use crate::{DataConfig, DataKind, Dataset, Error, OnBadPhrase, Phrase};

/// The contents of a dataset. Numbers describe the items that can be used.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Inspection {
    /// The dataset's address, or `synthetic` or `synthetic_walks`.
    pub source: String,
    /// Kind of the items: `phrase` or `clip`.
    pub kind: &'static str,
    /// Name of the representation.
    pub representation: String,
    /// Items that are used.
    pub items: usize,
    /// Items that cannot be used.
    pub bad_items: usize,
    /// Valid items that are left out: clips that are too short, too long, or have only captions of short
    /// segments.
    pub left_out: usize,
    /// Items to train on.
    pub train: usize,
    /// Items held out for validation.
    pub validation: usize,
    /// Total number of frames.
    pub frames: usize,
    /// Their length in hours.
    pub hours: f64,
    /// Frames per second.
    pub fps: f64,
    /// Frames of the shortest item.
    pub shortest_frames: usize,
    /// Frames of the longest item.
    pub longest_frames: usize,
    /// Channels of the motion.
    pub channels: usize,
    /// Counts of conditions, by name.
    pub counts: Vec<(&'static str, usize)>,
    /// Summary of each channel of the motion, or group of channels, in the dataset's units.
    pub motion: Vec<ChannelSummary>,
    /// Summary of each condition.
    pub conditions: Vec<ChannelSummary>,
    /// What is wrong with single items, by id.
    pub problems: Vec<Problem>,
    /// Warnings about the dataset as a whole.
    pub warnings: Vec<String>,
}

/// Range, mean and standard deviation over all frames of all usable items.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelSummary {
    /// The channel.
    pub name: String,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub std: f64,
}

impl ChannelSummary {
    /// Some channels taken together.
    fn of(name: &str, moments: &ChannelMoments, channels: Range<usize>) -> Self {
        let channel = |c: usize| ChannelMoments {
            mean: vec![moments.mean[c]],
            std: vec![moments.std[c]],
            min: vec![moments.min[c]],
            max: vec![moments.max[c]],
            ..*moments
        };
        let mut together = channel(channels.start);
        (channels.start + 1..channels.end).for_each(|c| together.merge(&channel(c)));
        Self {
            name: name.to_owned(),
            min: together.min[0],
            max: together.max[0],
            mean: together.mean[0],
            std: together.std[0],
        }
    }
}

/// Something wrong with an item.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Problem {
    /// The item.
    pub id: String,
    /// What is wrong, in words.
    pub problem: String,
    /// Whether the item cannot be used for it.
    pub unusable: bool,
}

/// What one item, or several, come to.
struct Contents {
    motion: Measured,
    conditions: Vec<(&'static str, ChannelMoments)>,
    counts: Vec<(&'static str, usize)>,
}

impl Contents {
    fn of<T: Item>(item: &T, representation: &T::Representation) -> Self {
        let conditions = item.conditions().into_iter();
        Self {
            motion: Measured::of(representation, &item.rows(representation)),
            conditions: conditions
                .map(|(name, values)| (name, ChannelMoments::measure(1, [values])))
                .collect(),
            counts: item.counts(),
        }
    }

    fn merge(&mut self, other: Self) {
        self.motion.merge(other.motion);
        for ((_, all), (_, moments)) in self.conditions.iter_mut().zip(&other.conditions) {
            all.merge(moments);
        }
        for ((_, all), (_, count)) in self.counts.iter_mut().zip(other.counts) {
            *all += count;
        }
    }
}

/// Reads every item of the dataset of `config`, regardless of `on_bad_phrase`.
///
/// An item that can be read is held against both profiles of the checks, the strict one with the
/// statistics of the training items (of all items, where none is left to train on).
///
/// # Errors
/// As [`Dataset::open`], but never for a single bad item or for a side of
/// the split that is empty.
pub fn inspect(config: &DataConfig, progress: OpenProgress) -> Result<Inspection, Error> {
    config.validate()?;
    match config.kind {
        DataKind::Phrases | DataKind::Synthetic => inspect_items::<Phrase>(config, progress),
        DataKind::Humanml3d | DataKind::SyntheticWalks => inspect_items::<Clip>(config, progress),
    }
}

/// The statistics of the motion to train on of the dataset that `config` describes.
///
/// # Errors
/// As [`Dataset::open`].
pub fn statistics(config: &DataConfig) -> Result<Statistics, Error> {
    match config.kind {
        DataKind::Phrases | DataKind::Synthetic => Dataset::<Phrase>::open(config)?.statistics(),
        DataKind::Humanml3d | DataKind::SyntheticWalks => {
            Dataset::<Clip>::open(config)?.statistics()
        }
    }
}

fn inspect_items<T: Listable>(
    config: &DataConfig,
    progress: OpenProgress,
) -> Result<Inspection, Error> {
    let mut survey = T::survey(config)?;
    survey.tolerates_changes = true;
    let Gathered {
        entries,
        skipped,
        left_out,
        notes,
        memory,
    } = survey.gather(config, OnBadPhrase::Skip, progress)?;
    let (kind, representation) = (T::KIND, survey.representation.clone());
    let (source, mut warnings) = (survey.source.clone(), std::mem::take(&mut survey.warnings));
    let lengths: Vec<usize> = entries.iter().map(|entry| entry.frames).collect();
    let Sides {
        train, validation, ..
    } = survey.divide(entries, memory);

    let problem = |unusable| {
        move |(id, problem)| Problem {
            id,
            problem,
            unusable,
        }
    };
    let mut problems: Vec<Problem> = notes.into_iter().map(problem(false)).collect();
    let bad_items = skipped.len();
    problems.extend(skipped.into_iter().map(problem(true)));
    if train.is_empty() {
        warnings.push(format!("no {kind} is left to train on"));
    }
    if let Some((id, reason)) = left_out.first() {
        let count = left_out.len();
        warnings.push(format!(
            "{count} {kind}(s) are left out; the first: {kind} `{id}`: {reason}"
        ));
    }

    let mut all: Option<Contents> = None;
    let mut of_training = None;
    for side in [&train, &validation] {
        side.measure(
            |item| Contents::of(item, &representation),
            |contents| match &mut all {
                Some(all) => all.merge(contents),
                None => all = Some(contents),
            },
        )?;
        let measured = || all.as_ref().map(|all| all.motion.clone());
        of_training = of_training.or_else(measured);
    }
    let statistics = of_training.map(|measured| measured.statistics(&representation));
    for side in [&train, &validation] {
        let failed = |item: &T| {
            let rows = item.rows(&representation);
            let odd = representation.implausible(&rows).into_iter();
            let profiles = [Profile::Strict, Profile::Document].into_iter();
            let checks = profiles.flat_map(|profile| {
                let report = representation.check(&rows, profile, statistics.as_ref());
                let checks = report.map(|report| report.checks).unwrap_or_default();
                let failed = checks.into_iter().filter(|check| !check.passed);
                failed.map(move |check| {
                    let (message, allowed) = (check.message, check.threshold);
                    format!(
                        "fails the {profile} check {}: {message}, {allowed} allowed",
                        check.name
                    )
                })
            });
            let problems = odd.chain(checks);
            let id = item.id().to_owned();
            problems
                .map(|problem| (id.clone(), problem))
                .collect::<Vec<_>>()
        };
        side.measure(failed, |failed| {
            problems.extend(failed.into_iter().map(problem(false)));
        })?;
    }
    problems.sort_by(|a, b| a.id.cmp(&b.id));
    let frames: usize = lengths.iter().sum();
    let moments = all.as_ref().map(|all| all.motion.moments());
    let groups = moments.map(|moments| {
        let groups = representation.groups().into_iter();
        groups
            .map(|(name, channels)| ChannelSummary::of(&name, moments, channels))
            .collect()
    });
    let conditions = all.iter().flat_map(|all| &all.conditions);
    Ok(Inspection {
        source,
        kind,
        representation: representation.name(),
        items: lengths.len(),
        bad_items,
        left_out: left_out.len(),
        train: train.len(),
        validation: validation.len(),
        frames,
        hours: frames as f64 / representation.fps() / 3600.0,
        fps: representation.fps(),
        shortest_frames: lengths.iter().copied().min().unwrap_or(0),
        longest_frames: lengths.iter().copied().max().unwrap_or(0),
        channels: representation.channels(),
        motion: groups.unwrap_or_default(),
        conditions: conditions
            .map(|(name, moments)| ChannelSummary::of(name, moments, 0..1))
            .collect(),
        counts: all.map(|all| all.counts).unwrap_or_default(),
        problems,
        warnings,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::humanml::{walk, write_features, write_walks};
    use crate::{features_path, motion_path};
    use crate::{read_motion, synthetic, write_motion};
    use kinegrad_motion::humanml::{Features, Root};
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
            (found.items, found.bad_items, found.train, found.validation),
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
            .conditions
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
        let mfcc = &found.conditions[2];
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
        crate::write_features(&features, &synthetic::phrase(5, 20, 3).audio).unwrap();
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
        assert_eq!((found.items, found.bad_items), (6, 2));
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
        assert_eq!((found.items, found.bad_items, found.frames), (0, 1, 0));
        assert!(found.motion.is_empty() && found.conditions.is_empty());
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
            (found.source.as_str(), found.items, found.frames),
            ("synthetic", 64, 7680)
        );
        assert!(found.problems.is_empty(), "{:?}", found.problems);
    }

    #[test]
    fn clips_are_counted_and_what_is_wrong_is_listed() {
        let folder = tempfile::tempdir().unwrap();
        write_walks(folder.path(), 12, 80, 4).unwrap();
        let features = |index: usize| {
            folder
                .path()
                .join(format!("new_joint_vecs/walk_{index:05}.npy"))
        };
        fs::write(features(1), b"no array").unwrap();
        write_features(&features(2), &walk(2, 30, 4).features).unwrap();
        let layout = walk(0, 80, 4).features.layout();
        let flat = Features::new(vec![0.25; 50 * 263], layout, Root::Relative).unwrap();
        write_features(&features(3), &flat).unwrap();
        let config = DataConfig {
            kind: DataKind::Humanml3d,
            source: Some(folder.path().display().to_string()),
            ..DataConfig::default()
        };
        let found = inspect(&config, &|_, _| {}).unwrap();
        assert_eq!((found.items, found.bad_items, found.left_out), (10, 1, 1));
        assert_eq!(found.train + found.validation, 10);
        assert_eq!(
            (found.frames, found.shortest_frames, found.longest_frames),
            (770, 50, 80)
        );
        assert!((found.hours - 770.0 / 72_000.0).abs() < 1e-12);
        let count = |name| found.counts.iter().find(|(n, _)| *n == name).unwrap().1;
        assert!(count("captions") >= 20 && found.channels == 263);
        assert_eq!(count("captions"), count("captions with an embedding"));
        assert_eq!(count("clips without captions"), 0);
        let problems: Vec<_> = (found.problems.iter())
            .map(|p| (p.id.as_str(), p.unusable))
            .collect();
        assert_eq!(
            problems,
            [("walk_00001", true), ("walk_00003", false)],
            "{found:?}"
        );
        assert!(
            found.problems[1]
                .problem
                .contains("joint rotations are invalid in frame 0")
        );
        assert!(found.warnings[0].contains("clip `walk_00002`: too short: 30 frames"));
    }

    #[test]
    fn groups_are_summed_up_over_all_clips() {
        let mut config = DataConfig {
            kind: DataKind::SyntheticWalks,
            ..DataConfig::default()
        };
        config.synthetic.phrases = 4;
        config.synthetic.frames = 50;
        let found = inspect(&config, &|_, _| {}).unwrap();
        assert_eq!((found.items, found.frames), (4, 200));
        let clips: Vec<_> = (0..4).map(|index| walk(index, 50, 0)).collect();
        let heights: Vec<f64> = (clips.iter())
            .flat_map(|clip| (0..50).map(|t| f64::from(clip.features.frame(t)[3])))
            .collect();
        let mean = heights.iter().sum::<f64>() / 200.0;
        let square = heights
            .iter()
            .map(|value| (value - mean).powi(2))
            .sum::<f64>();
        let height = &found.motion[2];
        assert_eq!(height.name, "root height");
        assert!((height.mean - mean).abs() < 1e-12);
        assert!((height.std - (square / 200.0).sqrt()).abs() < 1e-12);
        assert_eq!(height.max, heights.iter().copied().fold(f64::MIN, f64::max));
        assert!(found.problems.is_empty(), "{:?}", found.problems);
    }
}
