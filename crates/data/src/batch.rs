//! A batch: normalised motion, audio features and a mask, as flat host arrays.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use kinegrad_motion::{CHANNELS, Motion, TrainingStatistics};

use crate::Phrase;
use crate::features::{AUDIO_CHANNELS, AudioFeatures};

/// Samples of one length. Flat arrays in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Normalised motion, `[batch_size, 25, frames]`; padding is zero.
    pub x_start: Vec<f32>,
    /// Audio features as stored, `[batch_size, 163, frames]`; padding is zero.
    pub cond: Vec<f32>,
    /// 1 in a valid frame, 0 in padding, `[batch_size, frames]`.
    pub mask: Vec<f32>,
    /// Id of each sample's phrase, `[batch_size]`.
    pub ids: Vec<String>,
    /// Number of samples.
    pub batch_size: usize,
    /// Frames of each sample, padding included.
    pub frames: usize,
}

impl Batch {
    /// An empty batch that takes samples of `frames` frames.
    pub(crate) fn with_capacity(batch_size: usize, frames: usize) -> Self {
        Self {
            x_start: Vec::with_capacity(batch_size * CHANNELS * frames),
            cond: Vec::with_capacity(batch_size * AUDIO_CHANNELS * frames),
            mask: Vec::with_capacity(batch_size * frames),
            ids: Vec::with_capacity(batch_size),
            batch_size: 0,
            frames,
        }
    }

    /// Adds a sample, normalised and padded. Both windows have the same length, at most that of
    /// the batch.
    pub(crate) fn push(
        &mut self,
        id: &str,
        motion: Window<Motion>,
        audio: Window<AudioFeatures>,
        statistics: &TrainingStatistics,
    ) {
        let padding = self.frames - motion.frames.len();
        for channel in 0..CHANNELS {
            let range = motion.frames.clone();
            let row = statistics.normalize_channel(&motion.of, channel, range);
            self.x_start.extend(row);
            pad(&mut self.x_start, padding);
        }
        for channel in 0..AUDIO_CHANNELS {
            let row = &audio.of.channel(channel)[audio.frames.clone()];
            self.cond.extend_from_slice(row);
            pad(&mut self.cond, padding);
        }
        self.mask.resize(self.mask.len() + motion.frames.len(), 1.0);
        pad(&mut self.mask, padding);
        self.ids.push(id.to_owned());
        self.batch_size += 1;
    }
}

fn pad(row: &mut Vec<f32>, padding: usize) {
    row.resize(row.len() + padding, 0.0);
}

/// Some frames of motion or audio, which is copied only where it was changed.
#[derive(Clone, Debug)]
pub(crate) struct Window<'a, T: Clone> {
    /// What they are frames of.
    pub of: Cow<'a, T>,
    /// Which.
    pub frames: Range<usize>,
}

/// The phrases as one batch of `target_frames` frames, in their order: leading crop, padding, no
/// augmentation.
pub fn collate_validation(
    phrases: &[Arc<Phrase>],
    statistics: &TrainingStatistics,
    target_frames: usize,
) -> Batch {
    let mut batch = Batch::with_capacity(phrases.len(), target_frames);
    for phrase in phrases {
        let frames = 0..phrase.frames().min(target_frames);
        let motion = Window {
            of: Cow::Borrowed(&phrase.motion),
            frames: frames.clone(),
        };
        let audio = Window {
            of: Cow::Borrowed(&phrase.audio),
            frames,
        };
        batch.push(&phrase.id, motion, audio, statistics);
    }
    batch
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    #[test]
    fn phrases_are_cut_padded_and_masked() {
        let phrases: Vec<Arc<Phrase>> = [9, 5]
            .iter()
            .map(|&frames| Arc::new(synthetic::phrase(frames, frames, 2)))
            .collect();
        let statistics =
            TrainingStatistics::compute(phrases.iter().map(|phrase| &phrase.motion)).unwrap();
        let batch = collate_validation(&phrases, &statistics, 7);
        assert_eq!((batch.batch_size, batch.frames), (2, 7));
        assert_eq!(batch.ids, ["synthetic_00009", "synthetic_00005"]);
        assert_eq!(batch.mask[..7], [1.0; 7]);
        assert_eq!(batch.mask[7..], [1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0]);
        let mut varied = 0;
        for (sample, phrase) in phrases.iter().enumerate() {
            let whole = statistics.normalize_motion(&phrase.motion);
            for t in 0..7 {
                for channel in 0..CHANNELS {
                    let found = batch.x_start[(sample * CHANNELS + channel) * 7 + t];
                    let expected = match t < phrase.frames() {
                        true => whole[channel * phrase.frames() + t],
                        false => 0.0,
                    };
                    assert_eq!(
                        found, expected,
                        "sample {sample}, frame {t}, channel {channel}"
                    );
                    varied += usize::from(found != 0.0);
                }
                for channel in 0..AUDIO_CHANNELS {
                    let found = batch.cond[(sample * AUDIO_CHANNELS + channel) * 7 + t];
                    assert_eq!(
                        found,
                        phrase.audio.channel(channel).get(t).copied().unwrap_or(0.0)
                    );
                }
            }
        }
        assert!(varied > 200, "{varied}");
        assert_eq!(batch.x_start.len(), 2 * CHANNELS * 7);
        assert_eq!(batch.cond.len(), 2 * AUDIO_CHANNELS * 7);
    }

    #[test]
    fn no_phrases_make_an_empty_batch() {
        let statistics = TrainingStatistics::compute([&synthetic::phrase(0, 9, 2).motion]).unwrap();
        let batch = collate_validation(&[], &statistics, 7);
        assert_eq!((batch.batch_size, batch.x_start.len()), (0, 0));
    }
}
