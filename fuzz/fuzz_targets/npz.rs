//! Archives of audio features: `kinegrad_data::parse_features`.

#![no_main]

use kinegrad_data::{AUDIO_CHANNELS, parse_features};
use kinegrad_fuzz::{MIB, bounded};
use libfuzzer_sys::fuzz_target;

/// Deflated data unpack to at most so many times their length.
const MOST_UNPACKED: usize = 1032;

// At the same time, in multiples of what the archive can hold: 1 for a member unpacked, 1 for its
// values in Fortran order, and up to 3.8 for those of all members, where a member of a wrong shape
// makes them move. The list of the members takes less than 0.2.
fuzz_target!(|bytes: &[u8]| {
    let limit = MIB + 6 * MOST_UNPACKED * bytes.len();
    let parsed = bounded(limit, || parse_features(bytes, "fuzzed.npz"));
    if let Ok(features) = parsed {
        assert_eq!(
            features.as_slice().len(),
            AUDIO_CHANNELS * features.frames()
        );
        let _ = features.first_non_finite();
    }
});
