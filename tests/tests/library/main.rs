//! What is tested across crates without reference tensors of the golden set.

mod flow;
mod gmd_fixtures;
mod interrupted;
mod parity;
mod rollout;
mod samplers;
#[cfg(feature = "stores")]
mod stores;
mod text_motion;
