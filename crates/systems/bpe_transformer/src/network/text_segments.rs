//! A sequence of texts in one motion.

use std::ops::Range;
use std::sync::Arc;

use burn::tensor::{Device, Int, Tensor, TensorData};
use kinegrad_kernels::KeyRanges;

/// A segment of frames with one text.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct Segment {
    /// Row of the segment's text in the batch's texts.
    pub text: usize,
    /// Length of the segment, at least one frame.
    pub frames: usize,
}

/// The texts of a batch of motions; each motion has one sequence without overlaps.
///
/// The padding of a motion with a single text continues text and positions. With several texts, the
/// padding has no text. Valid frames do not depend on the padding.
#[derive(Clone, Debug, PartialEq)]
pub struct TextSegments(Arc<[Vec<Segment>]>);

impl TextSegments {
    /// The segments of each motion.
    ///
    /// # Panics
    /// For a motion without a segment, or a segment without a frame.
    pub fn new(motions: impl IntoIterator<Item = Vec<Segment>>) -> Self {
        let motions: Arc<[Vec<Segment>]> = motions.into_iter().collect();
        let valid = |motion: &Vec<Segment>| {
            !motion.is_empty() && motion.iter().all(|segment| segment.frames > 0)
        };
        assert!(motions.iter().all(valid), "segments of a frame or more");
        Self(motions)
    }

    /// One text for each motion.
    pub fn single(frames: impl IntoIterator<Item = usize>) -> Self {
        let motions = frames.into_iter().enumerate();
        Self::new(motions.map(|(text, frames)| vec![Segment { text, frames }]))
    }

    /// Number of motions.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// True if there is no motion.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Valid frames of each motion.
    pub fn frames(&self) -> impl Iterator<Item = usize> {
        let frames = |motion: &Vec<Segment>| motion.iter().map(|segment| segment.frames).sum();
        self.0.iter().map(frames)
    }

    /// The range of the segment of each of `time` frames; `None` for padding.
    fn of(&self, motion: usize, time: usize) -> Vec<Option<Range<usize>>> {
        let mut frames = Vec::with_capacity(time);
        for segment in &self.0[motion] {
            let range = frames.len()..frames.len() + segment.frames;
            frames.extend(vec![Some(range); segment.frames]);
        }
        assert!(frames.len() <= time, "{} frames in {time}", frames.len());
        frames.resize(time, None);
        frames
    }

    /// The motion and the text of each condition. Each motion has one condition per segment, then
    /// one for the padding; padding without a text has `no_text`.
    pub fn conditions(&self, no_text: usize, device: &Device) -> [Tensor<1, Int>; 2] {
        let pairs = self.0.iter().enumerate().flat_map(|(motion, segments)| {
            let texts = segments.iter().map(|segment| segment.text);
            let of_padding = match segments[..] {
                [only] => only.text,
                _ => no_text,
            };
            let texts = texts.chain([of_padding]);
            texts.map(move |text| (motion as i64, text as i64))
        });
        let (motions, texts): (Vec<i64>, Vec<i64>) = pairs.unzip();
        [motions, texts].map(|indices| integers(indices, device))
    }

    /// The row in [`conditions`](Self::conditions) for each frame, `[batch * time]`.
    pub fn rows(&self, time: usize, device: &Device) -> Tensor<1, Int> {
        let mut rows = Vec::with_capacity(self.len() * time);
        let (mut row, mut end) = (0, 0);
        for segments in &*self.0 {
            end += time;
            for segment in segments {
                rows.extend(vec![row; segment.frames]);
                row += 1;
            }
            assert!(rows.len() <= end, "more frames than {time}");
            rows.resize(end, row);
            row += 1;
        }
        integers(rows, device)
    }

    /// The position of each frame in its segment, `[batch][time]`.
    pub fn places(&self, time: usize) -> Vec<Vec<usize>> {
        let of_motion = |motion: usize| {
            let runs_on = self.0[motion].len() == 1;
            let place = |(t, frame): (usize, Option<Range<usize>>)| match frame {
                Some(segment) => t - segment.start,
                None if runs_on => t,
                None => 0,
            };
            let frames = self.of(motion, time).into_iter().enumerate();
            frames.map(place).collect()
        };
        (0..self.len()).map(of_motion).collect()
    }

    /// The frames that each frame attends to: valid frames at most `horizon` away, in absolute mode
    /// only of the same segment. Padding attends to no frame.
    pub fn ranges(&self, time: usize, horizon: usize, is_relative: &[bool]) -> KeyRanges {
        let of_motion = |motion: usize| {
            let end = self.frames().nth(motion).expect("a motion");
            let frames = self.of(motion, time).into_iter().enumerate();
            frames
                .map(|(t, frame)| {
                    let Some(segment) = frame else {
                        return t..t;
                    };
                    let near = t.saturating_sub(horizon)..(t + horizon + 1).min(end);
                    match is_relative[motion] {
                        true => near,
                        false => near.start.max(segment.start)..near.end.min(segment.end),
                    }
                })
                .collect()
        };
        KeyRanges::new((0..self.len()).map(of_motion))
    }
}

fn integers(values: Vec<i64>, device: &Device) -> Tensor<1, Int> {
    let count = values.len();
    Tensor::from_data(TensorData::new(values, [count]), device)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_attend_within_horizon_segment_and_length() {
        let segment = |text, frames| Segment { text, frames };
        let segments = TextSegments::new([vec![segment(0, 3), segment(1, 4)], vec![segment(2, 5)]]);
        assert_eq!(segments.frames().collect::<Vec<_>>(), [7, 5]);
        let absolute = segments.ranges(8, 2, &[false, false]);
        let relative = segments.ranges(8, 2, &[true, false]);
        for (t, in_segment, across) in [
            (0, 0..3, 0..3),
            (2, 0..3, 0..5),
            (3, 3..6, 1..6),
            (6, 4..7, 4..7),
            (7, 7..7, 7..7),
        ] {
            assert_eq!(absolute.of(0, t), in_segment, "{t}");
            assert_eq!(relative.of(0, t), across, "{t}");
        }
        assert_eq!(relative.of(1, 4), 2..5);
        assert_eq!(segments.places(8)[0], [0, 1, 2, 0, 1, 2, 3, 0]);
        assert_eq!(segments.places(8)[1][7], 7);
        let device = Device::flex();
        let numbers = |rows: Tensor<1, Int>| rows.into_data().iter::<i64>().collect::<Vec<_>>();
        let found = segments.conditions(9, &device).map(numbers);
        assert_eq!(found, [vec![0, 0, 0, 1, 1], vec![0, 1, 9, 2, 2]]);
        let rows = numbers(segments.rows(8, &device));
        assert_eq!(rows, [0, 0, 0, 1, 1, 1, 1, 2, 3, 3, 3, 3, 3, 4, 4, 4]);
    }
}
