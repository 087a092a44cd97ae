//! wgpu parity
