//! Imputation of known values.

use burn::tensor::Tensor;

/// Affine conversion between the network's space and the space of the known values.
pub trait Space {
    /// Network space to the space of the known values.
    ///
    /// # Shapes
    /// - x, output: `[batch, channels, time]`
    fn to_motion(&self, x: Tensor<3>) -> Tensor<3>;

    /// The inverse of [`to_motion`](Self::to_motion).
    ///
    /// # Shapes
    /// - motion, output: `[batch, channels, time]`
    fn to_network(&self, motion: Tensor<3>) -> Tensor<3>;
}

/// Known values to impute.
#[derive(Clone)]
pub struct Imputation<'a> {
    /// The space of the values.
    pub space: &'a dyn Space,
    /// The values, `[batch, channels, time]`; entries with mask 1 are used.
    pub target: Tensor<3>,
    /// 1 where a value is known, else 0: `[batch, channels, time]`.
    pub mask: Tensor<3>,
}

impl Imputation<'_> {
    /// `x`, in the network's space, with the known values put in.
    pub fn put_into(&self, x: Tensor<3>) -> Tensor<3> {
        let motion = self.space.to_motion(x);
        let target = self.target.clone();
        self.space.to_network(self.mix(target, motion))
    }

    /// `known` where the mask is 1, `other` elsewhere, both in the network's space.
    pub(super) fn merge(&self, known: Tensor<3>, other: Tensor<3>) -> Tensor<3> {
        let (known, other) = (self.space.to_motion(known), self.space.to_motion(other));
        self.space.to_network(self.mix(known, other))
    }

    fn mix(&self, known: Tensor<3>, other: Tensor<3>) -> Tensor<3> {
        let free = self.mask.clone() * -1.0 + 1.0;
        known * self.mask.clone() + other * free
    }
}
