//! The interface between the `model` table of a training config and a network's config.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Settings by the name of a size.
pub type NamedSizes<N> = &'static [(&'static str, fn() -> N)];

/// Widest layer, in channels.
pub const MAX_WIDTH: usize = 65_536;

/// Most layers or blocks in a row.
pub const MAX_LAYERS: usize = 1_024;

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
