//! Biovision hierarchies: `Bvh::parse` and what follows from a file that it takes.

#![no_main]

use kinegrad_capture::{Bvh, RootSource, UpAxis};
use kinegrad_fuzz::{MIB, bounded};
use libfuzzer_sys::fuzz_target;

// A joint takes six bytes of text at least and 150 bytes here, and a list of them three times that
// while it grows; a frame of one digit takes two bytes and becomes a pose.
const MULTIPLE: usize = 100;

fuzz_target!(|bytes: &[u8]| {
    let limit = MIB + MULTIPLE * bytes.len();
    let Ok(bvh) = bounded(limit, || Bvh::parse(bytes, "fuzzed.bvh")) else {
        return;
    };
    assert_eq!(bvh.world(bvh.frames() - 1).len(), bvh.joints().len());
    let track = bounded(limit, || bvh.root_track(0.01, UpAxis::Z));
    if let Ok(track) = track {
        assert_eq!(track.frames(), bvh.frames());
        assert!(track.sample(0.0).is_some());
    }
});
