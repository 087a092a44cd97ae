//! Layers with PyTorch's parameter names and weight layouts.
//!
//! A torch `Sequential` numbers its children and skips those without parameters; a field that
//! stands for child `n` of one is called `at_n`, and [`crate::parameters`] writes it as `n`.

mod conv1d;
mod group_norm;
mod layer_norm;
mod linear;

pub use conv1d::Conv1d;
pub use group_norm::{GROUP_NORM_EPS, GROUPS, GroupNorm};
pub use layer_norm::{LAYER_NORM_EPS, LayerNorm};
pub use linear::Linear;
