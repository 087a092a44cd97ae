//! One phrase: motion and music, read from the dataset's layout.

use std::path::Path;

use kinegrad_motion::{CHANNELS, FPS, Phrase, channel_name};
use kinegrad_settings::counted;

use crate::audio_layout::AudioLayout;
use crate::features::{AudioFeatures, audio_channel_name};
use crate::file::read_file;
use crate::magnitude::first_unusable;
use crate::{FileError, npy, npz};

/// A phrase: motion `[frames, 25]` and audio features `[channels, frames]` over the same frames.
#[derive(Clone, Debug, PartialEq)]
pub struct PhraseItem {
    /// Id of the phrase, also the name of its folders.
    pub id: String,
    /// Motion in the dataset's units.
    pub motion: Phrase,
    /// Audio features as stored.
    pub audio: AudioFeatures,
    /// The phrase's label, such as the dance style.
    pub label: Option<String>,
}

impl PhraseItem {
    /// Parses a phrase with audio features of `layout` from the bytes and names of its files, and
    /// cuts both files to their common length (CC-MotionGen, section 6.1). Also returns a note if
    /// the lengths differ by more than a frame.
    pub(crate) fn parse(
        id: &str,
        (motion, name): (&[u8], &str),
        (audio, audio_name): (&[u8], &str),
        layout: AudioLayout,
    ) -> Result<(Self, Option<String>), FileError> {
        let mut motion = npy::parse_motion(motion, name)?;
        if let Some(place) = first_unusable(motion.as_slice()) {
            let (frame, channel) = (place / CHANNELS, place % CHANNELS);
            let value = motion.frame(frame)[channel];
            let channel = channel_name(channel);
            return Err(FileError::not_usable(name, frame, channel, value));
        }
        let mut features = npz::parse_features(audio, audio_name, layout)?;
        check_usable(&features, audio_name)?;
        let (motion_frames, audio_frames) = (motion.frames(), features.frames());
        let frames = motion_frames.min(audio_frames);
        let note = (motion_frames.abs_diff(audio_frames) > 1).then(|| {
            format!(
                "motion has {}, audio {audio_frames}: the first {frames} \
                 ({:.2} s) are used",
                counted(motion_frames, "frame"),
                frames as f64 / FPS
            )
        });
        if motion_frames > frames {
            motion = motion.slice(0..frames);
        }
        if audio_frames > frames {
            features = features.slice(0..frames);
        }
        let phrase = Self {
            id: id.to_owned(),
            motion,
            audio: features,
            label: None,
        };
        Ok((phrase, note))
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.motion.frames()
    }
}

/// Reads the audio features `[channels, frames]` of a `features.npz`. Fails with [`FileError`] for
/// an unusable file, and for a value that is not finite or exceeds [`LARGEST`](crate::LARGEST).
pub fn load_audio(path: &Path, layout: AudioLayout) -> Result<AudioFeatures, FileError> {
    let bytes = read_file(path, npz::MAX_FEATURES_BYTES).map_err(FileError::read(path))?;
    let file = path.display().to_string();
    let audio = npz::parse_features(&bytes, &file, layout)?;
    check_usable(&audio, &file)?;
    Ok(audio)
}

fn check_usable(audio: &AudioFeatures, file: &str) -> Result<(), FileError> {
    let Some((frame, channel)) = audio.first_unusable() else {
        return Ok(());
    };
    let value = audio.channel(channel)[frame];
    let channel = audio_channel_name(channel);
    Err(FileError::not_usable(file, frame, channel, value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    /// The files of a synthetic phrase, cut to these frame counts.
    fn files(phrase: &PhraseItem, motion_frames: usize, audio_frames: usize) -> (Vec<u8>, Vec<u8>) {
        (
            npy::motion_bytes(&phrase.motion.slice(0..motion_frames)),
            npz::features_bytes(&phrase.audio.slice(0..audio_frames)),
        )
    }

    fn parse(motion: &[u8], audio: &[u8]) -> Result<(PhraseItem, Option<String>), FileError> {
        let layout = AudioLayout::CCMOTION;
        PhraseItem::parse(
            "a",
            (motion, "trajectory.npy"),
            (audio, "features.npz"),
            layout,
        )
    }

    #[test]
    fn motion_and_audio_are_cut_to_their_common_length() {
        for (motion, audio, noted) in [(9, 9, false), (9, 8, false), (7, 9, true), (9, 5, true)] {
            let whole = synthetic::phrase(0, motion.max(audio), 1);
            let (motion_file, audio_file) = files(&whole, motion, audio);
            let (phrase, note) = parse(&motion_file, &audio_file).unwrap();
            let frames = motion.min(audio);
            assert_eq!((phrase.frames(), phrase.audio.frames()), (frames, frames));
            assert_eq!(note.is_some(), noted, "{motion} {audio}");
            assert_eq!(phrase.motion, whole.motion.slice(0..frames));
            assert_eq!(phrase.audio, whole.audio.slice(0..frames));
        }
    }

    #[test]
    fn numbers_too_large_to_train_on_are_named_with_what_is_allowed() {
        let mut bad = synthetic::phrase(0, 9, 1);
        bad.motion.frame_mut(2)[0] = -1e30;
        let (motion, audio) = files(&bad, 9, 9);
        let message = parse(&motion, &audio).unwrap_err().to_string();
        let expected = "in frame 2, channel position.x; numbers from -1e6 to 1e6 allowed";
        assert!(message.contains(expected), "{message}");
        bad.motion.frame_mut(2)[0] = 1e6;
        bad.audio.channel_mut(0)[1] = 1e19;
        let (motion, audio) = files(&bad, 9, 9);
        let message = parse(&motion, &audio).unwrap_err().to_string();
        assert!(message.contains("features.npz: 1"), "{message}");
        assert!(
            message.contains("channel mel[0]; numbers from"),
            "{message}"
        );
    }

    #[test]
    fn beat_features_are_read_if_configured_and_named_if_missing() {
        let made = synthetic::phrase(0, 9, 1);
        let pulse = kinegrad_audio::Pulse::new(vec![0.0, 0.1, 0.2]).unwrap();
        let audio_with_beats = made.audio.with_beats(Some(&pulse));
        let motion = npy::motion_bytes(&made.motion);
        let parse = |audio: &[u8], layout| {
            let names = ("trajectory.npy", "features.npz");
            PhraseItem::parse("a", (&motion, names.0), (audio, names.1), layout)
        };
        let stored = npz::features_bytes(&audio_with_beats);
        let with = parse(&stored, AudioLayout::WITH_BEATS).unwrap().0;
        assert_eq!(with.audio, audio_with_beats);
        let without = parse(&stored, AudioLayout::CCMOTION).unwrap().0;
        assert_eq!(without.audio, made.audio);
        let lacking = npz::features_bytes(&made.audio);
        let error = parse(&lacking, AudioLayout::WITH_BEATS).unwrap_err();
        let message = error.to_string();
        assert!(message.contains("array `beats` is missing"), "{message}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_named_by_file_frame_and_channel() {
        let good = synthetic::phrase(0, 9, 1);
        let mut bad = good.clone();
        bad.motion.frame_mut(4)[10] = f32::NAN;
        let (motion, audio) = files(&bad, 9, 9);
        let message = parse(&motion, &audio).unwrap_err().to_string();
        assert!(
            message.contains("trajectory.npy: NaN in frame 4, channel quaternion.x"),
            "{message}"
        );

        let mut bad = good;
        bad.audio.channel_mut(130)[7] = f32::NEG_INFINITY;
        let (motion, audio) = files(&bad, 9, 9);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("features.npz");
        npz::write_features(&path, &bad.audio).unwrap();
        for message in [
            parse(&motion, &audio).unwrap_err().to_string(),
            load_audio(&path, AudioLayout::CCMOTION)
                .unwrap_err()
                .to_string(),
        ] {
            assert!(
                message.contains("features.npz: -inf in frame 7, channel chroma[2]"),
                "{message}"
            );
        }
    }
}
