//! The random streams of the noise of each step and sample.

use burn::tensor::{Tensor, TensorData};
use kinegrad_random::Key;

/// Keys of the noise that a sampler draws.
#[derive(Clone, Copy, Debug)]
pub enum NoiseKeys<'a> {
    /// One for the whole batch: sample i of step n draws from `key.at(n).at(i)`, so that its noise
    /// does not depend on how many samples there are.
    Batch(Key),
    /// One for each sample, which then draws the same noise wherever it stands in a batch: from
    /// `key.at(n).at(0)`.
    Samples(&'a [Key]),
    /// One for each sample, with the number that it draws as in a [`Batch`](Self::Batch): from
    /// `key.at(n).at(number)`.
    Numbered(&'a [(Key, u64)]),
}

impl From<Key> for NoiseKeys<'_> {
    fn from(key: Key) -> Self {
        Self::Batch(key)
    }
}

impl NoiseKeys<'_> {
    /// Standard normal noise like `x` of a step; noise of another purpose has a `name`.
    pub(super) fn noise(self, step: usize, name: Option<&str>, x: &Tensor<3>) -> Tensor<3> {
        let [batch, channels, time] = x.dims();
        let of_step = |key: Key| {
            let key = key.at(step as u64);
            name.map_or(key, |name| key.named(name))
        };
        let key = |sample: usize| match self {
            Self::Batch(key) => of_step(key).at(sample as u64),
            Self::Samples(keys) => of_step(keys[sample]).at(0),
            Self::Numbered(keys) => of_step(keys[sample].0).at(keys[sample].1),
        };
        let values: Vec<f32> = (0..batch)
            .flat_map(|sample| key(sample).normals(channels * time))
            .collect();
        let data = TensorData::new(values, [batch, channels, time]);
        Tensor::from_data(data, (&x.device(), x.dtype()))
    }
}
