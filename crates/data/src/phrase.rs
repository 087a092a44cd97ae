//! One phrase: its motion and its music, read from the dataset's layout.

use std::fs;
use std::path::{Path, PathBuf};

use kinegrad_motion::{FPS, Motion, channel_name};

use crate::features::{AudioFeatures, audio_channel_name};
use crate::{Error, FileError, npy, npz, source};

/// A phrase: motion `[frames, 25]` and audio features `[163, frames]` over the same frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Phrase {
    /// Name of its folders.
    pub id: String,
    /// Motion in the dataset's units.
    pub motion: Motion,
    /// Audio features as stored.
    pub audio: AudioFeatures,
}

impl Phrase {
    /// Reads a phrase and cuts motion and audio to their common length, from the front
    /// (CC-MotionGen, section 6.1). Also returns a note where they differ by more than a frame.
    ///
    /// # Errors
    /// [`FileError`] for a file that cannot be used, and [`FileError::NonFinite`] for a number
    /// that is not finite, wherever it stands.
    pub fn load(folder: &Path, id: &str) -> Result<(Self, Option<String>), FileError> {
        let path = motion_path(folder, id);
        let mut motion = npy::read_motion(&path)?;
        if let Some((frame, channel)) = motion.first_non_finite() {
            return Err(FileError::NonFinite {
                file: path.display().to_string(),
                frame,
                channel: channel_name(channel),
                value: motion.frame(frame)[channel],
            });
        }
        let path = features_path(folder, id);
        let mut audio = npz::read_features(&path)?;
        check_finite(&audio, &path)?;
        let (motion_frames, audio_frames) = (motion.frames(), audio.frames());
        let frames = motion_frames.min(audio_frames);
        let note = (motion_frames.abs_diff(audio_frames) > 1).then(|| {
            format!(
                "motion has {motion_frames} frames, audio {audio_frames}: the first {frames} \
                 ({:.2} s) are used",
                frames as f64 / FPS
            )
        });
        if motion_frames > frames {
            motion = motion.slice(0..frames);
        }
        if audio_frames > frames {
            audio = audio.slice(0..frames);
        }
        Ok((
            Self {
                id: id.to_owned(),
                motion,
                audio,
            },
            note,
        ))
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.motion.frames()
    }
}

/// Reads one phrase of the dataset at `source` (a folder or `file://` URI), without its notes.
///
/// # Errors
/// [`Error::Scheme`], [`Error::MissingFolder`], [`Error::UnknownPhrase`] for an id that the
/// dataset lacks, [`Error::BadPhrase`] for files that cannot be used.
pub fn load_phrase(source: &str, id: &str) -> Result<Phrase, Error> {
    let folder = source::local_folder(source)?;
    let listing = Listing::read(&folder)?;
    if !listing.ids.iter().any(|listed| listed == id) {
        return Err(Error::UnknownPhrase {
            id: id.to_owned(),
            path: folder,
            phrases: listing.ids.len(),
            first: listing
                .ids
                .first()
                .cloned()
                .unwrap_or_else(|| "none".to_owned()),
        });
    }
    Phrase::load(&folder, id)
        .map(|(phrase, _)| phrase)
        .map_err(|cause| Error::BadPhrase {
            id: id.to_owned(),
            cause: Box::new(cause),
        })
}

/// Reads the audio features `[163, frames]` of a `features.npz` outside any dataset.
///
/// # Errors
/// [`FileError`] for a file that cannot be used or holds a number that is not finite.
pub fn load_audio(path: &Path) -> Result<AudioFeatures, FileError> {
    let audio = npz::read_features(path)?;
    check_finite(&audio, path)?;
    Ok(audio)
}

fn check_finite(audio: &AudioFeatures, path: &Path) -> Result<(), FileError> {
    let Some((frame, channel)) = audio.first_non_finite() else {
        return Ok(());
    };
    Err(FileError::NonFinite {
        file: path.display().to_string(),
        frame,
        channel: audio_channel_name(channel),
        value: audio.channel(channel)[frame],
    })
}

/// Where the motion of phrase `id` lies.
pub(crate) fn motion_path(folder: &Path, id: &str) -> PathBuf {
    folder.join("motion").join(id).join("trajectory.npy")
}

/// Where the audio features of phrase `id` lie.
pub(crate) fn features_path(folder: &Path, id: &str) -> PathBuf {
    folder.join("audio_features").join(id).join("features.npz")
}

/// The ids of a dataset, each list sorted.
#[derive(Debug, PartialEq)]
pub(crate) struct Listing {
    /// Ids with motion and audio features.
    pub ids: Vec<String>,
    /// Ids with motion alone.
    pub only_motion: Vec<String>,
    /// Ids with audio features alone.
    pub only_audio: Vec<String>,
}

impl Listing {
    /// Lists the folders under `motion/` and `audio_features/`; files and hidden folders do not
    /// count.
    pub fn read(folder: &Path) -> Result<Self, Error> {
        if !folder.is_dir() {
            return Err(Error::MissingFolder {
                path: folder.to_owned(),
            });
        }
        let motion = folders(&folder.join("motion"))?;
        let audio = folders(&folder.join("audio_features"))?;
        let (ids, only_motion): (Vec<_>, Vec<_>) = motion
            .into_iter()
            .partition(|id| audio.binary_search(id).is_ok());
        let only_audio = audio
            .into_iter()
            .filter(|id| ids.binary_search(id).is_err())
            .collect();
        Ok(Self {
            ids,
            only_motion,
            only_audio,
        })
    }
}

/// Names of the folders in `folder`, sorted by their bytes, so in the same order everywhere.
fn folders(folder: &Path) -> Result<Vec<String>, Error> {
    if !folder.is_dir() {
        return Err(Error::MissingFolder {
            path: folder.to_owned(),
        });
    }
    let unreadable = |reason| Error::io("list", folder, reason);
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if !name.starts_with('.') && entry.path().is_dir() {
            names.push(name);
        }
    }
    names.sort_unstable();
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    /// Writes synthetic phrase `index` with `motion_frames` and `audio_frames` frames.
    fn write(folder: &Path, id: &str, motion_frames: usize, audio_frames: usize) {
        let phrase = synthetic::phrase(0, motion_frames.max(audio_frames), 1);
        npy::write_motion(
            &motion_path(folder, id),
            &phrase.motion.slice(0..motion_frames),
        )
        .unwrap();
        npz::write_features(
            &features_path(folder, id),
            &phrase.audio.slice(0..audio_frames),
        )
        .unwrap();
    }

    #[test]
    fn motion_and_audio_are_cut_to_their_common_length() {
        let folder = tempfile::tempdir().unwrap();
        for (motion, audio, noted) in [(9, 9, false), (9, 8, false), (7, 9, true), (9, 5, true)] {
            write(folder.path(), "a", motion, audio);
            let (phrase, note) = Phrase::load(folder.path(), "a").unwrap();
            let frames = motion.min(audio);
            assert_eq!((phrase.frames(), phrase.audio.frames()), (frames, frames));
            assert_eq!(note.is_some(), noted, "{motion} {audio}");
            let whole = synthetic::phrase(0, motion.max(audio), 1);
            assert_eq!(phrase.motion, whole.motion.slice(0..frames));
            assert_eq!(phrase.audio, whole.audio.slice(0..frames));
        }
    }

    #[test]
    fn numbers_that_are_not_finite_are_named_by_file_frame_and_channel() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "a", 9, 9);
        let good = synthetic::phrase(0, 9, 1);
        let mut motion = good.motion.clone();
        motion.frame_mut(4)[10] = f32::NAN;
        npy::write_motion(&motion_path(folder.path(), "a"), &motion).unwrap();
        let message = Phrase::load(folder.path(), "a").unwrap_err().to_string();
        assert!(
            message.contains("trajectory.npy: NaN in frame 4, channel quaternion.x"),
            "{message}"
        );

        npy::write_motion(&motion_path(folder.path(), "a"), &good.motion).unwrap();
        let mut audio = good.audio;
        audio.channel_mut(130)[7] = f32::NEG_INFINITY;
        let path = features_path(folder.path(), "a");
        npz::write_features(&path, &audio).unwrap();
        for message in [
            Phrase::load(folder.path(), "a").unwrap_err().to_string(),
            load_audio(&path).unwrap_err().to_string(),
        ] {
            assert!(
                message.contains("features.npz: -inf in frame 7, channel chroma[2]"),
                "{message}"
            );
        }
    }

    #[test]
    fn a_listing_pairs_the_folders() {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "motion/b",
            "motion/a",
            "motion/only",
            "motion/.hidden",
            "audio_features/a",
        ] {
            fs::create_dir_all(folder.path().join(name)).unwrap();
        }
        fs::create_dir_all(folder.path().join("audio_features/b")).unwrap();
        fs::create_dir_all(folder.path().join("audio_features/alone")).unwrap();
        fs::write(folder.path().join("motion/file"), b"").unwrap();
        let listing = Listing::read(folder.path()).unwrap();
        assert_eq!(listing.ids, ["a", "b"]);
        assert_eq!(listing.only_motion, ["only"]);
        assert_eq!(listing.only_audio, ["alone"]);
    }

    #[test]
    fn one_phrase_is_found_by_its_id_alone() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "a", 9, 9);
        let source = folder.path().display().to_string();
        assert_eq!(load_phrase(&source, "a").unwrap().frames(), 9);
        for id in ["b", "../a", "", "a/../a"] {
            let error = load_phrase(&source, id).unwrap_err();
            assert!(
                matches!(error, Error::UnknownPhrase { .. }),
                "{id}: {error}"
            );
        }
        let missing = load_phrase(&format!("{source}/no"), "a").unwrap_err();
        assert!(matches!(missing, Error::MissingFolder { .. }), "{missing}");
    }
}
