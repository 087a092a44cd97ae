//! Layers with PyTorch's parameter names and weight layouts.
//!
//! [`crate::parameters`] maps field names to state-dict names. `at_n` becomes `n`, for child `n` of
//! a torch `Sequential`; `a_at_b` becomes `a.b`. A field `flat_x` is not part of a name.

mod batch_norm;
mod bi_gru;
mod conv1d;
mod conv_transpose1d;
mod embedding;
mod encoder_layer;
mod group_norm;
mod layer_norm;
mod linear;

pub use batch_norm::{BATCH_NORM_EPS, BatchNorm};
pub use bi_gru::{BiGru, GruStates};
pub use conv_transpose1d::ConvTranspose1d;
pub use conv1d::Conv1d;
pub use embedding::Embedding;
pub use encoder_layer::{EncoderLayer, EncoderLayerConfig, NormOrder};
pub use group_norm::{GROUP_NORM_EPS, GROUPS, GroupNorm};
pub use layer_norm::{LAYER_NORM_EPS, LayerNorm};
pub use linear::{Linear, Unbiased};
