//! Lengths that a model was trained on, and those that it was not.

use std::sync::Arc;

use kinegrad_data::{DataConfig, Phrase};

/// The first frames of a phrase, at most `longest`: as validation has it.
pub(super) fn leading(phrase: &Arc<Phrase>, longest: usize) -> Arc<Phrase> {
    match phrase.frames() > longest {
        false => phrase.clone(),
        true => Arc::new(Phrase {
            id: phrase.id.clone(),
            motion: phrase.motion.slice(0..longest),
            audio: phrase.audio.slice(0..longest),
            label: phrase.label.clone(),
        }),
    }
}

/// A sentence on those of the `frames` of samples that training with `data` did not show, if there
/// are any: longer than its crops, or shorter than the shortest of them.
pub(super) fn untrained(
    data: &DataConfig,
    frames: impl IntoIterator<Item = usize>,
) -> Option<String> {
    let longest = data.target_frames;
    let shortest = data.augment.min_frames.unwrap_or(0);
    let frames: Vec<usize> = frames.into_iter().collect();
    let other = frames
        .iter()
        .filter(|frames| !(shortest..=longest).contains(*frames));
    let other: Vec<usize> = other.copied().collect();
    let (least, most) = (other.iter().min()?, other.iter().max()?);
    let trained = match shortest {
        0 => format!("at most {longest} frames"),
        _ => format!("{shortest} to {longest} frames"),
    };
    let drawn = match least == most {
        true => format!("{most} frames"),
        false => format!("{least} to {most} frames"),
    };
    Some(format!(
        "{} of {} samples are of {drawn}, and training saw {trained} (`data.target_frames`, \
         `data.augment.min_frames`): what is drawn at other lengths is less than what the model \
         can do",
        other.len(),
        frames.len()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_lengths_that_training_did_not_show_are_told() {
        let mut data = DataConfig {
            target_frames: 60,
            ..DataConfig::default()
        };
        assert_eq!(untrained(&data, [60, 59, 4]), None);
        let told = untrained(&data, [60, 90, 61]).unwrap();
        assert!(
            told.starts_with("2 of 3 samples are of 61 to 90 frames"),
            "{told}"
        );
        assert!(told.contains("saw at most 60 frames"), "{told}");
        data.augment.min_frames = Some(30);
        let told = untrained(&data, [30, 29]).unwrap();
        assert!(
            told.starts_with("1 of 2 samples are of 29 frames"),
            "{told}"
        );
        assert!(told.contains("saw 30 to 60 frames"), "{told}");
    }
}
