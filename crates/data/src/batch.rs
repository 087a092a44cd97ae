//! A batch: normalised motion, what it is conditioned on and a mask, as flat host arrays.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use kinegrad_motion::{CHANNELS, Motion, TrainingStatistics};

use crate::Phrase;
use crate::features::{AUDIO_CHANNELS, AudioFeatures};

/// Samples of one length. Flat arrays in row-major order.
///
/// | of | `channels` | `cond_channels` | `cond_frames` |
/// |---|---|---|---|
/// | phrases | 25 | 163, the audio features | `frames` |
/// | clips of HumanML3D | those asked for, of 263 | 512, the embedding of a caption | 1 |
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Normalised motion, `[batch_size, channels, frames]`; padding is zero.
    pub x_start: Vec<f32>,
    /// What each sample is conditioned on, as stored, `[batch_size, cond_channels, cond_frames]`;
    /// padding is zero, and so is all of it where there is no condition.
    pub cond: Vec<f32>,
    /// 1 in a valid frame, 0 in padding, `[batch_size, frames]`.
    pub mask: Vec<f32>,
    /// Id of each sample's phrase or clip, `[batch_size]`.
    pub ids: Vec<String>,
    /// Number of samples.
    pub batch_size: usize,
    /// Channels of the motion.
    pub channels: usize,
    /// Frames of each sample, padding included.
    pub frames: usize,
    /// Channels of the condition.
    pub cond_channels: usize,
    /// Frames of the condition: those of the sample, or 1 where it holds for all of them.
    pub cond_frames: usize,
}

/// The shape of a batch's samples.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    pub channels: usize,
    pub frames: usize,
    pub cond_channels: usize,
    pub cond_frames: usize,
}

impl Shape {
    /// That of phrases.
    pub fn of_phrases(frames: usize) -> Self {
        Self {
            channels: CHANNELS,
            frames,
            cond_channels: AUDIO_CHANNELS,
            cond_frames: frames,
        }
    }
}

impl Batch {
    /// An empty batch that takes samples of this `shape`.
    pub(crate) fn with_capacity(batch_size: usize, shape: Shape) -> Self {
        let Shape {
            channels,
            frames,
            cond_channels,
            cond_frames,
        } = shape;
        Self {
            x_start: Vec::with_capacity(batch_size * channels * frames),
            cond: Vec::with_capacity(batch_size * cond_channels * cond_frames),
            mask: Vec::with_capacity(batch_size * frames),
            ids: Vec::with_capacity(batch_size),
            batch_size: 0,
            channels,
            frames,
            cond_channels,
            cond_frames,
        }
    }

    /// Adds a sample of `frames` frames, at most those of the batch: a row for each channel of the
    /// motion, normalised, and one for each of the condition. What the rows lack is padding.
    pub(crate) fn push<M, C>(
        &mut self,
        id: &str,
        frames: usize,
        motion: impl Iterator<Item = M>,
        cond: impl Iterator<Item = C>,
    ) where
        M: IntoIterator<Item = f32>,
        C: IntoIterator<Item = f32>,
    {
        push_rows(&mut self.x_start, motion, self.frames);
        push_rows(&mut self.cond, cond, self.cond_frames);
        let end = self.mask.len() + self.frames;
        self.mask.resize(self.mask.len() + frames, 1.0);
        self.mask.resize(end, 0.0);
        self.ids.push(id.to_owned());
        self.batch_size += 1;
        debug_assert_eq!(
            (self.x_start.len(), self.cond.len()),
            (
                self.batch_size * self.channels * self.frames,
                self.batch_size * self.cond_channels * self.cond_frames
            )
        );
    }

    /// Adds a sample of a phrase. Both windows have the same length.
    pub(crate) fn push_phrase(
        &mut self,
        id: &str,
        motion: Window<Motion>,
        audio: Window<AudioFeatures>,
        statistics: &TrainingStatistics,
    ) {
        let rows = (0..CHANNELS).map(|channel| {
            statistics.normalize_channel(&motion.of, channel, motion.frames.clone())
        });
        let heard = (0..AUDIO_CHANNELS).map(|channel| {
            let row = &audio.of.channel(channel)[audio.frames.clone()];
            row.iter().copied()
        });
        self.push(id, motion.frames.len(), rows, heard);
    }
}

/// Appends `rows`, each padded to `length`.
fn push_rows<R: IntoIterator<Item = f32>>(
    values: &mut Vec<f32>,
    rows: impl Iterator<Item = R>,
    length: usize,
) {
    for row in rows {
        let end = values.len() + length;
        values.extend(row);
        values.resize(end, 0.0);
    }
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
    let mut batch = Batch::with_capacity(phrases.len(), Shape::of_phrases(target_frames));
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
        batch.push_phrase(&phrase.id, motion, audio, statistics);
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
        let condition = (batch.cond_channels, batch.cond_frames);
        assert_eq!((batch.channels, condition), (25, (163, 7)));
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
