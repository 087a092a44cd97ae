//! Path tokens as additional rows of the sequence.

use burn::tensor::{Device, Int, Tensor, TensorData};
use kinegrad_kernels::KeyRanges;

/// A path row per frame, behind the frames: tokens `[frames | rows]`. A frame attends to the rows of
/// the frames that it attends to. Motions without a path attend to no row.
///
/// A range of keys is contiguous, so the keys are ordered: a row before its frame in motions with a
/// path, and the rows behind the frames in others.
#[derive(Clone, Debug)]
pub(super) struct PathRows {
    /// The token of each key, `[batch * 2 time]`.
    pub order: Tensor<1, Int>,
    /// The keys of each token.
    pub ranges: KeyRanges,
}

impl PathRows {
    /// Rows beside `time` frames; `ranges` are the frames that each frame attends to, `has_path` is
    /// true for motions with a path.
    pub fn new(ranges: &KeyRanges, has_path: &[bool], time: usize, device: &Device) -> Self {
        let mut order = Vec::with_capacity(has_path.len() * 2 * time);
        for (motion, has_path) in has_path.iter().enumerate() {
            let first = motion * 2 * time;
            let token = |key: usize| match (has_path, key % 2) {
                (false, _) => key,
                (true, 0) => time + key / 2,
                (true, _) => key / 2,
            };
            order.extend((0..2 * time).map(|key| (first + token(key)) as i64));
        }
        let of_motion = |(motion, has_path): (usize, &bool)| {
            let keys = |token: usize| {
                let frames = ranges.of(motion, token % time);
                match has_path {
                    true => 2 * frames.start..2 * frames.end,
                    false if token < time => frames,
                    false => 0..0,
                }
            };
            (0..2 * time).map(keys).collect()
        };
        let count = order.len();
        Self {
            order: Tensor::from_data(TensorData::new(order, [count]), device),
            ranges: KeyRanges::new(has_path.iter().enumerate().map(of_motion)),
        }
    }

    /// Keys and values of the tokens in the order of the keys, `[batch, channels, 2 time]`.
    pub fn ordered(&self, tokens: Tensor<3>) -> Tensor<3> {
        let [batch, channels, count] = tokens.dims();
        let rows = tokens.swap_dims(1, 2).reshape([batch * count, channels]);
        let rows = rows.select(0, self.order.clone());
        rows.reshape([batch, count, channels]).swap_dims(1, 2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_sees_the_rows_of_its_frames_and_none_without_a_path() {
        let device = Device::flex();
        let ranges = || [0..2, 0..3, 1..3, 3..3].to_vec();
        let ranges = KeyRanges::new([ranges(), ranges()]);
        let rows = PathRows::new(&ranges, &[true, false], 4, &device);
        // Tokens 0 to 3 are frames, 4 to 7 their rows.
        let tokens: Vec<f32> = [0, 1, 2, 3, 4, 5, 6, 7].map(|token| token as f32).to_vec();
        let tokens = Tensor::<3>::from_data(
            TensorData::new([tokens.clone(), tokens].concat(), [2, 1, 8]),
            &device,
        );
        let keys = rows.ordered(tokens).try_into_vec_as::<f32>().unwrap();
        let seen = |motion: usize, token: usize| {
            let range = rows.ranges.of(motion, token);
            let mut seen = keys[8 * motion..][range].to_vec();
            seen.sort_by(f32::total_cmp);
            seen
        };
        for token in [0, 4] {
            assert_eq!(seen(0, token), [0.0, 1.0, 4.0, 5.0]);
        }
        assert_eq!(seen(0, 2), [1.0, 2.0, 5.0, 6.0]);
        assert_eq!(seen(1, 2), [1.0, 2.0]);
        assert!(seen(0, 3).is_empty() && seen(0, 7).is_empty() && seen(1, 6).is_empty());
    }
}
