//! One file per command.

pub mod audio;
pub mod check;
pub mod config;
pub mod data;
pub mod devices;
pub mod eval;
pub mod files;
pub mod import;
pub mod merge;
mod plan;
pub mod plot;
pub mod prepare;
pub mod sample;
pub mod train;
