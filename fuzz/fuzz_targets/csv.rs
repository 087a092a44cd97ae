//! Tables of points: `PathPlan::read` of CSV, and the line of an accepted table.

#![no_main]

use kinegrad_fuzz::{MIB, bounded, follow};
use kinegrad_motion::path::PathPlan;
use libfuzzer_sys::fuzz_target;

// A point has at least four bytes of text and takes 16 in memory, three times that while its list
// grows, and 24 as a part of a line.
fuzz_target!(|text: &str| {
    let limit = MIB + 32 * text.len();
    let read = bounded(limit, || PathPlan::read(text, "fuzzed.csv", None));
    if let Ok(plan) = read {
        assert!(4 * plan.points.len() <= text.len() + 1);
        bounded(limit, || follow(&plan));
    }
});
