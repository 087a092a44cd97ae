//! Kernels on slices of host memory, independent of Burn.

pub(crate) mod activation;
pub(crate) mod attention;
pub(crate) mod columns;
pub(crate) mod convolution;
pub(crate) mod gelu;
pub(crate) mod geometry;
pub(crate) mod layer_norm;
pub(crate) mod narrow;
pub(crate) mod norm;
pub(crate) mod outer;
pub(crate) mod packed_cache;
pub(crate) mod packing;
pub(crate) mod product;
pub(crate) mod recurrence;
pub(crate) mod rows;
pub(crate) mod simd;
pub(crate) mod team;
