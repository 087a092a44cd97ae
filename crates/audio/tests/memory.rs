//! Memory of a long song, as the process reports it.
#![cfg(target_os = "linux")]

use std::fs;
use std::io::Cursor;

use kinegrad_audio::{Analysis, SAMPLE_RATE, decode_reader, extract};

/// Seconds of the song.
const SECONDS: usize = 600;

/// The peak memory of this process in bytes, from `/proc/self/status`.
fn peak() -> u64 {
    let status = fs::read_to_string("/proc/self/status").expect("a status");
    let line = status.lines().find(|line| line.starts_with("VmHWM:"));
    let kibibytes = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<u64>().ok());
    kibibytes.expect("a peak") * 1024
}

/// A mono WAV file of 8-bit noise at 8000 Hz.
fn song() -> Vec<u8> {
    let samples = SECONDS as u32 * 8000;
    let mut out = b"RIFF".to_vec();
    out.extend((36 + samples).to_le_bytes());
    out.extend(b"WAVEfmt \x10\0\0\0\x01\0\x01\0");
    out.extend(8000u32.to_le_bytes());
    out.extend(8000u32.to_le_bytes());
    out.extend(b"\x01\0\x08\0data");
    out.extend(samples.to_le_bytes());
    let mut state = 1u32;
    let noise = (0..samples).map(|_| {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        (state >> 24) as u8
    });
    out.extend(noise);
    out
}

#[test]
fn a_song_takes_little_more_than_its_samples() {
    let file = song();
    let before = peak();
    let waveform = decode_reader(Cursor::new(file), Some("wav"), "song").expect("a song");
    let samples = waveform.samples.len();
    assert_eq!(samples, SECONDS * SAMPLE_RATE as usize);
    let of_samples = 4 * samples as u64;
    assert!(waveform.samples.capacity() < samples * 5 / 4);
    let decoded = peak() - before;
    assert!(decoded < of_samples * 3 / 2, "{decoded} of {of_samples}");
    extract(&waveform.samples).expect("features");
    let analysed = peak() - before - of_samples;
    let estimated = Analysis::memory(samples);
    assert!(analysed < estimated, "{analysed}, estimated {estimated}");
    assert!(analysed < of_samples * 3 / 2, "{analysed} of {of_samples}");
}
