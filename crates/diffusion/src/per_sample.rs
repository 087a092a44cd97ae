//! Coefficients per sample: f64 tables on the host, tensors on the device.

use burn::tensor::{Tensor, TensorData};

/// One value per sample as `[batch, 1, 1]`, on the device and in the precision of `like`, `[batch,
/// channels, time]`. Each value is rounded only here.
///
/// # Panics
/// Panics unless there is one value per sample.
pub(crate) fn per_sample(values: &[f64], like: &Tensor<3>) -> Tensor<3> {
    let [batch, ..] = like.dims();
    assert_eq!(values.len(), batch, "one timestep per sample of the batch");
    let rounded: Vec<f32> = values.iter().map(|&value| value as f32).collect();
    let data = TensorData::new(rounded, [batch, 1, 1]);
    Tensor::from_data(data, (&like.device(), like.dtype()))
}
