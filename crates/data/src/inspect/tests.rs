use super::*;
use crate::DataKind;
use crate::humanml::{walk, write_features, write_walks};
use crate::{features_path, motion_path};
use crate::{read_motion, synthetic, write_motion};
use kinegrad_motion::humanml::{Features, Root};
use kinegrad_motion::phrase::{PHASE, QUATERNION};
use std::fs;

#[test]
fn counts_and_statistics_are_those_of_the_phrases() {
    let folder = tempfile::tempdir().unwrap();
    synthetic::write_dataset(folder.path(), crate::AudioLayout::CCMOTION, 5, 30, 3).unwrap();
    let mut config = DataConfig {
        source: Some(folder.path().display().to_string()),
        ..DataConfig::default()
    };
    config.validation.patterns = vec!["*3".into(), "*4".into()];
    let found = inspect(&config, &no_progress).unwrap();
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
fn phases_are_compared_with_the_beats_tracked_in_the_music() {
    let folder = tempfile::tempdir().unwrap();
    let inspected = || {
        let config = DataConfig {
            source: Some(folder.path().display().to_string()),
            ..DataConfig::default()
        };
        inspect(&config, &no_progress).unwrap()
    };
    synthetic::write_dataset(folder.path(), crate::AudioLayout::CCMOTION, 12, 120, 3).unwrap();
    let found = inspected();
    let beats = found.beats.unwrap();
    assert_eq!((beats.phrases, beats.songs), (12, 12));
    assert!(beats.error.mean < 0.05, "{beats}");
    assert!(!beats.is_at_chance() && found.warnings.is_empty());
    // Each phrase is late by another part of a beat.
    for index in 0..12 {
        let path = folder.path().join(motion_path(&synthetic::id(index)));
        let mut motion = read_motion(&path).unwrap();
        for t in 0..120 {
            let phase = motion.frame(t)[PHASE] + index as f32 / 48.0;
            motion.frame_mut(t)[PHASE] = phase.rem_euclid(1.0);
        }
        write_motion(&path, &motion).unwrap();
    }
    let found = inspected();
    let beats = found.beats.unwrap();
    assert!((beats.error.mean - 0.25).abs() < 0.03, "{beats}");
    let warning = "the phase of the phrases does not follow the beats tracked in their music";
    assert!(
        found.warnings[0].starts_with(warning),
        "{:?}",
        found.warnings
    );
}

#[test]
fn every_kind_of_problem_is_listed_and_none_stops_the_rest() {
    let folder = tempfile::tempdir().unwrap();
    synthetic::write_dataset(folder.path(), crate::AudioLayout::CCMOTION, 8, 30, 3).unwrap();
    let id = synthetic::id;
    let change = |index: usize, change: &dyn Fn(&mut kinegrad_motion::Phrase)| {
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
        &no_progress,
    )
    .unwrap();
    assert_eq!((found.items, found.bad_items), (6, 2));
    for (index, expected) in [
        (0, "NaN in frame 5, channel position.z"),
        (1, "strict check quaternion_norm"),
        (2, "strict check quaternion_sign"),
        (3, "ccmotion check phase"),
        (4, "ccmotion check velocity_coherence"),
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
        &no_progress,
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
    let found = inspect(&config, &no_progress).unwrap();
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
    let found = inspect(&config, &no_progress).unwrap();
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
        [
            ("walk_00001", true),
            ("walk_00003", false),
            ("walk_00003", false),
            ("walk_00003", false),
            ("walk_00003", false),
            ("walk_00003", false)
        ],
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
    let found = inspect(&config, &no_progress).unwrap();
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
