//! Drawings of paths: `PathPlan::read` of SVG, and the line of an accepted drawing.

#![no_main]

use kinegrad_fuzz::{MIB, bounded, follow};
use kinegrad_motion::path::PathPlan;
use libfuzzer_sys::fuzz_target;

// At most 2^20 nodes of XML, which entities may multiply, of 100 bytes, and 2^20 straight pieces of
// 16 bytes, both three times while their lists grow. A curve has at least six bytes of text and
// takes 56 in memory.
fuzz_target!(|text: &str| {
    let limit = 448 * MIB + 64 * text.len();
    let read = bounded(limit, || PathPlan::read(text, "fuzzed.svg", Some(0.01)));
    if let Ok(plan) = read {
        bounded(limit, || follow(&plan));
    }
});
