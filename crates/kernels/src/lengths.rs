//! Valid lengths of the samples of a batch, and attention spans.

use std::ops::Range;
use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};

/// Valid frames of each sample of a batch; the rest is padding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lengths(Arc<[usize]>);

impl Lengths {
    /// Lengths of `frames`.
    ///
    /// # Panics
    /// Panics if a sample has no frame.
    pub fn new(frames: impl IntoIterator<Item = usize>) -> Self {
        let frames: Arc<[usize]> = frames.into_iter().collect();
        assert!(!frames.contains(&0), "a sample without a frame");
        Self(frames)
    }

    /// The frames of each sample.
    pub fn frames(&self) -> &[usize] {
        &self.0
    }

    /// Lengths after a convolution of stride 2: half, rounded up.
    #[must_use]
    pub fn halved(&self) -> Self {
        Self(self.0.iter().map(|frames| frames.div_ceil(2)).collect())
    }

    /// 1 for valid frames, else 0: `[batch, 1, time]`.
    pub fn mask(&self, time: usize, device: &Device) -> Tensor<3> {
        let of_sample = |&frames: &usize| (0..time).map(move |t| f32::from(u8::from(t < frames)));
        let values: Vec<f32> = self.0.iter().flat_map(of_sample).collect();
        Tensor::from_data(TensorData::new(values, [self.0.len(), 1, time]), device)
    }

    /// The frames of each sample as a tensor `[batch, 1, 1]`.
    pub(crate) fn counts(&self, device: &Device) -> Tensor<3> {
        let values: Vec<f32> = self.0.iter().map(|&frames| frames as f32).collect();
        Tensor::from_data(TensorData::new(values, [self.0.len(), 1, 1]), device)
    }

    /// Asserts that the lengths fit a batch of `batch` samples of `time` frames.
    pub(crate) fn check(&self, batch: usize, time: usize) {
        assert_eq!(self.0.len(), batch, "lengths of a batch");
        assert!(
            self.0.iter().all(|&frames| frames <= time),
            "lengths {:?} of {time} frames",
            self.0
        );
    }
}

/// The range of keys that each query of a batch attends to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyRanges {
    /// `[batch, queries]`, start and end.
    ranges: Arc<[[u32; 2]]>,
    queries: usize,
    widest: usize,
}

impl KeyRanges {
    /// The keys of each query, `[batch][queries]`.
    ///
    /// # Panics
    /// Panics if the samples differ in their number of queries, or a range runs backwards.
    pub fn new(batch: impl IntoIterator<Item = Vec<Range<usize>>>) -> Self {
        let batch: Vec<Vec<Range<usize>>> = batch.into_iter().collect();
        let queries = batch.first().map_or(0, Vec::len);
        let all = batch.iter().flat_map(|sample| {
            assert_eq!(sample.len(), queries, "queries of each sample");
            sample
        });
        let all: Vec<&Range<usize>> = all.collect();
        assert!(all.iter().all(|range| range.start <= range.end), "ranges");
        Self {
            widest: all.iter().map(|range| range.len()).max().unwrap_or(0),
            ranges: all
                .iter()
                .map(|range| [range.start as u32, range.end as u32])
                .collect(),
            queries,
        }
    }

    /// Keys of a query.
    pub fn of(&self, sample: usize, query: usize) -> Range<usize> {
        let [start, end] = self.ranges[sample * self.queries + query];
        start as usize..end as usize
    }

    /// Maximum number of keys of a query.
    pub fn widest(&self) -> usize {
        self.widest
    }

    /// The smallest range that contains the keys of `queries`.
    pub(crate) fn span(&self, sample: usize, queries: Range<usize>) -> Range<usize> {
        let ranges = queries.map(|query| self.of(sample, query));
        let filled = ranges.filter(|range| !range.is_empty());
        let span = filled.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end));
        span.unwrap_or(0..0)
    }

    /// 1 where a query attends to a key, else 0: `[batch, 1, queries, keys]`.
    pub(crate) fn mask(
        &self,
        queries: Range<usize>,
        keys: Range<usize>,
        device: &Device,
    ) -> Tensor<4> {
        let batch = self.ranges.len() / self.queries.max(1);
        let mut values = Vec::with_capacity(batch * queries.len() * keys.len());
        for sample in 0..batch {
            for query in queries.clone() {
                let range = self.of(sample, query);
                values.extend(
                    keys.clone()
                        .map(|key| f32::from(u8::from(range.contains(&key)))),
                );
            }
        }
        let shape = [batch, 1, queries.len(), keys.len()];
        Tensor::from_data(TensorData::new(values, shape), device)
    }

    /// Asserts that the ranges fit a batch of `batch` samples with these numbers of queries and
    /// keys.
    pub(crate) fn check(&self, batch: usize, queries: usize, keys: usize) {
        assert_eq!(
            (self.ranges.len(), self.queries),
            (batch * queries, queries),
            "a range of keys for each query"
        );
        let inside = self.ranges.iter().all(|[_, end]| *end as usize <= keys);
        assert!(inside, "ranges beyond {keys} keys");
    }
}

/// Valid frames of a sample of `time` frames.
pub(crate) fn frames_of(lengths: Option<&[usize]>, sample: usize, time: usize) -> usize {
    lengths.map_or(time, |lengths| lengths[sample])
}
