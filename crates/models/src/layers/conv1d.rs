use burn::module::{Module, Param};
use burn::tensor::Tensor;

use crate::lora::Adaptable;
use crate::{Initializer, LoraConfig, LowRank};

/// A convolution over time with torch's layout: weight `[out, in, kernel]`, bias `[out]`. Odd
/// kernels are padded by half, so that stride 1 keeps the length. An adapter, if there is one,
/// changes the weight.
#[derive(Module, Debug)]
pub struct Conv1d {
    weight: Param<Tensor<3>>,
    bias: Param<Tensor<1>>,
    lora: Option<LowRank>,
    stride: usize,
}

impl Conv1d {
    /// A convolution that keeps the length; `kernel_size` is odd.
    pub fn new(inputs: usize, outputs: usize, kernel_size: usize, init: &Initializer) -> Self {
        Self::strided(inputs, outputs, kernel_size, 1, init)
    }

    /// A convolution that maps `time` frames to `ceil(time / stride)`.
    pub fn strided(
        inputs: usize,
        outputs: usize,
        kernel_size: usize,
        stride: usize,
        init: &Initializer,
    ) -> Self {
        let fan_in = inputs * kernel_size;
        Self {
            weight: init.uniform("weight", [outputs, inputs, kernel_size], fan_in),
            bias: init.uniform("bias", [outputs], fan_in),
            lora: None,
            stride,
        }
    }

    /// # Shapes
    /// - x: `[batch, in, time]`
    /// - output: `[batch, out, ceil(time / stride)]`
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let weight = match &self.lora {
            Some(lora) => lora.apply(self.weight.val()),
            None => self.weight.val(),
        };
        convolve(x, weight, self.bias.val(), self.stride)
    }
}

impl Adaptable for Conv1d {
    fn with_adapter(mut self, config: &LoraConfig, init: &Initializer) -> Self {
        let [outputs, inputs, kernel] = self.weight.lazy_shape().dims();
        self.lora = Some(LowRank::new(inputs * kernel, outputs, config, init));
        self
    }

    fn merge_adapter(mut self) -> Self {
        if let Some(lora) = self.lora.take() {
            self.weight = lora.merge(self.weight);
        }
        self
    }
}

/// A convolution as one matrix product over batch and time together.
///
/// The CPU backend computes the weight gradient of its own convolution as a convolution with a
/// kernel as long as the sequence; as matrix products all three of output, input gradient and
/// weight gradient are large and fast.
///
/// # Shapes
/// - x: `[batch, in, time]`
/// - weight: `[out, in, kernel]`, kernel odd; bias: `[out]`
/// - output: `[batch, out, ceil(time / stride)]`
pub(super) fn convolve(
    x: Tensor<3>,
    weight: Tensor<3>,
    bias: Tensor<1>,
    stride: usize,
) -> Tensor<3> {
    let [batch, inputs, time] = x.dims();
    let [outputs, _, kernel] = weight.dims();
    let frames = time.div_ceil(stride);

    // Frames become rows: row (b, t) holds the inputs that output frame t of sample b sees.
    let rows = x.swap_dims(1, 2);
    let columns = if kernel == 1 && stride == 1 {
        rows
    } else {
        let half = kernel / 2;
        let edge = Tensor::zeros([batch, half, inputs], &rows.device());
        let padded = Tensor::cat(vec![edge.clone(), rows, edge], 1);
        let tap = |k: usize| {
            let window = padded.clone().narrow(1, k, time);
            if stride == 1 {
                window
            } else {
                every(window, stride)
            }
        };
        Tensor::cat((0..kernel).map(tap).collect(), 2)
    };
    let columns = columns.reshape([batch * frames, kernel * inputs]);
    let weight = weight
        .permute([2, 1, 0])
        .reshape([kernel * inputs, outputs]);
    let y = columns.matmul(weight) + bias.unsqueeze();
    y.reshape([batch, frames, outputs]).swap_dims(1, 2)
}

/// Every `stride`-th frame, the first included.
///
/// # Shapes
/// - rows: `[batch, time, channels]`
/// - output: `[batch, ceil(time / stride), channels]`
fn every(rows: Tensor<3>, stride: usize) -> Tensor<3> {
    let [batch, time, channels] = rows.dims();
    let frames = time.div_ceil(stride);
    let missing = frames * stride - time;
    let rows = if missing == 0 {
        rows
    } else {
        let edge = Tensor::zeros([batch, missing, channels], &rows.device());
        Tensor::cat(vec![rows, edge], 1)
    };
    rows.reshape([batch, frames, stride * channels])
        .narrow(2, 0, channels)
}
