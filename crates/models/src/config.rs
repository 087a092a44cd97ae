//! What the table `model` of a training config asks of a network's settings.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// The settings of one kind of network: the keys of a table `model` beside its `kind` and `size`,
/// with a default for each. What its data decide, such as the number of channels, is given when it
/// is built.
pub trait NetworkConfig: Serialize + DeserializeOwned + 'static {
    /// Name of the kind, in `model.kind`.
    const KIND: &'static str;

    /// Named sizes that the keys start from, in `model.size`; the first where a config names none.
    const SIZES: &'static [(&'static str, fn() -> Self)];

    /// Fills in what follows from other keys where a config is silent.
    fn complete(&mut self) {}
}
