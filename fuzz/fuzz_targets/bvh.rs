//! Biovision hierarchies: `Bvh::parse` and the processing of an accepted file.

#![no_main]

use kinegrad_capture::{Bvh, RootSource, UpAxis};
use kinegrad_fuzz::{MIB, bounded};
use libfuzzer_sys::fuzz_target;

// A joint has at least six bytes of text and takes 150 bytes in memory, three times that while its
// list grows. A frame of one digit has two bytes and becomes a pose.
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
