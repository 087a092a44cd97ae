//! What is tested across crates without reference tensors of the golden set.

mod gmd_fixtures;
mod parity;
mod rollout;
#[cfg(feature = "stores")]
mod stores;
