//! MP3 files: `kinegrad_audio::decode_reader`.

#![no_main]

use std::io::Cursor;

use kinegrad_audio::decode_reader;
use kinegrad_fuzz::{bounded, song_limit};
use libfuzzer_sys::fuzz_target;

// FLAC and Ogg, whose packets may unpack to any length, are left out.
fuzz_target!(|bytes: &[u8]| {
    if bytes
        .windows(4)
        .any(|name| matches!(name, b"fLaC" | b"OggS"))
    {
        return;
    }
    let read = || decode_reader(Cursor::new(bytes), Some("mp3"), "fuzzed.mp3");
    if let Ok(wave) = bounded(song_limit(bytes.len()), read) {
        assert!(wave.samples.iter().all(|sample| sample.is_finite()));
    }
});
