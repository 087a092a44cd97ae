//! Shared code of the golden, parity and end-to-end tests.

pub mod captures;
pub mod decoder;
pub mod devices;
pub mod end_to_end;
pub mod gmd;
pub mod golden;
pub mod gradients;
pub mod parity;
pub mod sandbox;
pub mod servers;
pub mod stages;
pub mod trials;
pub mod unet;
pub mod weights;

pub use weights::weights;
