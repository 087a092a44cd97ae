use burn::backend::Dispatch;
use burn::tensor::{Device, Tensor};

use crate::backend::{FusedOps, Options};
use crate::composed;
use crate::host::norm::GroupNormPlan;
use crate::mode::fuses;
use crate::{Activation, Lengths};

/// Group normalization over channels and time (biased variance), then optionally FiLM, an
/// activation and a mask:
///
/// ```text
/// u = (x - mean) / sqrt(variance + eps) weight + bias
/// y = activation(u (1 + scale) + shift) mask
/// ```
///
/// With lengths, mean and variance are those of the valid frames. Padding has no influence, becomes
/// zero and gets no gradient.
#[derive(Clone, Debug)]
pub struct GroupNorm {
    pub(crate) weight: Tensor<1>,
    pub(crate) bias: Tensor<1>,
    pub(crate) film: Option<Tensor<2>>,
    pub(crate) mask: Option<Tensor<3>>,
    pub(crate) lengths: Option<Lengths>,
    pub(crate) plan: GroupNormPlan,
}

/// The tensors of a normalization, with placeholders for missing tensors.
pub(crate) struct NormTensors {
    pub weight: Tensor<1>,
    pub bias: Tensor<1>,
    pub film: Tensor<2>,
    pub mask: Tensor<3>,
}

impl GroupNorm {
    /// A normalization of `groups` groups; weight and bias `[channels]`.
    pub fn new(weight: Tensor<1>, bias: Tensor<1>, groups: usize, eps: f64) -> Self {
        let plan = GroupNormPlan {
            groups,
            eps,
            activation: Activation::None,
        };
        Self {
            weight,
            bias,
            film: None,
            mask: None,
            lengths: None,
            plan,
        }
    }

    /// Scales by 1 plus the first half of `film`, `[batch, 2 channels]`, and shifts by the second
    /// half.
    pub fn film(self, film: Tensor<2>) -> Self {
        Self {
            film: Some(film),
            ..self
        }
    }

    /// Sets the activation.
    pub fn activation(mut self, activation: Activation) -> Self {
        self.plan.activation = activation;
        self
    }

    /// Multiplies the result by `mask`, `[batch, channels, time]`, which gets no gradient.
    pub fn mask(self, mask: Option<Tensor<3>>) -> Self {
        Self { mask, ..self }
    }

    /// Valid frames of each sample.
    pub fn lengths(self, lengths: Option<Lengths>) -> Self {
        Self { lengths, ..self }
    }

    /// # Shapes
    /// - x, output: `[batch, channels, time]`
    ///
    /// # Panics
    /// Panics if the channels do not divide into the groups, or a shape does not fit.
    pub fn forward(self, x: Tensor<3>) -> Tensor<3> {
        self.check(x.dims());
        if !fuses(&x) {
            return composed::group_norm(x, self);
        }
        let (plan, mut options) = (self.plan, Options::default());
        let tensors = self.into_tensors(&mut options, &x.device());
        Tensor::from_dispatch(Dispatch::fused_group_norm(
            x.into_dispatch(),
            tensors.weight.into_dispatch(),
            tensors.bias.into_dispatch(),
            tensors.film.into_dispatch(),
            tensors.mask.into_dispatch(),
            plan,
            options,
        ))
    }

    /// Asserts that the parameters fit an input of this shape.
    pub(crate) fn check(&self, [batch, channels, time]: [usize; 3]) {
        let groups = self.plan.groups;
        assert!(
            channels.is_multiple_of(groups),
            "{channels} channels do not divide into {groups} groups"
        );
        assert_eq!(self.weight.dims(), [channels], "weight of a normalisation");
        assert_eq!(self.bias.dims(), [channels], "bias of a normalisation");
        if let Some(film) = &self.film {
            assert_eq!(film.dims(), [batch, 2 * channels], "FiLM");
        }
        if let Some(mask) = &self.mask {
            assert_eq!(mask.dims(), [batch, channels, time], "mask");
        }
        if let Some(lengths) = &self.lengths {
            lengths.check(batch, time);
        }
    }

    pub(crate) fn into_tensors(self, options: &mut Options, device: &Device) -> NormTensors {
        options.film = self.film.is_some();
        options.mask = self.mask.is_some();
        options.lengths = self.lengths;
        NormTensors {
            weight: self.weight,
            bias: self.bias,
            film: self.film.unwrap_or_else(|| Tensor::zeros([1, 1], device)),
            mask: self
                .mask
                .unwrap_or_else(|| Tensor::zeros([1, 1, 1], device)),
        }
    }
}

/// Normalizes each row over its features (biased variance), then scales and shifts each feature.
///
/// # Shapes
/// - x, output: `[rows, features]`
/// - weight, bias: `[features]`
///
/// # Panics
/// Panics if rows have no features, or weight or bias have another number of features.
pub fn layer_norm(x: Tensor<2>, weight: Tensor<1>, bias: Tensor<1>, eps: f64) -> Tensor<2> {
    let features = x.dims()[1];
    assert!(features > 0, "rows to normalise without features");
    assert_eq!(weight.dims(), [features], "weight of a normalisation");
    assert_eq!(bias.dims(), [features], "bias of a normalisation");
    if !fuses(&x) {
        // Rows are samples of one frame with one group.
        let norm = GroupNorm::new(weight, bias, 1, eps);
        return composed::group_norm(x.unsqueeze_dim(2), norm).squeeze_dim(2);
    }
    Tensor::from_dispatch(Dispatch::fused_layer_norm(
        x.into_dispatch(),
        weight.into_dispatch(),
        bias.into_dispatch(),
        eps,
    ))
}

/// `x (1 + erf(x / sqrt 2)) / 2` of each element.
pub fn gelu<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    if fuses(&x) {
        Tensor::from_dispatch(Dispatch::fused_gelu(x.into_dispatch()))
    } else {
        burn::tensor::activation::gelu(x)
    }
}
