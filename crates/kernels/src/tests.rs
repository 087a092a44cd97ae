//! Kernels against the composed operations, against a reference in double precision, and with
//! numbers that are not finite.

mod bounds;
mod cases;
mod fused;
mod invariance;
mod packed_cache;
mod padding;
mod recomputation;
mod recurrence;
mod reference;
