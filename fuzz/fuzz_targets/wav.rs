//! WAV files: `kinegrad_audio::decode_reader`.

#![no_main]

use std::io::Cursor;

use kinegrad_audio::decode_reader;
use kinegrad_fuzz::{bounded, song_limit};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if !bytes.starts_with(b"RIF") && !bytes.starts_with(b"RF64") && !bytes.starts_with(b"BW64") {
        return;
    }
    let read = || decode_reader(Cursor::new(bytes), Some("wav"), "fuzzed.wav");
    if let Ok(wave) = bounded(song_limit(bytes.len()), read) {
        assert!(wave.samples.iter().all(|sample| sample.is_finite()));
    }
});
