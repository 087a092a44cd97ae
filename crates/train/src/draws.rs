//! What training draws at random, and the even spread that validation has instead.

use std::ops::Range;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_random::{Key, Purpose};

use crate::recipe::StepKey;

/// Standard normal noise of `key`.
pub fn noise(key: Key, shape: [usize; 3], device: &Device) -> Tensor<3> {
    let values = key.normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// 0 for each sample whose condition is dropped, else 1: `[batch, 1, 1]`. None where none is.
pub fn keep_cond(
    cond_drop_prob: f64,
    batch: usize,
    key: StepKey,
    device: &Device,
) -> Option<Tensor<3>> {
    (cond_drop_prob > 0.0).then(|| {
        let keep: Vec<f32> = key
            .of(Purpose::CondDropout)
            .uniforms(batch)
            .iter()
            .map(|&u| f32::from(f64::from(u) >= cond_drop_prob))
            .collect();
        Tensor::from_data(TensorData::new(keep, [batch, 1, 1]), device)
    })
}

/// Timesteps of draw k of the samples `range` of P: `t = floor((k P + p + 0.5) T / (draws P))`. The
/// draws of all samples together cover the timesteps evenly, and the same ones each time.
pub fn spread_timesteps(
    range: Range<usize>,
    draw: usize,
    draws: usize,
    samples: usize,
    num_train_timesteps: usize,
) -> Vec<usize> {
    range
        .map(|p| {
            let twice = 2 * (draw * samples + p) + 1;
            twice * num_train_timesteps / (2 * draws * samples)
        })
        .collect()
}
