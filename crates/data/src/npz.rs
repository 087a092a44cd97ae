//! `features.npz`: reading and writing the six audio features of a phrase.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use npyz::zip::{CompressionMethod, ZipArchive, ZipWriter, write::FileOptions};

use crate::features::{AUDIO_CHANNELS, AudioFeatures, FEATURES};
use crate::npy::{self, Array, MAX_FRAMES};
use crate::{Error, FileError, atomic};

/// Reads a `features.npz` (members stored or deflated) and stacks it to `[163, frames]` in the
/// order of [`FEATURES`] (CC-MotionGen, section 4.3). Other members are passed over.
///
/// # Errors
/// [`FileError`] for an archive that cannot be read or was cut off, a missing member, another
/// dtype or shape, members of unequal length. Numbers that are not finite pass: see
/// [`crate::load_audio`].
pub fn read_features(path: &Path) -> Result<AudioFeatures, FileError> {
    let file = path.display().to_string();
    let opened = File::open(path).map_err(|e| FileError::Read {
        file: file.clone(),
        reason: e.to_string(),
    })?;
    let mut archive = ZipArchive::new(BufReader::new(opened)).map_err(|e| FileError::NotNpz {
        file: file.clone(),
        reason: e.to_string(),
    })?;
    let mut frames = None;
    let mut values = Vec::new();
    for (name, rows) in FEATURES {
        let array = read_member(&mut archive, &file, name, rows)?;
        let length = check_shape(&array, &format!("{file}:{name}"), rows)?;
        let expected = *frames.get_or_insert(length);
        if length != expected {
            return Err(FileError::UnequalFrames {
                file,
                member: name,
                found: length,
                frames: expected,
            });
        }
        values.extend(array.values);
    }
    let frames = frames.unwrap_or_default();
    debug_assert_eq!(values.len(), AUDIO_CHANNELS * frames);
    Ok(AudioFeatures::new(frames, values).unwrap_or_else(|| AudioFeatures::zeros(frames)))
}

/// Writes `features` as compressed float32 members that NumPy can read, whole or not at all.
///
/// # Errors
/// [`Error::Io`].
pub fn write_features(path: &Path, features: &AudioFeatures) -> Result<(), Error> {
    let frames = features.frames();
    atomic::write(path, |writer| {
        let mut archive = ZipWriter::new(writer);
        // The default date of an entry is fixed, so equal features make equal files.
        let options = FileOptions::default().compression_method(CompressionMethod::Deflated);
        let mut rest = features.as_slice();
        for (name, rows) in FEATURES {
            let (values, after) = rest.split_at(rows * frames);
            rest = after;
            archive.start_file(format!("{name}.npy"), options)?;
            match rows {
                1 => npy::write_array(&mut archive, &[frames], values)?,
                _ => npy::write_array(&mut archive, &[rows, frames], values)?,
            }
        }
        archive.finish()?;
        Ok(())
    })
}

/// Unpacks and parses one member, never more of it than [`MAX_FRAMES`] frames fill.
fn read_member<R: std::io::Read + std::io::Seek>(
    archive: &mut ZipArchive<R>,
    file: &str,
    name: &'static str,
    rows: usize,
) -> Result<Array, FileError> {
    let label = format!("{file}:{name}");
    let broken = |reason: String| FileError::NotNpz {
        file: label.clone(),
        reason,
    };
    let member = format!("{name}.npy");
    if !archive.file_names().any(|found| found == member) {
        let mut found: Vec<&str> = archive
            .file_names()
            .map(|name| name.strip_suffix(".npy").unwrap_or(name))
            .collect();
        found.sort_unstable();
        let count = found.len();
        found.truncate(12);
        let mut found = if count == 0 {
            "nothing".to_owned()
        } else {
            found.join(", ")
        };
        if count > 12 {
            found.push_str(&format!(" and {} more", count - 12));
        }
        return Err(FileError::MissingMember {
            file: file.to_owned(),
            member: name,
            found,
        });
    }
    // With a password, even an empty one, a forged encryption mark is an error and not a panic.
    let mut entry = archive
        .by_name_decrypt(&member, b"")
        .map_err(|e| broken(e.to_string()))?
        .map_err(|_| broken("it is encrypted".to_owned()))?;
    if !matches!(
        entry.compression(),
        CompressionMethod::Stored | CompressionMethod::Deflated
    ) {
        return Err(broken(format!(
            "compression {} found, stored or deflated allowed",
            entry.compression()
        )));
    }
    let limit = npy::max_bytes(rows);
    let mut bytes = Vec::new();
    (&mut entry)
        .take(limit + 1)
        .read_to_end(&mut bytes)
        .map_err(|e| broken(e.to_string()))?;
    if bytes.len() as u64 > limit {
        return Err(broken(format!(
            "more than {limit} bytes unpacked, {MAX_FRAMES} frames allowed"
        )));
    }
    npy::parse(&bytes, &label)
}

/// The frames of a member with so many rows; `[frames]` or `[1, frames]` where there is one row.
fn check_shape(array: &Array, label: &str, rows: usize) -> Result<usize, FileError> {
    let frames = match array.shape[..] {
        [frames] if rows == 1 => Some(frames),
        [found_rows, frames] if found_rows == rows => Some(frames),
        _ => None,
    };
    frames
        .filter(|frames| (1..=MAX_FRAMES).contains(frames))
        .ok_or_else(|| FileError::Shape {
            file: label.to_owned(),
            found: format!("{:?}", array.shape),
            allowed: match rows {
                1 => format!("[frames] with 1 to {MAX_FRAMES} frames"),
                _ => format!("[{rows}, frames] with 1 to {MAX_FRAMES} frames"),
            },
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::npy::tests::raw;
    use proptest::prelude::*;
    use std::io::{Cursor, Write};

    fn ramp(frames: usize) -> AudioFeatures {
        let values = (0..AUDIO_CHANNELS * frames)
            .map(|i| i as f32 / 8.0)
            .collect();
        AudioFeatures::new(frames, values).unwrap()
    }

    /// An archive of six members, each made by `make(name, rows)`; `None` leaves it out.
    fn archive(make: impl Fn(&str, usize) -> Option<Vec<u8>>) -> Vec<u8> {
        let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
        let options = FileOptions::default().compression_method(CompressionMethod::Stored);
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
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("features.npz");
        std::fs::write(&path, bytes).unwrap();
        read_features(&path)
    }

    #[test]
    fn features_survive_a_round_trip_and_equal_features_make_equal_files() {
        let folder = tempfile::tempdir().unwrap();
        let (one, two) = (folder.path().join("one.npz"), folder.path().join("two.npz"));
        write_features(&one, &ramp(7)).unwrap();
        write_features(&two, &ramp(7)).unwrap();
        assert_eq!(read_features(&one).unwrap(), ramp(7));
        assert_eq!(std::fs::read(&one).unwrap(), std::fs::read(&two).unwrap());
    }

    #[test]
    fn stored_members_are_read_too() {
        let bytes = archive(|_, rows| Some(member(rows, 4)));
        assert_eq!(read(&bytes).unwrap(), AudioFeatures::zeros(4));
    }

    #[test]
    fn broken_archives_say_what_is_wrong() {
        let good = archive(|_, rows| Some(member(rows, 4)));
        let mut flipped = good.clone();
        // A byte of mel's data: only the checksum can tell.
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
                "216000 frames allowed",
            ),
        ] {
            let message = read(&bytes).unwrap_err().to_string();
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
                // The directory at the end is a tenth of the file and most of the parser.
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
}
