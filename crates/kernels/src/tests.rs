//! Kernels against the composed operations, against a reference in double precision, and at the
//! edges of what numbers can be.

mod bounds;
mod cases;
mod fused;
mod invariance;
mod packed_cache;
mod padding;
mod recurrence;
mod reference;
