//! How much of each sample of a batch is real.

use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};

/// Frames that count of each sample of a batch, from the first on; the rest is padding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lengths(Arc<[usize]>);

impl Lengths {
    /// The frames of each sample.
    ///
    /// # Panics
    /// Panics if a sample has none.
    pub fn new(frames: impl IntoIterator<Item = usize>) -> Self {
        let frames: Arc<[usize]> = frames.into_iter().collect();
        assert!(!frames.contains(&0), "a sample without a frame");
        Self(frames)
    }

    /// The frames of each sample.
    pub fn frames(&self) -> &[usize] {
        &self.0
    }

    /// What a convolution of stride 2 makes of each: half, rounded up.
    #[must_use]
    pub fn halved(&self) -> Self {
        Self(self.0.iter().map(|frames| frames.div_ceil(2)).collect())
    }

    /// 1 where a frame counts, else 0: `[batch, 1, time]`.
    pub fn mask(&self, time: usize, device: &Device) -> Tensor<3> {
        let of_sample = |&frames: &usize| (0..time).map(move |t| f32::from(u8::from(t < frames)));
        let values: Vec<f32> = self.0.iter().flat_map(of_sample).collect();
        Tensor::from_data(TensorData::new(values, [self.0.len(), 1, time]), device)
    }

    /// The frames of each sample as a factor: `[batch, 1, 1]`.
    pub(crate) fn counts(&self, device: &Device) -> Tensor<3> {
        let values: Vec<f32> = self.0.iter().map(|&frames| frames as f32).collect();
        Tensor::from_data(TensorData::new(values, [self.0.len(), 1, 1]), device)
    }

    /// Asserts that they fit a batch of so many samples and frames.
    pub(crate) fn check(&self, batch: usize, time: usize) {
        assert_eq!(self.0.len(), batch, "lengths of a batch");
        assert!(
            self.0.iter().all(|&frames| frames <= time),
            "lengths {:?} of {time} frames",
            self.0
        );
    }
}

/// Frames of a sample of `time` frames that count.
pub(crate) fn frames_of(lengths: Option<&[usize]>, sample: usize, time: usize) -> usize {
    lengths.map_or(time, |lengths| lengths[sample])
}
