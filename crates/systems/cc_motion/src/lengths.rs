//! Lengths of samples, within and beyond the training lengths.

use std::sync::Arc;

use kinegrad_data::PhraseItem;
use kinegrad_motion::OrientationEncoding;
use kinegrad_motion::stitch::Windows;
use kinegrad_train::config::Config;

use super::load::targets;

/// The first frames of a phrase, at most `longest` frames, as in validation.
pub(super) fn leading(phrase: &Arc<PhraseItem>, longest: usize) -> Arc<PhraseItem> {
    match phrase.frames() > longest {
        false => phrase.clone(),
        true => Arc::new(PhraseItem {
            id: phrase.id.clone(),
            motion: phrase.motion.slice(0..longest),
            audio: phrase.audio.slice(0..longest),
            label: phrase.label.clone(),
        }),
    }
}

/// The windows of the training length for a motion of `frames` frames. `None` if the motion is not
/// longer, or if each sample is relative to its first heading, because such windows cannot be
/// joined.
pub(super) fn windows(config: &Config, frames: usize) -> Option<Windows> {
    let longest = config.data.target_frames;
    let fit = targets(config).orientation != OrientationEncoding::CanonicalQuaternion;
    (fit && frames > longest).then(|| Windows::new(frames, longest))
}

/// A warning if lengths `frames` of windows or samples are outside the training range.
pub(super) fn untrained(
    config: &Config,
    frames: impl IntoIterator<Item = usize>,
) -> Option<String> {
    let data = &config.data;
    let longest = data.target_frames;
    let shortest = data.augment.min_frames.unwrap_or(0);
    let frames: Vec<usize> = frames.into_iter().collect();
    let other = frames
        .iter()
        .filter(|frames| !(shortest..=longest).contains(*frames));
    let (least, most) = (other.clone().min()?, other.clone().max()?);
    let trained = match shortest {
        0 => format!("at most {longest} frames"),
        _ => format!("{shortest} to {longest} frames"),
    };
    let sampled = match least == most {
        true => format!("{most} frames"),
        false => format!("{least} to {most} frames"),
    };
    Some(format!(
        "{} of {} samples are of {sampled}, and training saw {trained} (`data.target_frames`, \
         `data.augment.min_frames`): samples of other lengths are worse",
        other.count(),
        frames.len()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CcMotion;
    use kinegrad_train::Systems;

    const SYSTEMS: Systems<'static> = Systems(&[&CcMotion]);

    #[test]
    fn lengths_outside_training_cause_a_warning() {
        let mut config = SYSTEMS
            .parse("", "c.toml", &["data.target_frames=60".to_string()])
            .expect("a config");
        assert_eq!(untrained(&config, [60, 59, 4]), None);
        let warning = untrained(&config, [60, 90, 61]).unwrap();
        assert!(
            warning.starts_with("2 of 3 samples are of 61 to 90 frames"),
            "{warning}"
        );
        assert!(warning.contains("saw at most 60 frames"), "{warning}");
        config.data.augment.min_frames = Some(30);
        let warning = untrained(&config, [30, 29]).unwrap();
        assert!(
            warning.starts_with("1 of 2 samples are of 29 frames"),
            "{warning}"
        );
        assert!(warning.contains("saw 30 to 60 frames"), "{warning}");
    }

    #[test]
    fn longer_samples_use_windows_of_the_training_length() {
        let windows_of = |frames, target: &str| {
            let overrides = ["data.target_frames=60", target].map(String::from);
            let config = SYSTEMS.parse("", "c.toml", &overrides).expect("a config");
            windows(&config, frames)
        };
        let plain = "model.orientation_target=rotation_6d";
        assert_eq!(
            [1, 60].map(|frames| windows_of(frames, plain)),
            [None, None]
        );
        let two = windows_of(61, plain).expect("windows");
        assert_eq!((two.len(), two.length(), two.frames()), (2, 60, 61));
        let headings = "model.orientation_target=canonical_quaternion";
        assert_eq!(windows_of(61, headings), None);
    }
}
