//! Fused operations of motion networks, and the optimiser's step.
//!
//! Each operation is one function over Burn tensors. On the CPU (Flex) it runs as kernels of this
//! crate, forward and backward; on every other device, or where [`Mode::Composed`] is set, it is
//! composed of Burn's own operations, whose gradients Burn derives. Both give the same numbers to
//! rounding.
//!
//! ```text
//! convolution, normalization,
//! attention, recurrence                   what a network calls
//!        |                \
//!     backend           composed           Burn extension with its backward | Burn's operations
//!        |
//!      host                                kernels over slices; know nothing of Burn
//! ```
//!
//! The kernels read and write frames as rows (`[batch, time, channels]` in memory, `[batch,
//! channels, time]` to Burn), so that a convolution's window is one piece of memory and a product
//! needs no copy of it.

mod attention;
mod autodiff;
mod backend;
mod composed;
mod convolution;
mod flex;
mod host;
mod host_values;
mod invariance;
mod lengths;
mod linear_map;
pub mod memory;
mod mode;
mod normalization;
pub mod optimizer;
mod precision;
mod product;
mod recurrence;

pub use attention::{cross_attention, ranged_attention, self_attention};
pub use convolution::{Convolution, concat_channels, linear};
pub use host::activation::Activation;
pub use host::kept::keeping_packed_weights;
pub use host_values::host_values;
pub use invariance::batch_invariant;
pub use lengths::{KeyRanges, Lengths};
pub use linear_map::{LinearMap, SharedMap, linear_map};
pub use mode::{Mode, ModeError, VARIABLE};
pub use normalization::{GroupNorm, gelu, layer_norm};
pub use precision::{Precision, product};
pub use product::float32_product;
pub use recurrence::{Direction, gru};

#[cfg(test)]
mod tests;
