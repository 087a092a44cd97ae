//! MP3 streams without a header that states their length, with tags, and several in a row.

use super::*;

/// Samples of a frame.
const FRAME: usize = 1152;

/// A silent frame of 44.1 kHz; `rate` is the index of its bit rate, `mode` 0 stereo and 3 mono.
fn frame(rate: u8, mode: u8, sampling: u8) -> Vec<u8> {
    let kilobits = [
        0, 32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320,
    ];
    let hertz = [44_100, 48_000, 32_000][usize::from(sampling)];
    let bytes = 144_000 * kilobits[usize::from(rate)] / hertz;
    let mut frame = vec![0; bytes];
    frame[..4].copy_from_slice(&[0xff, 0xfb, rate << 4 | sampling << 2, mode << 6]);
    frame
}

/// The tags of the end of a file.
fn tags() -> Vec<u8> {
    let mut ape = b"APETAGEX".to_vec();
    for word in [2000u32, 32 + 30_000, 1, 0] {
        ape.extend(word.to_le_bytes());
    }
    ape.extend([0; 8]);
    let lyrics = b"LYRICSBEGININD0000200LYR20000la la la".repeat(600);
    let mut id3 = b"TAG".to_vec();
    id3.resize(128, b' ');
    [
        vec![b'.'; 30_000],
        ape,
        lyrics,
        b"024000LYRICS200".to_vec(),
        id3,
    ]
    .concat()
}

#[test]
fn variable_bit_rates_are_decoded_to_the_end() {
    // The first frames are ten times as long as the others, or the others as the first.
    for (first, other) in [(14, 1), (1, 14)] {
        let loud = frame(first, 0, 0).repeat(40);
        let quiet = frame(other, 0, 0).repeat(300);
        let bytes = [loud, quiet].concat();
        for end in [Vec::new(), tags()] {
            let found = read([&bytes[..], &end].concat()).expect("music");
            assert_eq!(found.samples.len(), 340 * FRAME);
            assert_eq!(found.damage(), None);
        }
    }
}

#[test]
fn a_tag_at_the_end_is_no_missing_music() {
    let music = std::fs::read(fixture("mp3")).expect("the fixture is readable");
    let found = read([music, tags()].concat()).expect("music");
    assert_eq!((found.samples.len(), found.damage()), (SAMPLES, None));
    // Without the first frame, which states the length.
    let music = frame(9, 0, 0).repeat(200);
    let found = read([music, tags()].concat()).expect("music");
    assert_eq!((found.samples.len(), found.damage()), (200 * FRAME, None));
}

#[test]
fn several_files_in_a_row_are_decoded_to_the_end() {
    let music = std::fs::read(fixture("mp3")).expect("the fixture is readable");
    let found = read([&music[..], &tags(), &music, &music].concat()).expect("music");
    assert_eq!(found.damage(), None);
    // The encoder's delay and padding of the second and third file are in.
    let more = found.samples.len() - 3 * SAMPLES;
    assert!(more < 6 * FRAME, "{more}");
    let expected = mono();
    assert!(deviation(&found.samples[..SAMPLES], &expected) < 0.013);
    // Mono frames behind stereo frames.
    let frames = [frame(9, 0, 0).repeat(30), frame(9, 3, 0).repeat(30)].concat();
    let found = read(frames).expect("music");
    assert_eq!((found.samples.len(), found.damage()), (60 * FRAME, None));
}

#[test]
fn frames_of_another_rate_are_refused_and_single_ones_are_dropped() {
    let frames = |count| [frame(9, 0, 0).repeat(30), frame(9, 0, 1).repeat(count)].concat();
    let message = read(frames(30)).expect_err("two rates").to_string();
    assert!(
        message.contains("from 44100 to 48000 Hz at second 0.78"),
        "{message}"
    );
    let bytes = [frames(2), frame(9, 0, 0).repeat(30)].concat();
    let found = read(bytes).expect("music");
    assert_eq!((found.samples.len(), found.damage()), (60 * FRAME, None));
}

#[test]
fn an_mp3_stream_in_a_wav_file_is_decoded() {
    let stream = frame(9, 0, 0).repeat(20);
    let mut bytes = wav::riff(0, &[]);
    bytes.extend(wav::chunk(
        b"fmt ",
        &[wav::format(0x55, 0), vec![0; 14]].concat(),
    ));
    bytes.extend(wav::chunk(b"data", &stream));
    bytes.extend(wav::chunk(b"LIST", b"INFO"));
    let found = read(bytes).expect("music");
    assert_eq!((found.samples.len(), found.damage()), (20 * FRAME, None));
}
