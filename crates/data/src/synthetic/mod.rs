//! Synthetic phrases: dances that follow a beat, with matching audio features.
//!
//! A phrase has a tempo, a position in the bar, an energy, and one of four moves for each bar. Both
//! the [features](music) and the [motion](dance) show these properties, so a small model gains from
//! audio. Motion is smooth, of human scale and coherent by construction. Seed and index determine
//! everything.

mod dance;
mod music;
mod style;

use std::path::Path;
use std::sync::Arc;

use kinegrad_output::UnfinishedFolder;
use kinegrad_random::{Key, Purpose};
use rayon::prelude::*;

use crate::{
    AudioLayout, Error, PhraseItem, SyntheticConfig, features_path, motion_path, write_features,
    write_motion,
};
use music::Music;

/// Id of synthetic phrase number `index`: `synthetic_00007`.
pub fn id(index: usize) -> String {
    format!("synthetic_{index:05}")
}

/// Phrase number `index` of this `seed`: `frames` frames at 30 frames per second. Panics if
/// `frames` is zero.
pub fn phrase(index: usize, frames: usize, seed: u64) -> PhraseItem {
    phrase_in(AudioLayout::CCMOTION, index, frames, seed)
}

/// [`phrase`] with audio features in `layout`. Panics if `frames` is zero.
pub fn phrase_in(layout: AudioLayout, index: usize, frames: usize, seed: u64) -> PhraseItem {
    let key = Key::new(seed, Purpose::Synthetic).at(index as u64);
    let music = Music::new(key);
    let audio = music.features(frames, key);
    PhraseItem {
        id: id(index),
        motion: dance::perform(&music, key, frames),
        audio: match layout.beats {
            true => audio.with_beats(music.pulse(frames).as_ref()),
            false => audio,
        },
        label: None,
    }
}

/// The first `phrases` phrases of this `seed`, created in parallel. Panics if `frames` is zero.
pub fn phrases(phrases: usize, frames: usize, seed: u64) -> Vec<Arc<PhraseItem>> {
    (0..phrases)
        .into_par_iter()
        .map(|index| Arc::new(phrase(index, frames, seed)))
        .collect()
}

/// Atomically writes a synthetic dataset into `folder` in the phrase layout (CC-MotionGen, section
/// 1.3), with audio features in `layout`. Fails with [`Error::Config`] for sizes out of range,
/// [`Error::Exists`] if `folder` contains a dataset, [`Error::Io`].
pub fn write_dataset(
    folder: &Path,
    layout: AudioLayout,
    phrases: usize,
    frames: usize,
    seed: u64,
) -> Result<(), Error> {
    let config = SyntheticConfig {
        phrases,
        frames,
        seed,
    };
    config.validate()?;
    write_whole(folder, &["audio_features", "motion"], |staging| {
        (0..phrases).into_par_iter().try_for_each(|index| {
            let phrase = phrase_in(layout, index, frames, seed);
            write_motion(&staging.join(motion_path(&phrase.id)), &phrase.motion)?;
            write_features(&staging.join(features_path(&phrase.id)), &phrase.audio)
        })
    })
}

/// Writes the `parts` of a dataset into `folder`: `fill` writes them to a temporary folder inside,
/// and complete parts are moved. Fails with [`Error::Exists`] if a part exists, [`Error::Io`], and
/// the errors of `fill`.
pub(crate) fn write_whole(
    folder: &Path,
    parts: &[&str],
    fill: impl FnOnce(&Path) -> Result<(), Error>,
) -> Result<(), Error> {
    if parts.iter().any(|part| folder.join(part).exists()) {
        return Err(Error::Exists(folder.to_owned()));
    }
    let failed = |reason| Error::io("write", folder, reason);
    let staging = UnfinishedFolder::within(folder).map_err(failed)?;
    fill(staging.path())?;
    staging.move_into(folder).map_err(failed)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use kinegrad_motion::phrase::{ACCELERATION, PHASE, POSITION, QUATERNION, STYLE, VELOCITY};
    use kinegrad_motion::{FPS, Profile, check, derivatives, phrase_statistics};

    #[test]
    fn phrases_pass_the_strict_checks_and_are_of_human_scale() {
        for (frames, seed) in [(120, 0), (120, 1), (40, 2), (300, 3)] {
            let made = phrases(64, frames, seed);
            let statistics = phrase_statistics(made.iter().map(|phrase| &phrase.motion)).unwrap();
            for phrase in &made {
                for profile in [Profile::Ccmotion, Profile::Strict] {
                    let report = check(&phrase.motion, profile, Some(&statistics));
                    assert!(report.passed, "{}: {report:#?}", phrase.id);
                }
                let own = phrase_statistics([&phrase.motion]).unwrap();
                let (speed, jerk) = (own.rms_speed.unwrap(), own.jerk_p95.unwrap());
                assert!((0.25..1.5).contains(&speed), "{}: {speed}", phrase.id);
                assert!(jerk < 200.0, "{}: jerk {jerk}", phrase.id);
                let [min, max] = own.range.unwrap();
                assert!(min[POSITION.start + 1] > 0.6 && max[POSITION.start + 1] < 1.4);
            }
            let speed = statistics.rms_speed.unwrap();
            assert!((0.3..1.5).contains(&speed), "{speed}");
            let [min, max] = statistics.range.unwrap();
            for channel in 0..25 {
                assert!(max[channel] > min[channel], "channel {channel}");
            }
        }
    }

    #[test]
    fn derivatives_are_the_differences_up_to_the_last_frame() {
        for index in 0..16 {
            let motion = phrase(index, 120, 4).motion;
            for t in 0..119 {
                for (explicit, base) in [(VELOCITY, POSITION), (ACCELERATION, VELOCITY)] {
                    for axis in 0..3 {
                        let (now, then) = (motion.frame(t), motion.frame(t + 1));
                        let place = base.start + axis;
                        let derived = FPS * (f64::from(then[place]) - f64::from(now[place]));
                        let error = f64::from(now[explicit.start + axis]) - derived;
                        assert!(error.abs() < 1e-3, "phrase {index}, frame {t}: {error}");
                    }
                }
            }
            // The forward differences of the last frame use a further frame, so the last frame does
            // not stand still.
            let jerk = derivatives::jerk(&motion);
            assert!(jerk[118].iter().map(|value| value.powi(2)).sum::<f64>() < 1000f64.powi(2));
            assert!(motion.vector(119, ACCELERATION) != motion.vector(118, ACCELERATION));
        }
    }

    #[test]
    fn phrases_start_at_the_origin_and_wrap_their_phase() {
        for index in 0..16 {
            let motion = phrase(index, 240, 4).motion;
            let [x, _, z] = motion.vector(0, POSITION);
            assert_eq!((x, z), (0.0, 0.0));
            let phase: Vec<f32> = (0..240).map(|t| motion.frame(t)[PHASE]).collect();
            let wraps = phase.windows(2).filter(|pair| pair[1] < pair[0]).count();
            // The phrase has 8 seconds at 84 to 132 beats per minute.
            assert!((2..=5).contains(&wraps), "{wraps}");
            let quaternion = &motion.frame(0)[QUATERNION];
            assert!(quaternion[0] > 0.0);
        }
    }

    #[test]
    fn phrases_differ_by_number_and_by_seed_and_by_nothing_else() {
        let one = phrase(0, 60, 0);
        assert_eq!(one, phrase(0, 60, 0));
        for other in [phrase(1, 60, 0), phrase(0, 60, 1)] {
            assert_ne!(one.motion, other.motion);
            assert_ne!(one.audio, other.audio);
        }
    }

    #[test]
    fn beat_features_agree_with_the_phase_and_leave_the_rest_alone() {
        for index in 0..8 {
            let with_beats = phrase_in(AudioLayout::WITH_BEATS, index, 90, 4);
            let plain = phrase(index, 90, 4);
            assert_eq!(with_beats.motion, plain.motion);
            assert_eq!(with_beats.audio.channels(), 170);
            assert_eq!(
                with_beats.audio.slice(5..6).as_slice()[..163],
                *plain.audio.slice(5..6).as_slice()
            );
            for t in 0..90 {
                let phase = std::f64::consts::TAU * f64::from(plain.motion.frame(t)[PHASE]);
                for (channel, expected) in [
                    (163, (4.0 * phase).sin()),
                    (164, (4.0 * phase).cos()),
                    (165, phase.sin()),
                    (166, phase.cos()),
                    (167, 1.0),
                ] {
                    let found = f64::from(with_beats.audio.channel(channel)[t]);
                    assert!(
                        (found - expected).abs() < 1e-3,
                        "{channel} {t}: {found} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn style_follows_the_motion() {
        let motion = phrase(0, 120, 0).motion;
        let speed = |t: usize| kinegrad_motion::vector::length(motion.vector(t, VELOCITY));
        let mean = (45..76).map(speed).sum::<f64>() / 31.0;
        let style = f64::from(motion.frame(60)[STYLE.start]);
        assert!((style - mean).abs() < 0.05, "{style} {mean}");
        let step = (1..120)
            .map(|t| (motion.frame(t)[STYLE.start] - motion.frame(t - 1)[STYLE.start]).abs())
            .fold(0.0, f32::max);
        assert!(step < 0.1, "style changes gradually: {step}");
    }

    #[test]
    fn a_dataset_is_written_whole_and_never_over_another() {
        let folder = tempfile::tempdir().unwrap();
        write_dataset(folder.path(), AudioLayout::CCMOTION, 3, 8, 1).unwrap();
        let mut names: Vec<String> = fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort_unstable();
        assert_eq!(names, ["audio_features", "motion"]);
        let again = write_dataset(folder.path(), AudioLayout::CCMOTION, 3, 8, 1).unwrap_err();
        assert!(matches!(again, Error::Exists(_)), "{again}");
        let empty =
            write_dataset(&folder.path().join("new"), AudioLayout::CCMOTION, 0, 8, 1).unwrap_err();
        assert!(matches!(empty, Error::Config(_)), "{empty}");
        assert!(!folder.path().join("new").exists());
    }
}
