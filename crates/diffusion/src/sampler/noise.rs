//! The random streams of the noise of each step and sample.

use burn::tensor::{Tensor, TensorData};
use kinegrad_random::Key;

/// The source of a sampler's noise.
#[derive(Clone, Copy, Debug)]
pub enum NoiseKeys<'a> {
    /// One key for the batch. Step n of sample i uses `key.at(n).at(i)`, so the noise does not
    /// depend on the batch size.
    Batch(Key),
    /// One key per sample. Step n uses `key.at(n).at(0)`, independent of the sample's place in the
    /// batch.
    Samples(&'a [Key]),
    /// One key per sample with its index in a [`Batch`](Self::Batch): `key.at(n).at(index)`.
    Numbered(&'a [(Key, u64)]),
    /// The samples are parts of one motion, sample i from frame `starts[i]` on. Frame t of the
    /// motion has the noise of `key.at(n).at(t)` in every sample that contains it.
    Parts {
        /// The motion's key.
        key: Key,
        /// The first frame of each sample.
        starts: &'a [usize],
    },
    /// Stored noise, for reproducing the run of another program.
    Fixed(&'a FixedNoise),
}

/// Standard normal noise of each step, `[batch, channels, time]`, in the order of use.
#[derive(Clone, Debug, Default)]
pub struct FixedNoise {
    /// The sampling noise.
    pub sampling: Vec<Tensor<3>>,
    /// The noise of known values that are imputed.
    pub imputation: Vec<Tensor<3>>,
}

impl From<Key> for NoiseKeys<'_> {
    fn from(key: Key) -> Self {
        Self::Batch(key)
    }
}

impl NoiseKeys<'_> {
    /// Standard normal noise of a step, in the shape of `x`. Noise for other purposes has a `name`.
    ///
    /// # Panics
    /// Panics if [`FixedNoise`] does not contain the step.
    pub(super) fn noise(self, step: usize, name: Option<&str>, x: &Tensor<3>) -> Tensor<3> {
        let [batch, channels, time] = x.dims();
        let of_step = |key: Key| {
            let key = key.at(step as u64);
            name.map_or(key, |name| key.named(name))
        };
        let of_samples = |key: &dyn Fn(usize) -> Key| -> Vec<f32> {
            let samples = 0..batch;
            let normals = samples.flat_map(|sample| key(sample).normals(channels * time));
            normals.collect()
        };
        let values = match self {
            Self::Batch(key) => of_samples(&|sample| of_step(key).at(sample as u64)),
            Self::Samples(keys) => of_samples(&|sample| of_step(keys[sample]).at(0)),
            Self::Numbered(keys) => of_samples(&|sample| {
                let (key, index) = keys[sample];
                of_step(key).at(index)
            }),
            Self::Parts { key, starts } => noise_of_parts(of_step(key), starts, [channels, time]),
            Self::Fixed(fixed) => {
                let of_purpose = match name {
                    None => &fixed.sampling,
                    Some(_) => &fixed.imputation,
                };
                return of_purpose[step].clone();
            }
        };
        let data = TensorData::new(values, [batch, channels, time]);
        Tensor::from_data(data, (&x.device(), x.dtype()))
    }
}

/// Standard normal noise `[parts, channels, time]` of parts of a motion; frame t uses `key.at(t)`.
pub fn noise_of_parts(key: Key, starts: &[usize], [channels, time]: [usize; 2]) -> Vec<f32> {
    let mut values = vec![0.0; starts.len() * channels * time];
    let last = starts.iter().max().map_or(0, |start| start + time);
    for t in starts.iter().min().copied().unwrap_or(0)..last {
        let normals = key.at(t as u64).normals(channels);
        for (part, start) in starts.iter().enumerate() {
            let Some(place) = t.checked_sub(*start).filter(|place| *place < time) else {
                continue;
            };
            for (channel, normal) in normals.iter().enumerate() {
                values[(part * channels + channel) * time + place] = *normal;
            }
        }
    }
    values
}
