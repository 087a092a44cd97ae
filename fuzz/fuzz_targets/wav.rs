//! WAV files: `kinegrad_audio::decode_reader`.

#![no_main]

use std::io::Cursor;

use kinegrad_audio::decode_reader;
use kinegrad_fuzz::{bounded, song_limit};
use libfuzzer_sys::fuzz_target;

/// True if a format states a high sample rate that has few factors in common with 44.1 kHz: its
/// conversion takes seconds, whatever the file's length.
fn is_slow(bytes: &[u8]) -> bool {
    let formats = bytes
        .windows(16)
        .filter(|format| format.starts_with(b"fmt "));
    let mut rates = formats.map(|format| u32::from_le_bytes([12, 13, 14, 15].map(|i| format[i])));
    rates.any(|rate| rate > 96_000 && !rate.is_multiple_of(25))
}

fuzz_target!(|bytes: &[u8]| {
    if is_slow(bytes) {
        return;
    }
    if !bytes.starts_with(b"RIF") && !bytes.starts_with(b"RF64") && !bytes.starts_with(b"BW64") {
        return;
    }
    let read = || decode_reader(Cursor::new(bytes), Some("wav"), "fuzzed.wav");
    if let Ok(wave) = bounded(song_limit(bytes.len()), read) {
        assert!(wave.samples.iter().all(|sample| sample.is_finite()));
    }
});
