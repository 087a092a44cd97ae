//! The interface between the `model` table of a training config and a network's config.

use kinegrad_settings::{InvalidSetting, Refused, require};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Settings by the name of a size.
pub type NamedSizes<N> = &'static [(&'static str, fn() -> N)];

/// Widest layer, in channels.
pub const MAX_WIDTH: usize = 65_536;

/// Most layers or blocks in a row.
pub const MAX_LAYERS: usize = 1_024;

/// Validates `model.latent_dim`, an even number; `hint` is that of the error.
///
/// # Errors
/// Names the key.
pub fn must_be_even(width: usize, hint: &'static str) -> Result<(), InvalidSetting> {
    require(
        (2..=MAX_WIDTH).contains(&width) && width.is_multiple_of(2),
        "model.latent_dim",
        width,
        format!("an even number, 2 to {MAX_WIDTH}"),
    )
    .hint(hint)
}

/// Validates `model.num_heads`, a divisor of `model.latent_dim`.
///
/// # Errors
/// Names the key.
pub fn must_divide(heads: usize, width: usize) -> Result<(), InvalidSetting> {
    require(
        heads > 0 && width.is_multiple_of(heads),
        "model.num_heads",
        heads,
        format!("a divisor of model.latent_dim ({width})"),
    )
}

/// The settings of one kind of network: the keys of a table `model` beside `kind` and `size`, with
/// defaults. Sizes that depend on the data are not among them.
pub trait NetworkConfig: Serialize + DeserializeOwned + 'static {
    /// Name of the kind, in `model.kind`.
    const KIND: &'static str;

    /// Defaults by the name in `model.size`; the first is the default size.
    const SIZES: NamedSizes<Self>;

    /// Fills in missing keys that follow from others.
    fn complete(&mut self) {}
}
