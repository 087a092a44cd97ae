//! A batch: normalized motion, conditions and a mask, as flat host arrays.

use std::ops::Range;

use kinegrad_motion::Statistics;

/// Name of the condition on audio features, `[163, frames]`, or 170 with beats.
pub const AUDIO: &str = "audio";

/// Name of the text condition, a pooled text feature `[512, 1]`.
pub const TEXT: &str = "text";

/// Name of the condition on a caption's words, `[width + 1, words]`. Each column is a word's vector
/// and the index of its part of speech plus 1, or 0 without a word.
pub const WORDS: &str = "words";

/// Name of the number `[1, 1]` that is equal for clips with the same captions.
pub const CAPTIONS: &str = "captions";

/// Samples of one length. Flat arrays in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Normalized motion, `[batch_size, channels, frames]`; padding is zero.
    pub x_start: Vec<f32>,
    /// Conditions of the samples.
    pub conditions: Vec<Condition>,
    /// 1 in a valid frame, 0 in padding, `[batch_size, frames]`.
    pub mask: Vec<f32>,
    /// Id of each sample's item, `[batch_size]`.
    pub ids: Vec<String>,
    /// Number of samples.
    pub batch_size: usize,
    /// Channels of the motion.
    pub channels: usize,
    /// Frames of each sample, padding included.
    pub frames: usize,
}

/// One condition of the samples of a batch.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    /// Its name, such as [`AUDIO`].
    pub name: &'static str,
    /// Values as stored, `[batch_size, channels, frames]`; padding and missing conditions are zero.
    pub values: Vec<f32>,
    /// Its channels.
    pub channels: usize,
    /// Frames of the sample, or 1 for a condition on the whole sample.
    pub frames: usize,
}

/// One condition of one sample: a frame range of each channel.
#[derive(Clone, Debug)]
pub struct ConditionRows<'a> {
    /// `[channels, frames]`.
    pub values: &'a [f32],
    /// Frames of each channel.
    pub frames: usize,
    /// The frames that belong to the sample.
    pub range: Range<usize>,
}

impl<'a> ConditionRows<'a> {
    /// All `frames` of `values`, `[channels, frames]`.
    pub fn all(values: &'a [f32], frames: usize) -> Self {
        Self {
            values,
            frames,
            range: 0..frames,
        }
    }
}

/// The shape of a batch's samples.
#[derive(Clone, Debug)]
pub struct SampleShape {
    /// Channels of the motion.
    pub channels: usize,
    /// Frames, padding included.
    pub frames: usize,
    /// Name, channels and frames of each condition.
    pub conditions: Vec<(&'static str, usize, usize)>,
}

impl Batch {
    /// An empty batch with room for `batch_size` samples of this `shape`.
    pub fn with_capacity(batch_size: usize, shape: &SampleShape) -> Self {
        let values = |channels, frames| Vec::with_capacity(batch_size * channels * frames);
        let condition = |&(name, channels, frames): &(&'static str, usize, usize)| Condition {
            name,
            values: values(channels, frames),
            channels,
            frames,
        };
        Self {
            x_start: values(shape.channels, shape.frames),
            conditions: shape.conditions.iter().map(condition).collect(),
            mask: values(1, shape.frames),
            ids: Vec::with_capacity(batch_size),
            batch_size: 0,
            channels: shape.channels,
            frames: shape.frames,
        }
    }

    /// Adds a sample from motion `rows`, no longer than the batch, and the rows of each condition.
    /// The batch's channels are normalized; missing frames are padded.
    pub fn push(
        &mut self,
        id: &str,
        rows: &[f32],
        statistics: &Statistics,
        conditions: &[ConditionRows],
    ) {
        let frames = rows.len() / statistics.channels();
        for channel in 0..self.channels {
            let end = self.x_start.len() + self.frames;
            self.x_start
                .extend(statistics.normalize_channel(rows, channel));
            self.x_start.resize(end, 0.0);
        }
        assert_eq!(conditions.len(), self.conditions.len(), "conditions");
        for (condition, rows) in self.conditions.iter_mut().zip(conditions) {
            for row in rows.values.chunks_exact(rows.frames) {
                let end = condition.values.len() + condition.frames;
                condition.values.extend_from_slice(&row[rows.range.clone()]);
                condition.values.resize(end, 0.0);
            }
        }
        let end = self.mask.len() + self.frames;
        self.mask.resize(self.mask.len() + frames, 1.0);
        self.mask.resize(end, 0.0);
        self.ids.push(id.to_owned());
        self.batch_size += 1;
    }

    /// The condition of that name.
    pub fn condition(&self, name: &str) -> Option<&Condition> {
        let mut conditions = self.conditions.iter();
        conditions.find(|condition| condition.name == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_normalised_padded_and_masked() {
        let shape = SampleShape {
            channels: 2,
            frames: 4,
            conditions: vec![(AUDIO, 2, 4), (TEXT, 3, 1)],
        };
        // The statistics have three channels; the batch uses two.
        let mut statistics = Statistics::unit(3);
        (statistics.mean[1], statistics.std[1]) = (1.0, 2.0);
        let mut batch = Batch::with_capacity(2, &shape);
        let audio: Vec<f32> = (0..10u8).map(f32::from).collect();
        for (id, frames) in [("a", 4), ("b", 3)] {
            let rows: Vec<f32> = (0..3 * frames).map(|i| i as f32).collect();
            let audio = ConditionRows {
                values: &audio,
                frames: 5,
                range: 1..1 + frames as usize,
            };
            let text = ConditionRows::all(&[7.0, 8.0, 9.0], 1);
            batch.push(id, &rows, &statistics, &[audio, text]);
        }
        assert_eq!((batch.batch_size, batch.frames), (2, 4));
        assert_eq!(batch.ids, ["a", "b"]);
        let first = [0.0, 3.0, 6.0, 9.0, 0.0, 1.5, 3.0, 4.5];
        let second = [0.0, 3.0, 6.0, 0.0, 0.0, 1.5, 3.0, 0.0];
        assert_eq!(batch.x_start, [first, second].concat());
        assert_eq!(batch.mask, [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
        let audio = batch.condition(AUDIO).unwrap();
        let first = [1.0, 2.0, 3.0, 4.0, 6.0, 7.0, 8.0, 9.0];
        let second = [1.0, 2.0, 3.0, 0.0, 6.0, 7.0, 8.0, 0.0];
        assert_eq!(audio.values, [first, second].concat());
        let text = batch.condition(TEXT).unwrap();
        assert_eq!(text.values, [7.0, 8.0, 9.0, 7.0, 8.0, 9.0]);
        assert!(batch.condition("style").is_none());
    }
}
