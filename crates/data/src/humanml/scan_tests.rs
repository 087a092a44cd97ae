//! Valid datasets, and the errors of invalid datasets.

use std::fs;
use std::path::Path;

use kinegrad_motion::Representation;
use kinegrad_motion::humanml::{Features, Root};
use kinegrad_motion::representation::statistics_of;

use super::*;
use crate::humanml::{SkeletonName, parse_features, walk, write_features, write_walks};
use crate::{Dataset, OnBadPhrase, npy};

fn dataset(clips: usize) -> (tempfile::TempDir, DataConfig) {
    let folder = tempfile::tempdir().unwrap();
    write_walks(folder.path(), clips, 80, 5).unwrap();
    let config = DataConfig {
        kind: DataKind::Humanml3d,
        source: Some(folder.path().display().to_string()),
        ..DataConfig::default()
    };
    (folder, config)
}

fn message(config: &DataConfig) -> String {
    Dataset::<Clip>::open(config).unwrap_err().to_string()
}

fn id(index: usize) -> String {
    synthetic_id(index)
}

fn features_file(folder: &Path, index: usize) -> std::path::PathBuf {
    folder.join(super::super::clip::features_path(&id(index)))
}

fn texts_file(folder: &Path, index: usize) -> std::path::PathBuf {
    folder.join(super::super::texts::texts_path(&id(index)))
}

fn write_array(path: &Path, shape: &[usize]) {
    let bytes = npy::array_bytes(shape, &vec![0.5; shape.iter().product()]);
    fs::write(path, bytes).unwrap();
}

#[test]
fn written_walks_are_those_made_in_memory() {
    let (folder, config) = dataset(14);
    let read = Dataset::<Clip>::open(&config).unwrap();
    let mut made = config.clone();
    made.kind = DataKind::SyntheticWalks;
    made.synthetic = crate::SyntheticConfig {
        phrases: 14,
        frames: 80,
        seed: 5,
    };
    let made = Dataset::<Clip>::open(&made).unwrap();
    assert_eq!(read.train.load().unwrap(), made.train.load().unwrap());
    let held_out = read.validation.load().unwrap();
    assert_eq!(held_out, made.validation.load().unwrap());
    assert_eq!(read.train.len() + read.validation.len(), 14);
    assert_eq!(read.statistics().unwrap(), made.statistics().unwrap());
    assert!(read.skipped.is_empty() && read.left_out.is_empty());
    assert_eq!(
        (
            read.representation.channels(),
            read.statistics().unwrap().items
        ),
        (263, read.train.len())
    );
    assert_eq!(read.find(&id(3)).unwrap().unwrap().id, id(3));
    assert!(read.find("nobody").unwrap().is_none());
    let mut names: Vec<_> = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort_unstable();
    let expected = [
        "new_joint_vecs",
        "text_embeddings.safetensors",
        "texts",
        "train.txt",
        "val.txt",
    ];
    assert_eq!(names, expected);
    let again = write_walks(folder.path(), 3, 80, 5).unwrap_err();
    assert!(matches!(again, Error::Exists(_)), "{again}");
}

#[test]
fn another_width_names_file_and_both_widths() {
    let (folder, mut config) = dataset(5);
    write_array(&features_file(folder.path(), 2), &[60, 251]);
    let found = message(&config);
    let expected = "walk_00002.npy: found 251 channels, expected 263, the features of the \
                    skeleton `humanml3d`";
    assert!(
        found.contains(expected) && found.starts_with("clip `walk_00002`"),
        "{found}"
    );
    config.on_bad_phrase = OnBadPhrase::Skip;
    let read = Dataset::<Clip>::open(&config).unwrap();
    assert_eq!(read.skipped[0].0, id(2));
    assert!(read.skipped[0].1.contains("found 251 channels"));
    write_array(&features_file(folder.path(), 2), &[60]);
    config.on_bad_phrase = OnBadPhrase::Error;
    assert!(message(&config).contains("found shape [60], expected [frames, 263]"));
}

#[test]
fn numbers_that_are_not_finite_are_named() {
    let (folder, config) = dataset(3);
    let clip = walk(1, 80, 5);
    let mut values = clip.features.as_slice().to_vec();
    values[7 * 263 + 3] = f32::NAN;
    let bytes = npy::array_bytes(&[80, 263], &values);
    fs::write(features_file(folder.path(), 1), bytes).unwrap();
    let found = message(&config);
    assert!(
        found.contains("NaN in frame 7, channel root.height_y"),
        "{found}"
    );
}

#[test]
fn statistics_come_from_the_dataset_where_they_are_of_the_root() {
    let (folder, mut config) = dataset(6);
    let absolute = Dataset::<Clip>::open(&config).unwrap();
    for name in ["Mean.npy", "Std.npy"] {
        write_array(&folder.path().join(name), &[263]);
    }
    // `Mean.npy` and `Std.npy` are for the relative root only.
    let again = Dataset::<Clip>::open(&config).unwrap();
    assert_eq!(again.statistics().unwrap(), absolute.statistics().unwrap());
    assert_eq!(again.digest, absolute.digest);
    config.humanml3d.root = Root::Relative;
    let stored = Dataset::<Clip>::open(&config).unwrap();
    assert_eq!(stored.statistics().unwrap().mean, [0.5; 263]);
    assert_eq!(stored.statistics().unwrap().root, Some(Root::Relative));
    assert_ne!(stored.digest, absolute.digest);

    write_array(&folder.path().join("Std.npy"), &[251]);
    let found = message(&config);
    assert!(
        found.contains("Std.npy: found 251 channels, expected 263"),
        "{found}"
    );
    fs::remove_file(folder.path().join("Std.npy")).unwrap();
    let found = message(&config);
    assert!(found.contains("Std.npy: found no such file, expected it beside Mean.npy"));

    config.humanml3d.root = Root::Absolute;
    for name in ["Mean_abs_3d.npy", "Std_abs_3d.npy"] {
        write_array(&folder.path().join(name), &[263]);
    }
    let stored = Dataset::<Clip>::open(&config).unwrap();
    let statistics = stored.statistics().unwrap();
    assert_eq!(
        (statistics.std[0], statistics.root),
        (0.5, Some(Root::Absolute))
    );
}

#[test]
fn statistics_are_those_of_the_converted_training_clips() {
    let (_folder, config) = dataset(8);
    let read = Dataset::<Clip>::open(&config).unwrap();
    let clips = read.train.load().unwrap();
    let converted: Vec<Features> = clips.iter().map(|c| c.features.to_absolute()).collect();
    let rows = converted.iter().map(Features::as_slice);
    let expected = statistics_of(&read.representation, rows).unwrap();
    assert_eq!(read.statistics().unwrap(), expected);
}

#[test]
fn captions_are_needed_where_there_are_embeddings() {
    let (folder, mut config) = dataset(5);
    fs::remove_file(texts_file(folder.path(), 3)).unwrap();
    let found = message(&config);
    assert!(
        found.contains("walk_00003.txt: found no such file, expected a caption a line"),
        "{found}"
    );
    config.humanml3d.captions = Some(CaptionRule::Optional);
    let read = Dataset::<Clip>::open(&config).unwrap();
    assert!(read.find(&id(3)).unwrap().unwrap().captions.is_empty());
    fs::write(texts_file(folder.path(), 3), "one#two\n").unwrap();
    assert!(message(&config).contains("walk_00003.txt, line 1: found `one#two`"));

    // The clip has one more caption than embeddings.
    let text = fs::read_to_string(texts_file(folder.path(), 2)).unwrap();
    fs::write(texts_file(folder.path(), 2), format!("{text}x#y#0.0#0.0\n")).unwrap();
    fs::remove_file(texts_file(folder.path(), 3)).unwrap();
    let (rows, lines) = (text.lines().count(), text.lines().count() + 1);
    let found = message(&config);
    let expected = format!("tensor `walk_00002`: found {rows} rows, expected {lines} rows");
    assert!(found.contains(&expected), "{found}");

    config.humanml3d.text_embeddings = "none.safetensors".into();
    config.humanml3d.captions = None;
    let read = Dataset::<Clip>::open(&config).unwrap();
    assert!(read.warnings[0].contains("none.safetensors: not found"));
    config.humanml3d.text_embeddings.clear();
    let read = Dataset::<Clip>::open(&config).unwrap();
    assert!(read.warnings.is_empty(), "{:?}", read.warnings);
}

#[test]
fn short_ranges_are_dropped_and_clips_of_other_lengths_left_out() {
    let (folder, mut config) = dataset(6);
    let write = |index: usize, frames: usize| {
        let clip = walk(index, frames, 5);
        write_features(&features_file(folder.path(), index), &clip.features).unwrap();
    };
    write(0, 39);
    write(1, 200);
    write(2, 199);
    fs::write(texts_file(folder.path(), 4), "a b#a/X#1.0#2.0\n").unwrap();
    config.humanml3d.text_embeddings.clear();
    let read = Dataset::<Clip>::open(&config).unwrap();
    let expected = [
        (id(0), "too short: 39 frames"),
        (id(1), "too long: 200 frames"),
    ];
    assert_eq!(
        read.left_out,
        expected.map(|(id, reason)| (id, reason.to_owned()))
    );
    assert!(read.find(&id(4)).unwrap().unwrap().captions.is_empty());
    assert!(read.warnings[0].contains("clip `walk_00004`: 1 caption of ranges"));
    config.humanml3d.captions = Some(CaptionRule::Required);
    assert_eq!(Dataset::<Clip>::open(&config).unwrap().left_out[2].0, id(4));
    config.humanml3d.max_frames = 60;
    config.num_phrases = Some(2);
    let found = message(&config);
    assert!(found.starts_with("all 2 clips are left out"), "{found}");
}

#[test]
fn lists_decide_and_their_problems_are_named() {
    let (folder, mut config) = dataset(6);
    let list = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    list("train.txt", "walk_00001\nwalk_00000\nwalk_00001\n");
    list("val.txt", "walk_00004\n");
    let read = Dataset::<Clip>::open(&config).unwrap();
    assert_eq!(read.train.ids().collect::<Vec<_>>(), [id(0), id(1)]);
    assert_eq!(read.validation.ids().collect::<Vec<_>>(), [id(4)]);
    assert!(
        read.warnings[0].contains("1 clip twice"),
        "{:?}",
        read.warnings
    );
    let digest = read.digest;
    list("train.txt", "walk_00000\n");
    list("val.txt", "walk_00004\nwalk_00001\n");
    assert_ne!(Dataset::<Clip>::open(&config).unwrap().digest, digest);
    list("val.txt", "walk_00000\n");
    let found = message(&config);
    assert!(
        found.contains("val.txt, line 1: found clip `walk_00000`"),
        "{found}"
    );
    list("val.txt", "");
    assert!(
        Dataset::<Clip>::open(&config)
            .unwrap()
            .validation
            .is_empty()
    );
    list("train.txt", "\n");
    assert!(message(&config).contains("train.txt: found no id"));
    config.humanml3d.train_list = "other.txt".into();
    assert!(message(&config).contains("other.txt: found no such file, expected a list"));
}

#[test]
fn the_digest_knows_texts_and_embeddings_and_not_the_place() {
    let (folder, config) = dataset(4);
    let digest = |config: &DataConfig| Dataset::<Clip>::open(config).unwrap().digest;
    let first = digest(&config);
    let (_other, elsewhere) = dataset(4);
    assert_eq!(digest(&elsewhere), first);
    let path = folder.path().join("text_embeddings.safetensors");
    let mut bytes = fs::read(&path).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&path, bytes).unwrap();
    let second = digest(&config);
    assert_ne!(second, first);
    let text = fs::read_to_string(texts_file(folder.path(), 0)).unwrap();
    fs::write(
        texts_file(folder.path(), 0),
        text.replace("person", "child"),
    )
    .unwrap();
    assert_ne!(digest(&config), second);
}

#[test]
fn a_clip_that_changes_under_a_run_is_refused() {
    let (folder, mut config) = dataset(4);
    config.cache.memory_mib = 0;
    let read = Dataset::<Clip>::open(&config).unwrap();
    let text = texts_file(folder.path(), 1);
    fs::write(
        &text,
        fs::read_to_string(&text).unwrap().replace("person", "cat"),
    )
    .unwrap();
    let error = read.find(&id(1)).unwrap_err().to_string();
    assert!(
        error.contains("not those when the dataset was opened"),
        "{error}"
    );
}

#[test]
fn kit_clips_have_251_channels_and_their_own_rate() {
    let folder = tempfile::tempdir().unwrap();
    let skeleton = SkeletonName::Kit.skeleton();
    let path = folder.path().join("new_joint_vecs");
    fs::create_dir_all(&path).unwrap();
    write_array(&path.join("00001.npy"), &[60, 251]);
    fs::create_dir_all(folder.path().join("texts")).unwrap();
    fs::write(folder.path().join("texts/00001.txt"), "a#b#0.8#4.0\n").unwrap();
    fs::write(folder.path().join("train.txt"), "00001\n").unwrap();
    let mut config = DataConfig {
        kind: DataKind::Humanml3d,
        source: Some(folder.path().display().to_string()),
        ..DataConfig::default()
    };
    config.humanml3d.validation_list.clear();
    let error = message(&config);
    assert!(
        error.contains("found 251 channels, expected 263"),
        "{error}"
    );
    config.humanml3d.skeleton = SkeletonName::Kit;
    let read = Dataset::<Clip>::open(&config).unwrap();
    assert_eq!(
        (read.representation.channels(), read.train.frames(0)),
        (251, 60)
    );
    let clip = read.train.get(0).unwrap();
    let fps = skeleton.description().fps;
    assert_eq!(clip.captions[0].frames(60, fps), 10..50);
    let bytes = fs::read(path.join("00001.npy")).unwrap();
    assert_eq!(
        parse_features(&bytes, "a", &skeleton).unwrap(),
        clip.features
    );
}

#[test]
fn kit_clips_in_millimetres_are_read_in_metres() {
    let skeleton = SkeletonName::Kit.skeleton();
    let layout = skeleton.layout();
    let [_, ground, height, positions, _, displacements, _] = layout.groups();
    let lengths = [ground, height, positions, displacements];
    let read = |unit: f32| {
        let folder = tempfile::tempdir().unwrap();
        let channels = layout.channels();
        let scale = |channel: usize| match lengths.iter().any(|group| group.contains(&channel)) {
            true => unit,
            false => 1.0,
        };
        let values = |at: &dyn Fn(usize) -> f32, rows: usize| -> Vec<f32> {
            let row = (0..channels).map(|channel| scale(channel) * at(channel));
            row.collect::<Vec<_>>().repeat(rows)
        };
        // The root is 0.93 m above the floor.
        let clip = values(&|channel| 0.9 + 0.01 * channel as f32, 60);
        let joint_files = folder.path().join("new_joint_vecs");
        fs::create_dir_all(&joint_files).unwrap();
        crate::write_values(&joint_files.join("00001.npy"), &[60, channels], &clip).unwrap();
        for (name, value) in [("Mean_abs_3d.npy", 0.8), ("Std_abs_3d.npy", 0.5)] {
            let values = values(&|_| value, 1);
            crate::write_values(&folder.path().join(name), &[channels], &values).unwrap();
        }
        fs::create_dir_all(folder.path().join("texts")).unwrap();
        fs::write(folder.path().join("texts/00001.txt"), "a#b#0.0#0.0\n").unwrap();
        fs::write(folder.path().join("train.txt"), "00001\n").unwrap();
        let mut config = DataConfig {
            kind: DataKind::Humanml3d,
            source: Some(folder.path().display().to_string()),
            ..DataConfig::default()
        };
        config.humanml3d.validation_list.clear();
        config.humanml3d.skeleton = SkeletonName::Kit;
        let dataset = Dataset::<Clip>::open(&config).unwrap();
        let features = dataset.train.get(0).unwrap().features.clone();
        (features, dataset.statistics().unwrap())
    };
    let ((metres, statistics), (millimetres, converted)) = (read(1.0), read(1000.0));
    assert!((millimetres.frame(7)[3] - 0.93).abs() < 1e-6);
    for (found, expected) in millimetres.as_slice().iter().zip(metres.as_slice()) {
        assert!((found - expected).abs() < 1e-5, "{found} {expected}");
    }
    let close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
    assert!(close(&converted.mean, &statistics.mean) && close(&converted.std, &statistics.std));
}

#[test]
fn datasets_of_phrases_and_of_clips_are_distinguished() {
    let (_folder, config) = dataset(3);
    let found = Dataset::<crate::PhraseItem>::open(&config)
        .unwrap_err()
        .to_string();
    assert!(
        found.contains("`data.kind` is \"humanml3d\", allowed: \"phrases\""),
        "{found}"
    );
    let found = message(&DataConfig {
        kind: DataKind::Synthetic,
        ..config
    });
    assert!(
        found.contains("`data.kind` is \"synthetic\", allowed: \"humanml3d\""),
        "{found}"
    );
}
