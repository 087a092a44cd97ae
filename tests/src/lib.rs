//! What the golden, parity and end-to-end tests share.

pub mod golden;
