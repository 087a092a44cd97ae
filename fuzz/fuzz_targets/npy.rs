//! Motion arrays and pickled motions: `kinegrad_data::parse_motion` and `MotionFile::parse`.

#![no_main]

use kinegrad_data::{MotionFile, parse_motion};
use kinegrad_fuzz::{MIB, bounded};
use libfuzzer_sys::fuzz_target;

// The values once as stored and once as single precision in the right order, and a syntax tree of
// a header of at most 10 kB.
fuzz_target!(|bytes: &[u8]| {
    let parsed = bounded(MIB + 4 * bytes.len(), || parse_motion(bytes, "fuzzed.npy"));
    if let Ok(motion) = parsed {
        assert!(4 * motion.as_slice().len() <= bytes.len());
        let _ = motion.first_non_finite();
    }
    // Of a pickle, each byte may be a value.
    let parsed = bounded(MIB + 200 * bytes.len(), || MotionFile::parse(bytes, "fuzzed.npy"));
    if let Ok(MotionFile::Results(results)) = parsed {
        assert!(4 * results.motion.values.len() <= bytes.len());
    }
});
