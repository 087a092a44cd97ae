//! The optimizer: AdamW over named parameters.
//!
//! Burn's AdamW keys its state by identifiers that are random in each process, and clips each
//! tensor separately. Exact resuming needs names, and CC-MotionGen clips by the global norm.

mod adamw;
mod clip;
mod learning_rate;

pub use adamw::{AdamW, Moments};
pub use clip::{clip_factor, norm_of_squares, squares};
pub use learning_rate::learning_rate;
