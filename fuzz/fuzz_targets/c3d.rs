//! C3D files: `C3d::parse` and the processing of an accepted file.

#![no_main]

use kinegrad_capture::{C3d, MarkerMap, RootSource};
use kinegrad_fuzz::{MIB, bounded};
use libfuzzer_sys::fuzz_target;

// A parameter has at least four bytes, since the next may begin right after its name, and takes 100
// bytes in memory, three times that while its list grows. Labels may share their bytes in the file.
const MULTIPLE: usize = 100;

fuzz_target!(|bytes: &[u8]| {
    let limit = MIB + MULTIPLE * bytes.len();
    let Ok(take) = bounded(limit, || C3d::parse(bytes, "fuzzed.c3d")) else {
        return;
    };
    let mut seen = 0;
    for frame in 0..take.frames() {
        for point in 0..take.points_per_frame {
            seen += usize::from(take.point(frame, point).is_some());
        }
    }
    assert!(seen <= bytes.len() / 8);
    assert!(take.labels.len() <= take.points_per_frame);
    if let Ok(root) = bounded(limit, || MarkerMap::default().root(&take)) {
        assert_eq!(root.frames(), take.frames());
        for frame in 0..root.frames() {
            let _ = root.sample(frame as f64);
        }
    }
});
