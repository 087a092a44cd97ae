//! Bounds on the memory of a parser for a given input size.

mod counting;

use counting::Counting;
use kinegrad_motion::path::PathPlan;

#[global_allocator]
static ALLOCATOR: Counting = Counting::new();

/// One mebibyte.
pub const MIB: usize = 1 << 20;

/// Bytes for each byte of a TOML document. A key `a.` of two bytes becomes a table: of 500 bytes with
/// the places in the text, and of 400 without, of which two copies exist at once.
pub const TOML: usize = 1024;

/// The bound of a song of `bytes` bytes. A frame of MP3 of 24 bytes becomes 1060 samples of 4 bytes,
/// three times that while they are collected. Converting from a sample rate that has no factor in
/// common with 44.1 kHz takes long transforms, whatever the song's length.
pub fn song_limit(bytes: usize) -> usize {
    256 * MIB + 600 * bytes
}

/// Checks the line of an accepted path.
///
/// # Panics
/// Panics for a line without length and for points that are not finite.
pub fn follow(plan: &PathPlan) {
    let line = plan.polyline().expect("an accepted path");
    assert!(line.length() > 0.0 && line.length().is_finite());
    let points = line.resampled(50);
    assert!(points.iter().flatten().all(|value| value.is_finite()));
}

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
