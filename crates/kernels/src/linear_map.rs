//! Linear maps that are computed on the host, such as the solution of a banded system.

use std::fmt::Debug;
use std::sync::Arc;

use burn::backend::Dispatch;
use burn::tensor::Tensor;

use crate::backend::FusedOps;
use crate::mode::fuses;

/// A linear map of the values of one sample, and its adjoint.
pub trait LinearMap: Debug + Send + Sync {
    /// Channels and frames of the output for an input of this size.
    fn shape(&self, channels: usize, frames: usize) -> [usize; 2];

    /// Maps one sample, `[channels, frames]`.
    fn apply(&self, values: &[f32], mapped: &mut [f32]);

    /// Maps output gradients to input gradients.
    fn adjoint(&self, gradient: &[f32], mapped: &mut [f32]);

    /// The map in Burn's operations, for other devices.
    fn composed(&self, x: Tensor<3>) -> Tensor<3>;
}

/// A map shared by an operation and its backward pass.
pub type SharedMap = Arc<dyn LinearMap>;

/// Maps each sample: on the CPU by [`LinearMap::apply`], with the adjoint as the backward pass; on
/// other devices by [`LinearMap::composed`].
///
/// # Shapes
/// - x: `[batch, channels, time]`
/// - output: `[batch, channels, time]`, of [`LinearMap::shape`]
pub fn linear_map(x: Tensor<3>, map: SharedMap) -> Tensor<3> {
    if fuses(&x) {
        Tensor::from_dispatch(Dispatch::fused_linear_map(x.into_dispatch(), map))
    } else {
        map.composed(x)
    }
}
