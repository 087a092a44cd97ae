//! Archives of audio features: `kinegrad_data::parse_features`.

#![no_main]

use kinegrad_data::{AUDIO_CHANNELS, AudioLayout, parse_features};
use kinegrad_fuzz::{MIB, bounded};
use libfuzzer_sys::fuzz_target;

/// Largest expansion factor of deflated data.
const MOST_UNPACKED: usize = 1032;

// Live at once, in multiples of the archive's capacity: 1 for an unpacked member, 1 for its values
// in Fortran order, and up to 3.8 for those of all members if a member of a wrong shape moves them.
// The list of members takes less than 0.2.
fuzz_target!(|bytes: &[u8]| {
    let limit = MIB + 6 * MOST_UNPACKED * bytes.len();
    let parsed = bounded(limit, || parse_features(bytes, "fuzzed.npz", AudioLayout::CCMOTION));
    if let Ok(features) = parsed {
        assert_eq!(
            features.as_slice().len(),
            AUDIO_CHANNELS * features.frames()
        );
    }
});
