//! The interface between the `model` table of a training config and a network's config.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Settings by the name of a size.
pub type NamedSizes<N> = &'static [(&'static str, fn() -> N)];

/// Widest layer, in channels.
pub const MAX_WIDTH: usize = 65_536;

/// Most layers or blocks in a row.
pub const MAX_LAYERS: usize = 1_024;

/// The settings of one kind of network: the keys of a table `model` beside its `kind` and `size`,
/// with a default for each. What its data decide, such as the number of channels, is given when it
/// is built.
pub trait NetworkConfig: Serialize + DeserializeOwned + 'static {
    /// Name of the kind, in `model.kind`.
    const KIND: &'static str;

    /// Named sizes that the keys start from, in `model.size`; the first where a config names none.
    const SIZES: NamedSizes<Self>;

    /// Fills in what follows from other keys where a config is silent.
    fn complete(&mut self) {}
}
