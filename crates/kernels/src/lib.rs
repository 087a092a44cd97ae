//! Fused operations of motion networks, and the optimizer's step.
//!
//! Each operation is one function over Burn tensors. On the CPU (Flex) an operation runs as kernels
//! of this crate, forward and backward. On other devices, or with [`Mode::Composed`], the operation
//! consists of Burn's operations. Both agree to rounding.
//!
//! ```text
//! convolution, normalization,
//! attention, recurrence                   called by networks
//!        |                \
//!     backend           composed           Burn extension with its backward | Burn's operations
//!        |
//!      host                                kernels over slices, independent of Burn
//! ```
//!
//! Kernels store frames as rows: `[batch, time, channels]` in memory, `[batch, channels, time]` for
//! Burn. A convolution's window is then contiguous, and a product reads it without a copy.

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
mod recording;
mod recurrence;

pub use attention::{cross_attention, ranged_attention, self_attention};
pub use convolution::{Convolution, concat_channels, linear};
pub use host::activation::Activation;
pub use host::packed_cache::cache_packed_weights;
pub use host_values::host_values;
pub use invariance::batch_invariant;
pub use lengths::{KeyRanges, Lengths};
pub use linear_map::{LinearMap, SharedMap, linear_map};
pub use mode::{Mode, ModeError, VARIABLE};
pub use normalization::{GroupNorm, gelu, layer_norm};
pub use precision::{Precision, product};
pub use product::float32_product;
pub use recording::stored;
pub use recurrence::{Direction, gru};

#[cfg(test)]
mod tests;
