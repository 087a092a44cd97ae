//! WAV files as recorders and editors write them.

use kinegrad_audio::DecodeError;

use super::*;

/// A chunk without pad byte.
pub(super) fn chunk(name: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let size = data.len() as u32;
    [&name[..], &size.to_le_bytes(), data].concat()
}

/// The fields of a `fmt ` chunk of mono samples at 44.1 kHz.
pub(super) fn format(tag: u16, bits: u16) -> Vec<u8> {
    let block = bits.div_ceil(8);
    let rate = SAMPLE_RATE;
    let words = |words: [u16; 2]| words.map(u16::to_le_bytes).concat();
    let rates = [rate, rate * u32::from(block)].map(u32::to_le_bytes);
    [words([tag, 1]), rates.concat(), words([block, bits])].concat()
}

/// The fields of an extensible format with a channel mask.
fn extensible(tag: u16, bits: u16, mask: u32) -> Vec<u8> {
    let mut fields = format(0xfffe, bits);
    fields.extend(22u16.to_le_bytes());
    fields.extend(bits.to_le_bytes());
    fields.extend(mask.to_le_bytes());
    fields.extend(tag.to_le_bytes());
    fields.extend([0, 0, 0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71]);
    fields
}

/// Three samples of 16 bits and their values.
const SAMPLES_16: [u8; 6] = [0, 0x40, 0, 0xc0, 1, 0];
const VALUES: [f32; 3] = [0.5, -0.5, 1.0 / 32768.0];

/// A file with these chunks that states `size` as its own.
pub(super) fn riff(size: u32, chunks: &[Vec<u8>]) -> Vec<u8> {
    [b"RIFF", &size.to_le_bytes()[..], b"WAVE", &chunks.concat()].concat()
}

/// The chunks of a plain file.
fn plain() -> [Vec<u8>; 2] {
    [chunk(b"fmt ", &format(1, 16)), chunk(b"data", &SAMPLES_16)]
}

fn samples(bytes: Vec<u8>, case: &str) -> Waveform {
    let found = read(bytes);
    found.unwrap_or_else(|error| panic!("{case}: {error}"))
}

/// Checks that `bytes` decode to [`VALUES`] without damage or note.
fn is_read(bytes: Vec<u8>, case: &str) {
    let found = samples(bytes, case);
    assert_eq!(found.samples, VALUES, "{case}");
    assert_eq!((found.damage(), found.note()), (None, None), "{case}");
}

#[test]
fn the_size_of_the_whole_file_may_be_anything() {
    let right = 4 + plain().concat().len() as u32;
    for size in [0, 3, 4, right - 8, right - 6, right, right + 1000, u32::MAX] {
        is_read(riff(size, &plain()), &size.to_string());
    }
}

#[test]
fn formats_may_have_any_length() {
    let [_, data] = plain();
    for more in 0..32 {
        let fields = [format(1, 16), vec![0; more]].concat();
        let chunks = [chunk(b"fmt ", &fields), vec![0; more % 2], data.clone()];
        is_read(riff(0, &chunks), &format!("{more} more bytes"));
    }
    // Without a number of bits.
    let short = chunk(b"fmt ", &format(1, 16)[..14]);
    is_read(riff(0, &[short, data.clone()]), "14 bytes");
    for mask in [0, 1, 4, 0x8000_0000, 0xffff_ffff] {
        let fields = extensible(1, 16, mask);
        for more in [0, 6] {
            let fields = [&fields[..], &vec![0; more]].concat();
            let chunks = [chunk(b"fmt ", &fields), data.clone()];
            is_read(riff(0, &chunks), &format!("mask {mask:#x}"));
        }
    }
    let floats = VALUES.map(f32::to_le_bytes).concat();
    for fields in [
        [format(3, 32), vec![4, 0, 1, 2, 3, 4]].concat(),
        extensible(3, 32, 3),
    ] {
        let chunks = [chunk(b"fmt ", &fields), chunk(b"data", &floats)];
        is_read(riff(0, &chunks), "floats");
    }
    // 12 bits are stored in 16, and 20 in 24.
    let chunks = [chunk(b"fmt ", &format(1, 12)), data];
    is_read(riff(0, &chunks), "12 bits");
    // 24 bits are stored in 32.
    let mut fields = format(1, 32);
    fields[14] = 24;
    let samples = [1 << 30, -(1 << 30), 1 << 16]
        .map(i32::to_le_bytes)
        .concat();
    let chunks = [chunk(b"fmt ", &fields), chunk(b"data", &samples)];
    is_read(riff(0, &chunks), "24 bits in 32");
}

#[test]
fn laws_are_decoded_with_and_without_an_extension() {
    for tag in [6, 7] {
        let with = [format(tag, 8), vec![0, 0]].concat();
        let found = [format(tag, 8), with].map(|fields| {
            let chunks = [chunk(b"fmt ", &fields), chunk(b"data", &[0x80, 0x00, 0xd5])];
            samples(riff(0, &chunks), "law").samples
        });
        assert_eq!(found[0].len(), 3);
        assert_eq!(found[0], found[1]);
    }
}

#[test]
fn other_chunks_are_skipped_with_and_without_their_pad_byte() {
    let [format, data] = plain();
    for (name, content) in [
        (b"LIST", &b"INFOIART\x05\0\0\0abcde"[..]),
        (b"LIST", b"abc"),
        (b"fact", b"\x01\0\0\0\x02\0\0"),
        (b"bext", b"x"),
        (b"odd!", b"12345"),
        (b"\0\0\0\0", b"123"),
    ] {
        let other = chunk(name, content);
        for pad in [&[][..], &[0], b" "] {
            let other = [&other[..], pad].concat();
            let case = format!("{} with pad {pad:?}", String::from_utf8_lossy(name));
            let chunks = [other.clone(), format.clone(), data.clone()];
            is_read(riff(0, &chunks), &case);
            let chunks = [format.clone(), other.clone(), data.clone(), other];
            is_read(riff(0, &chunks), &case);
        }
    }
}

#[test]
fn a_length_that_was_never_written_ends_with_the_file() {
    let header = chunk(b"fmt ", &format(1, 16));
    for size in [0u32, 0x7fff_f000, 0x7fff_ffff, 0x8000_0000, u32::MAX] {
        for whole in [0, 36, u32::MAX] {
            let data = [b"data", &size.to_le_bytes()[..], &SAMPLES_16].concat();
            let found = samples(riff(whole, &[header.clone(), data]), "unknown length");
            assert_eq!(found.samples, VALUES, "{size:#x}");
            assert_eq!(found.damage(), None, "{size:#x}");
            let note = found.note().expect("a note");
            assert!(note.contains("states no length"), "{note}");
        }
    }
    // A recording without samples, followed by its description, is empty.
    let chunks = [header, chunk(b"data", &[]), chunk(b"LIST", b"INFO")];
    let Err(Error::Decode { error, .. }) = read(riff(0, &chunks)) else {
        panic!("no samples");
    };
    assert!(
        matches!(error, DecodeError::NothingDecoded { .. }),
        "{error}"
    );
}

#[test]
fn samples_beyond_the_file_are_missing() {
    let found = samples(
        riff(
            0,
            &[
                chunk(b"fmt ", &format(1, 16)),
                [b"data", &60_000u32.to_le_bytes()[..], &SAMPLES_16].concat(),
            ],
        ),
        "cut off",
    );
    assert_eq!((found.samples.len(), found.note()), (3, None));
    let damage = found.damage().expect("most of it is missing");
    assert!(damage.contains("0.68 s shorter"), "{damage}");
}

#[test]
fn lengths_of_64_bits_are_read() {
    for name in [b"RF64", b"BW64"] {
        for (length, is_note) in [(6u64, false), (0, true), (u64::MAX, true)] {
            let sizes = [[100, length, 3].map(u64::to_le_bytes).concat(), vec![0; 4]].concat();
            let data = [b"data", &u32::MAX.to_le_bytes()[..], &SAMPLES_16].concat();
            let behind = match is_note {
                true => Vec::new(),
                false => chunk(b"LIST", b"INFO"),
            };
            let format = chunk(b"fmt ", &format(1, 16));
            let chunks = [chunk(b"ds64", &sizes), format, data, behind];
            let mut bytes = riff(u32::MAX, &chunks);
            bytes[..4].copy_from_slice(name);
            let found = samples(bytes, "64 bits");
            assert_eq!(
                (&found.samples[..], found.note().is_some()),
                (&VALUES[..], is_note)
            );
        }
    }
}

#[test]
fn a_format_behind_the_samples_is_read() {
    let [format, data] = plain();
    let note = chunk(b"LIST", b"INFO");
    for chunks in [
        vec![data.clone(), format.clone()],
        vec![
            note.clone(),
            data.clone(),
            note.clone(),
            format.clone(),
            note,
        ],
        vec![data.clone(), [format, data].concat()],
    ] {
        is_read(riff(0, &chunks), &format!("{chunks:?}"));
    }
}

#[test]
fn files_in_big_endian_order_and_of_many_channels_are_refused_with_the_reason() {
    let error = |bytes: Vec<u8>| match read(bytes) {
        Err(Error::Decode { error, .. }) => error.to_string(),
        other => panic!("{other:?}"),
    };
    let mut big_endian = riff(0, &plain());
    big_endian[..4].copy_from_slice(b"RIFX");
    assert_eq!(
        error(big_endian),
        "a WAV file in big-endian order (RIFX), which is not read"
    );
    for (format, bits) in [(1, 8), (1, 16), (3, 32)] {
        let wav = |channels: u16| {
            let bytes = vec![0; usize::from(channels * bits / 8) * 3];
            super::wav(format, channels, SAMPLE_RATE, bits, &bytes)
        };
        let most = samples(wav(26), "26 channels");
        assert_eq!((most.source_channels, most.samples.len()), (26, 3));
        for channels in [0, 27, 64, 255] {
            let expected = format!("{channels} channels found, 1 to 26 allowed");
            assert_eq!(error(wav(channels)), expected);
        }
    }
}
