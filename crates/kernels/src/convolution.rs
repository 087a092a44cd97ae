use burn::backend::Dispatch;
use burn::tensor::Tensor;

use crate::backend::{FusedOps, Options};
use crate::host::convolution::ConvolutionPlan;
use crate::host::geometry::Geometry;
use crate::mode::fuses;
use crate::normalization::NormTensors;
use crate::{GroupNorm, Lengths, composed, product};

/// A convolution over time, fused with the operations right before and after it.
///
/// On the CPU this is one operation that stores its input and parameters. The backward pass
/// recomputes the normalized or repeated input.
///
/// ```text
/// y = conv(norm(x)) + bias + residual        or        y = conv(upsample(x)) + bias + residual
/// ```
#[derive(Clone, Debug)]
pub struct Convolution {
    pub(crate) weight: Tensor<3>,
    pub(crate) bias: Option<Tensor<1>>,
    pub(crate) residual: Option<Tensor<3>>,
    pub(crate) norm: Option<GroupNorm>,
    pub(crate) geometry: Geometry,
    pub(crate) transposed: bool,
    pub(crate) upsample: Option<usize>,
    pub(crate) lengths: Option<Lengths>,
    pub(crate) recomputed: bool,
}

impl Convolution {
    /// Weight `[out, in, kernel]`, padded by `(kernel - 1) / 2`. An odd kernel maps `time` frames
    /// to `ceil(time / stride)`, a kernel of 4 with stride 2 to `floor(time / 2)`.
    pub fn new(weight: Tensor<3>, stride: usize) -> Self {
        let kernel = weight.dims()[2];
        Self {
            weight,
            bias: None,
            residual: None,
            norm: None,
            geometry: Geometry {
                kernel,
                stride,
                padding: (kernel - 1) / 2,
            },
            transposed: false,
            upsample: None,
            lengths: None,
            recomputed: false,
        }
    }

    /// The transposed convolution, weight `[in, out, kernel]`: maps `time` frames to
    /// `(time - 1) stride + kernel - 2 padding`.
    pub fn transposed(weight: Tensor<3>, stride: usize, padding: usize) -> Self {
        let kernel = weight.dims()[2];
        Self {
            geometry: Geometry {
                kernel,
                stride,
                padding,
            },
            transposed: true,
            ..Self::new(weight, stride)
        }
    }

    /// Adds `[out]`, one value per output channel.
    pub fn bias(self, bias: Tensor<1>) -> Self {
        Self {
            bias: Some(bias),
            ..self
        }
    }

    /// Adds `[batch, out, frames]`.
    pub fn residual(self, residual: Tensor<3>) -> Self {
        Self {
            residual: Some(residual),
            ..self
        }
    }

    /// Normalizes the input.
    pub fn norm(self, norm: GroupNorm) -> Self {
        Self {
            norm: Some(norm),
            ..self
        }
    }

    /// Repeats every input frame twice, then keeps the first `frames`: twice the input's frames, or
    /// one frame less. Excludes [`norm`](Self::norm).
    pub fn upsample(self, frames: usize) -> Self {
        Self {
            upsample: Some(frames),
            ..self
        }
    }

    /// Valid frames of each sample, after upsampling; the others are multiplied as zeros. Excludes
    /// [`norm`](Self::norm), which has its own lengths.
    pub fn lengths(self, lengths: Option<Lengths>) -> Self {
        Self { lengths, ..self }
    }

    /// With activation checkpointing, the output is not stored for the operations after it: the
    /// backward pass computes it again.
    pub fn recomputed(self) -> Self {
        Self {
            recomputed: true,
            ..self
        }
    }

    /// # Shapes
    /// - x: `[batch, in, time]`
    /// - output: `[batch, out, frames]`
    ///
    /// # Panics
    /// Panics if the shapes do not fit.
    pub fn forward(self, x: Tensor<3>) -> Tensor<3> {
        let [batch, inputs, time] = x.dims();
        let expected = self.weight.dims()[usize::from(!self.transposed)];
        assert_eq!(
            inputs, expected,
            "channels of a convolution's input and weight"
        );
        if let Some(norm) = &self.norm {
            norm.check(x.dims());
            assert!(self.upsample.is_none(), "normalised and repeated at once");
            assert!(self.lengths.is_none(), "lengths beside a normalisation's");
        }
        if let Some(lengths) = &self.lengths {
            lengths.check(batch, self.upsample.unwrap_or(time));
        }
        if let Some(frames) = self.upsample {
            let doubled = 2 * time;
            assert!(
                frames == doubled || frames + 1 == doubled,
                "{time} frames to {frames}"
            );
        }
        let plan = ConvolutionPlan {
            geometry: self.geometry,
            transposed: self.transposed,
            upsample: self.upsample,
            norm: self.norm.as_ref().map(|norm| norm.plan),
        };
        let outputs = plan.out_channels(self.weight.dims());
        if let Some(bias) = &self.bias {
            assert_eq!(bias.dims(), [outputs], "bias");
        }
        if let Some(residual) = &self.residual {
            assert_eq!(
                residual.dims(),
                [batch, outputs, plan.frames(time)],
                "residual"
            );
        }
        if !fuses(&x) {
            return composed::convolution(x, self);
        }
        let device = x.device();
        let mut options = Options {
            bias: self.bias.is_some(),
            residual: self.residual.is_some(),
            lengths: self.lengths,
            recomputed: self.recomputed,
            ..Options::default()
        };
        let norm = match self.norm {
            Some(norm) => norm.into_tensors(&mut options, &device),
            None => NormTensors {
                weight: Tensor::zeros([1], &device),
                bias: Tensor::zeros([1], &device),
                film: Tensor::zeros([1, 1], &device),
                mask: Tensor::zeros([1, 1, 1], &device),
            },
        };
        let bias = self.bias.unwrap_or_else(|| Tensor::zeros([1], &device));
        let residual = self
            .residual
            .unwrap_or_else(|| Tensor::zeros([1, 1, 1], &device));
        Tensor::from_dispatch(Dispatch::fused_convolution(
            x.into_dispatch(),
            self.weight.into_dispatch(),
            bias.into_dispatch(),
            residual.into_dispatch(),
            norm.weight.into_dispatch(),
            norm.bias.into_dispatch(),
            norm.film.into_dispatch(),
            norm.mask.into_dispatch(),
            plan,
            options,
        ))
    }
}

/// `x weight^T + bias`: a convolution of one tap over rows.
///
/// # Shapes
/// - x: `[rows, in]`
/// - weight: `[out, in]`, bias: `[out]`
/// - output: `[rows, out]`
pub fn linear(x: Tensor<2>, weight: Tensor<2>, bias: Tensor<1>) -> Tensor<2> {
    if !fuses(&x) {
        return product(x, weight.transpose()) + bias.unsqueeze();
    }
    // Rows as the frames of one sample: a view with contiguous channels.
    let frames = x.unsqueeze::<3>().swap_dims(1, 2);
    Convolution::new(weight.unsqueeze_dim(2), 1)
        .bias(bias)
        .forward(frames)
        .swap_dims(1, 2)
        .squeeze_dim(0)
}

/// The channels of `first`, then those of `second`.
///
/// # Shapes
/// - first: `[batch, a, time]`, second: `[batch, b, time]`
/// - output: `[batch, a + b, time]`
///
/// # Panics
/// Panics if the shapes do not fit.
pub fn concat_channels(first: Tensor<3>, second: Tensor<3>) -> Tensor<3> {
    let ([batch, _, time], [other_batch, _, other_time]) = (first.dims(), second.dims());
    assert_eq!(
        (batch, time),
        (other_batch, other_time),
        "samples and frames"
    );
    if !fuses(&first) {
        return Tensor::cat(vec![first, second], 1);
    }
    Tensor::from_dispatch(Dispatch::concat_channels(
        first.into_dispatch(),
        second.into_dispatch(),
    ))
}
