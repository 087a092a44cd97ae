//! Layers with PyTorch's parameter names and weight layouts.
//!
//! A torch `Sequential` numbers its children and skips those without parameters; a field that
//! stands for child `n` of one is called `at_n`, and [`crate::parameters`] writes it as `n`. A
//! field `a_at_b` is written as `a.b`. What a field `flat_x` holds is named as if it stood in the
//! field's place.

mod bi_gru;
mod conv1d;
mod conv_transpose1d;
mod embedding;
mod encoder_layer;
mod group_norm;
mod layer_norm;
mod linear;

pub use bi_gru::{BiGru, GruStates};
pub use conv_transpose1d::ConvTranspose1d;
pub use conv1d::Conv1d;
pub use embedding::Embedding;
pub use encoder_layer::{EncoderLayer, EncoderLayerConfig, NormOrder};
pub use group_norm::{GROUP_NORM_EPS, GROUPS, GroupNorm};
pub use layer_norm::{LAYER_NORM_EPS, LayerNorm};
pub use linear::{Linear, Unbiased};
