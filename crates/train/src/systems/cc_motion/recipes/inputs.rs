//! A batch on the device.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_data::{AUDIO_CHANNELS, Batch};
use kinegrad_motion::phrase::CHANNELS;

/// A batch on the device.
#[derive(Clone, Debug)]
pub struct Inputs {
    /// `[batch, 25, time]`, normalised.
    pub x_start: Tensor<3>,
    /// `[batch, 163, time]`.
    pub cond: Tensor<3>,
    /// `[batch, time]`, 1 where a frame is real.
    pub mask: Tensor<2>,
}

impl Inputs {
    /// Copies `batch` to `device`.
    pub fn new(batch: &Batch, device: &Device) -> Self {
        let (size, time) = (batch.batch_size, batch.frames);
        let on_device = |values: &[f32], channels: usize| {
            let data = TensorData::new(values.to_vec(), [size, channels, time]);
            Tensor::from_data(data, device)
        };
        Self {
            x_start: on_device(&batch.x_start, CHANNELS),
            cond: on_device(&batch.cond, AUDIO_CHANNELS),
            mask: Tensor::from_data(TensorData::new(batch.mask.clone(), [size, time]), device),
        }
    }
}
