//! Decoding of half a second in four formats, of unusual files, and of damaged files.

mod mp3;
mod wav;

use std::f64::consts::TAU;
use std::io::Cursor;
use std::path::PathBuf;

use kinegrad_audio::{DecodeError, Error, SAMPLE_RATE, Waveform, decode, decode_reader};
use proptest::prelude::*;

/// Samples of `data_fixtures/audio/tones.*`.
const SAMPLES: usize = 22_050;

fn fixture(extension: &str) -> PathBuf {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../data_fixtures/audio");
    PathBuf::from(folder).join(format!("tones.{extension}"))
}

/// Left and right of `data_fixtures/audio/tones.*` before they were encoded.
fn tones() -> Vec<[f64; 2]> {
    (0..SAMPLES)
        .map(|n| {
            let t = n as f64 / f64::from(SAMPLE_RATE);
            let a = 0.5 * (TAU * 440.0 * t).sin() * (-2.0 * t).exp();
            let b = 0.25 * (TAU * 1000.0 * t).sin();
            [a + b, a - 0.5 * b]
        })
        .collect()
}

/// The average of both sides.
fn mono() -> Vec<f64> {
    tones().iter().map(|[l, r]| (l + r) / 2.0).collect()
}

/// A WAV file; `format` 1 is whole numbers, 3 floating point.
fn wav(format: u16, channels: u16, rate: u32, bits: u16, data: &[u8]) -> Vec<u8> {
    let block = channels * bits / 8;
    let mut out = b"RIFF".to_vec();
    out.extend((36 + data.len() as u32).to_le_bytes());
    out.extend(b"WAVEfmt ");
    out.extend(16u32.to_le_bytes());
    out.extend(format.to_le_bytes());
    out.extend(channels.to_le_bytes());
    out.extend(rate.to_le_bytes());
    out.extend(rate.wrapping_mul(u32::from(block)).to_le_bytes());
    out.extend(block.to_le_bytes());
    out.extend(bits.to_le_bytes());
    out.extend(b"data");
    out.extend((data.len() as u32).to_le_bytes());
    out.extend(data);
    out
}

fn stereo_wav() -> Vec<u8> {
    let data: Vec<u8> = tones()
        .iter()
        .flatten()
        .flat_map(|y| ((y * 32768.0).round() as i16).to_le_bytes())
        .collect();
    wav(1, 2, SAMPLE_RATE, 16, &data)
}

fn read(bytes: Vec<u8>) -> Result<Waveform, Error> {
    decode_reader(Cursor::new(bytes), None, "memory")
}

/// Root mean square of the difference. A shift by one sample would give 0.02.
fn deviation(found: &[f32], expected: &[f64]) -> f64 {
    let pairs = found.iter().zip(expected);
    let squares: f64 = pairs.map(|(a, b)| (f64::from(*a) - b).powi(2)).sum();
    (squares / found.len() as f64).sqrt()
}

#[test]
fn four_formats_give_the_same_samples() {
    let expected = mono();
    for (extension, tolerance) in [("flac", 1e-5), ("mp3", 0.013), ("ogg", 0.004)] {
        let found = decode(&fixture(extension)).expect("the fixture decodes");
        assert_eq!((found.source_rate, found.source_channels), (SAMPLE_RATE, 2));
        assert_eq!(found.damage(), None, "{extension}");
        // Encoder delay and padding are removed: all samples are in their places.
        assert_eq!(found.samples.len(), SAMPLES, "{extension}");
        let error = deviation(&found.samples, &expected);
        assert!(error < tolerance, "{extension}: {error}");
    }
    let found = read(stereo_wav()).expect("the file decodes");
    assert_eq!(found.samples.len(), SAMPLES);
    assert!(deviation(&found.samples, &expected) < 1e-5);
}

#[test]
fn lost_audio_is_reported() {
    let mp3 = std::fs::read(fixture("mp3")).expect("the fixture is readable");
    let half = mp3.len() / 2;
    let without_a_part = [&mp3[..half], &mp3[half + 4000..]].concat();
    for damaged in [mp3[..half].to_vec(), without_a_part] {
        let found = read(damaged).expect("the rest decodes");
        let lost = SAMPLES - found.samples.len();
        let lost = lost as f64 / f64::from(SAMPLE_RATE);
        assert!(lost > 0.1, "{lost}");
        assert!(
            (found.missing_seconds - lost).abs() < 1e-9,
            "{lost} {}",
            found.missing_seconds
        );
        let damage = found.damage().expect("damage");
        assert!(
            damage.contains("shorter than its headers state"),
            "{damage}"
        );
    }
    let flac = std::fs::read(fixture("flac")).expect("the fixture is readable");
    let found = read(flac[..flac.len() / 2].to_vec()).expect("the rest decodes");
    assert!(found.damage().is_some());
    // A WAV written into a pipe does not state its length.
    let mut endless = stereo_wav();
    endless[4..8].fill(0xff);
    endless[40..44].fill(0xff);
    let found = read(endless).expect("the file decodes");
    assert_eq!((found.samples.len(), found.damage()), (SAMPLES, None));
}

#[test]
fn sixteen_bits_are_divided_by_32768() {
    let data: Vec<u8> = [i16::MIN, 0, 1, i16::MAX]
        .iter()
        .flat_map(|y| y.to_le_bytes())
        .collect();
    let found = read(wav(1, 1, SAMPLE_RATE, 16, &data)).expect("the file decodes");
    assert_eq!(found.samples, [-1.0, 0.0, 1.0 / 32768.0, 32767.0 / 32768.0]);
}

#[test]
fn other_rates_are_converted() {
    let data: Vec<u8> = (0..4001u32).flat_map(|_| 0.5f32.to_le_bytes()).collect();
    let found = read(wav(3, 1, 8000, 32, &data)).expect("the file decodes");
    assert_eq!(found.source_rate, 8000);
    assert_eq!(found.samples.len(), (4001 * 44_100usize).div_ceil(8000));
    assert!((found.samples[10_000] - 0.5).abs() < 1e-4);
}

#[test]
fn errors_name_the_file_and_the_reason() {
    let reason = |bytes: Vec<u8>| match read(bytes) {
        Err(Error::Decode { error, .. }) => error,
        found => panic!("{found:?}"),
    };
    let folder = tempfile::tempdir().expect("a folder");
    let missing = folder.path().join("missing.mp3");
    let error = decode(&missing).expect_err("no such file");
    let is_read = matches!(
        &error,
        Error::Decode {
            error: DecodeError::Read { .. },
            ..
        }
    );
    assert!(is_read, "{error:?}");
    assert!(error.to_string().contains("missing.mp3"));

    assert_eq!(reason(vec![]), DecodeError::Empty);
    let text = b"this is no music at all".repeat(200);
    assert!(matches!(reason(text), DecodeError::UnknownFormat { .. }));
    assert!(matches!(
        reason(wav(1, 1, 0, 16, &[0; 64])),
        DecodeError::SampleRate { found: 0, .. } | DecodeError::UnknownFormat { .. }
    ));
    assert!(matches!(
        reason(wav(1, 1, 4_000_000_000, 16, &[0; 64])),
        DecodeError::SampleRate { .. }
    ));
    assert!(matches!(
        reason(wav(1, 1, SAMPLE_RATE, 16, &[])),
        DecodeError::NothingDecoded { .. } | DecodeError::UnknownFormat { .. }
    ));
    let nan: Vec<u8> = [0.0, f32::NAN]
        .iter()
        .flat_map(|y| y.to_le_bytes())
        .collect();
    assert!(matches!(
        reason(wav(3, 1, SAMPLE_RATE, 32, &nan)),
        DecodeError::DecodedSample { .. }
    ));
}

#[test]
fn a_damaged_mp3_packet_keeps_the_time_of_the_rest() {
    let mut bytes = std::fs::read(fixture("mp3")).expect("the fixture is there");
    let half = bytes.len() / 2;
    bytes[half..half + 300].fill(0xff);
    let found = decode_reader(Cursor::new(bytes), Some("mp3"), "memory").expect("the rest decodes");
    assert!(found.samples.iter().all(|y| y.is_finite()));
    assert!(found.samples.len() + 2 * 1152 >= SAMPLES);
}

#[test]
fn a_file_that_was_cut_off_gives_its_first_part() {
    // The Ogg file is a single page, which is lost as a whole.
    for extension in ["flac", "mp3"] {
        let mut bytes = std::fs::read(fixture(extension)).expect("the fixture is there");
        bytes.truncate(bytes.len() * 3 / 4);
        let found = read(bytes).expect("the beginning decodes");
        assert!(found.samples.len() > SAMPLES / 4, "{extension}");
        let error = deviation(&found.samples[..SAMPLES / 4], &mono());
        assert!(error < 0.018, "{extension}: {error}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(192))]
    #[test]
    fn no_damage_makes_the_decoder_panic(
        format in 0usize..4,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..24),
        // Most failures come from the first bytes.
        early in prop::collection::vec((0usize..200, any::<u8>()), 0..6),
        part in 0.0f64..1.2,
    ) {
        let mut bytes = match ["flac", "mp3", "ogg"].get(format) {
            Some(extension) => std::fs::read(fixture(extension))?,
            None => stereo_wav(),
        };
        for (index, value) in changes {
            let position = index.index(bytes.len());
            bytes[position] = value;
        }
        for (position, value) in early {
            bytes[position] = value;
        }
        bytes.truncate((bytes.len() as f64 * part) as usize);
        if let Ok(found) = read(bytes) {
            prop_assert!(found.samples.iter().all(|y| y.is_finite()));
        }
    }

    #[test]
    fn no_bytes_make_the_decoder_panic(bytes in prop::collection::vec(any::<u8>(), 0..3000)) {
        if let Ok(found) = read(bytes) {
            prop_assert!(found.samples.iter().all(|y| y.is_finite()));
        }
    }
}
