//! The interface between the `model` table of a training config and a network's config.

use kinegrad_settings::{InvalidSetting, Refused, require};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Settings by size name.
pub type NamedSizes<N> = &'static [(&'static str, fn() -> N)];

/// Largest width of a layer, in channels.
pub const MAX_WIDTH: usize = 65_536;

/// Largest number of consecutive layers or blocks.
pub const MAX_LAYERS: usize = 1_024;

/// Validates `model.latent_dim`, an even number; `hint` belongs to the error.
///
/// # Errors
/// The error names the key.
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
/// The error names the key.
pub fn must_divide(heads: usize, width: usize) -> Result<(), InvalidSetting> {
    require(
        heads > 0 && width.is_multiple_of(heads),
        "model.num_heads",
        heads,
        format!("a divisor of model.latent_dim ({width})"),
    )
}

/// The settings of one kind of network, with defaults: the keys of a table `model` other than
/// `kind` and `size`. Sizes that depend on the data are not settings.
pub trait NetworkConfig: Serialize + DeserializeOwned + 'static {
    /// Name of the kind, in `model.kind`.
    const KIND: &'static str;

    /// Defaults by the name in `model.size`. The first is the default.
    const SIZES: NamedSizes<Self>;

    /// Fills in missing keys that follow from other keys.
    fn complete(&mut self) {}
}
