//! Plans of `kinegrad data prepare`: `Plan::parse`.

#![no_main]

use std::path::Path;

use kinegrad_capture::Plan;
use kinegrad_fuzz::{MIB, TOML, bounded};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let limit = MIB + TOML * text.len();
    let read = bounded(limit, || Plan::parse(text, Path::new("fuzzed.toml")));
    if let Ok(plan) = read {
        assert!(plan.is_of_clips() || !plan.takes.is_empty() || !plan.choreonet.is_empty());
    }
});
