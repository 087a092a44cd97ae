//! Bounds on the memory of a parser for a given input size.

mod counting;

use counting::Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting::new();

/// One mebibyte.
pub const MIB: usize = 1 << 20;

/// Runs `work` and returns its result.
///
/// # Panics Panics if the bytes allocated and not yet freed ever exceeded those before `work` by
/// more than `limit`, or if a single allocation requested more.
pub fn bounded<T>(limit: usize, work: impl FnOnce() -> T) -> T {
    let before = ALLOCATOR.start();
    let result = work();
    let taken = ALLOCATOR.peak().saturating_sub(before);
    assert!(
        taken <= limit,
        "{taken} bytes allocated at once, {limit} allowed"
    );
    result
}
