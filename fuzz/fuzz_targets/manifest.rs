//! Manifests in Parquet: `kinegrad_data::manifest::parse`.

#![no_main]

use kinegrad_data::manifest;
use kinegrad_fuzz::{MIB, bounded};
use libfuzzer_sys::fuzz_target;

// A file may unpack to 1 MiB plus 256 times its length. Its cells contain at most as much text, and
// 8 values a byte, each of 16 bytes plus two copies of up to 24. Parsing the footer takes about a
// hundred times its length, and the first call starts threads.
fuzz_target!(|bytes: &[u8]| {
    let limit = 16 * MIB + 2048 * bytes.len();
    let read = bounded(limit, || manifest::parse(bytes.to_vec(), "fuzzed.parquet"));
    if let Ok(rows) = read {
        assert!(rows.len() <= 8 * bytes.len());
    }
});
