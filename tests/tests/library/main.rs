//! Tests across crates without golden files.

mod flow;
mod gmd_fixtures;
mod interrupted;
mod parity;
mod rollout;
mod samplers;
mod sources;
#[cfg(feature = "stores")]
mod stores;
mod text_motion;
