use super::*;
use crate::features::FEATURES;
use crate::npy::tests::raw;
use proptest::prelude::*;

fn ramp(frames: usize) -> AudioFeatures {
    let values = (0..AUDIO_CHANNELS * frames)
        .map(|i| i as f32 / 8.0)
        .collect();
    AudioFeatures::new(frames, values).unwrap()
}

/// An archive of six members, each created by `make(name, rows)`; `None` omits the member.
fn archive(make: impl Fn(&str, usize) -> Option<Vec<u8>>) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    for (name, rows) in FEATURES {
        if let Some(bytes) = make(name, rows) {
            writer.start_file(format!("{name}.npy"), options).unwrap();
            writer.write_all(&bytes).unwrap();
        }
    }
    writer.finish().unwrap().into_inner()
}

fn member(rows: usize, frames: usize) -> Vec<u8> {
    let shape = if rows == 1 {
        format!("({frames},)")
    } else {
        format!("({rows}, {frames})")
    };
    raw("'<f4'", false, &shape, &vec![0; rows * frames * 4])
}

fn read(bytes: &[u8]) -> Result<AudioFeatures, FileError> {
    parse_features(bytes, "features.npz", AudioLayout::CCMOTION)
}

#[test]
fn features_survive_a_round_trip_and_equal_features_make_equal_files() {
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = (folder.path().join("one.npz"), folder.path().join("two.npz"));
    write_features(&one, &ramp(7)).unwrap();
    write_features(&two, &ramp(7)).unwrap();
    assert_eq!(read(&std::fs::read(&one).unwrap()).unwrap(), ramp(7));
    assert_eq!(std::fs::read(&one).unwrap(), std::fs::read(&two).unwrap());
}

#[test]
fn stored_members_are_read_too() {
    let bytes = archive(|_, rows| Some(member(rows, 4)));
    assert_eq!(
        read(&bytes).unwrap(),
        AudioFeatures::silence(AudioLayout::CCMOTION, 4)
    );
}

#[test]
fn broken_archives_say_what_is_wrong() {
    let good = archive(|_, rows| Some(member(rows, 4)));
    let mut flipped = good.clone();
    // The change is in mel's data, so only the checksum differs.
    flipped[300] ^= 1;
    for (bytes, expected) in [
        (
            good[..good.len() / 2].to_vec(),
            "not a readable .npz archive",
        ),
        (flipped, "checksum"),
        (
            archive(|name, rows| (name != "mfcc").then(|| member(rows, 4))),
            "`mfcc` is missing",
        ),
        (archive(|_, _| None), "found: nothing"),
        (
            archive(|name, rows| Some(member(rows, if name == "rms" { 5 } else { 4 }))),
            "`rms` has 5 frames, `mel` has 4",
        ),
        (
            archive(|name, rows| Some(member(if name == "chroma" { 11 } else { rows }, 4))),
            ":chroma: shape [11, 4] found",
        ),
        (
            archive(|name, rows| match name {
                "onset_strength" => Some(raw("'<i8'", false, "(4,)", &[0; 32])),
                _ => Some(member(rows, 4)),
            }),
            ":onset_strength: dtype '<i8' found",
        ),
        (
            archive(|name, rows| match name {
                "rms" => Some(vec![0; npy::max_bytes(1) as usize + 1]),
                _ => Some(member(rows, 4)),
            }),
            "allowed: 216000 frames",
        ),
    ] {
        let message = read(&bytes).unwrap_err().to_string();
        assert!(message.contains(expected), "{message} lacks {expected}");
    }
}

/// A deflated archive whose directory declares member sizes edited by `change`.
fn with_declared_size(change: impl Fn(u32) -> u32) -> Vec<u8> {
    let mut bytes = super::archive(&ramp(4), &[], CompressionMethod::Deflated);
    let places = bytes.windows(4).enumerate();
    let places: Vec<usize> = places
        .filter(|(_, mark)| *mark == b"PK\x01\x02")
        .map(|(place, _)| place + 24)
        .collect();
    assert_eq!(places.len(), 6);
    for place in places {
        let size = &mut bytes[place..place + 4];
        let declared = u32::from_le_bytes(size.try_into().unwrap());
        size.copy_from_slice(&change(declared).to_le_bytes());
    }
    bytes
}

#[test]
fn a_declared_size_is_not_believed() {
    let read = |change: fn(u32) -> u32| read(&with_declared_size(change));
    assert_eq!(read(|size| size).unwrap(), ramp(4));
    for (change, expected) in [
        (read(|size| size + 1), "declared"),
        (read(|size| size - 1), "cannot be unpacked"),
        (read(|_| 100_000_000), "cannot hold so many"),
        (read(|_| u32::MAX - 1), "216000 frames"),
    ] {
        let message = change.unwrap_err().to_string();
        assert!(message.contains(expected), "{message} lacks {expected}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn damaged_archives_never_panic(
        changes in proptest::collection::vec((0.0f64..1.0, any::<u8>()), 1..8),
        tail: bool,
        cut in 0.5f64..1.0,
    ) {
        let mut bytes = archive(|_, rows| Some(member(rows, 2)));
        let length = bytes.len();
        for (place, byte) in changes {
            // The directory at the end is a tenth of the file and needs most of the parser.
            let place = if tail { 1.0 - place * 0.25 } else { place };
            bytes[(place * (length - 1) as f64) as usize] = byte;
        }
        if !tail {
            bytes.truncate((cut * length as f64) as usize);
        }
        if let Ok(features) = read(&bytes) {
            prop_assert_eq!(features.as_slice().len(), AUDIO_CHANNELS * features.frames());
        }
    }
}

#[test]
fn an_array_that_is_stacked_already_is_read() {
    let features = ramp(3);
    for shape in [vec![AUDIO_CHANNELS, 3], vec![1, AUDIO_CHANNELS, 3]] {
        let bytes = npy::array_bytes(&shape, features.as_slice());
        assert_eq!(read(&bytes).unwrap(), features);
    }
    for shape in [vec![3, AUDIO_CHANNELS], vec![2, AUDIO_CHANNELS, 3]] {
        let values = vec![0.0; shape.iter().product()];
        let error = read(&npy::array_bytes(&shape, &values)).unwrap_err();
        assert!(error.to_string().contains("[163, frames]"), "{error}");
    }
}
