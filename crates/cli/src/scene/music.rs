//! The song of a scene.

use std::path::PathBuf;

use kinegrad_audio::{SAMPLE_RATE, extract};
use kinegrad_data::file::read_file;
use kinegrad_report::scene::{Song, SongFormat};
use kinegrad_train::Error;
use kinegrad_train::memory::must_fit;
use serde::Deserialize;

use crate::output::unusable;

/// Largest record, bytes.
const LARGEST_RECORD: u64 = 1 << 26;

/// Largest file of a song, bytes.
const LARGEST: u64 = 1 << 30;

/// A song, and the motion's start in the song.
#[derive(Clone, Debug)]
pub struct Music {
    /// The file.
    pub song: PathBuf,
    /// Second of the song at which the motion starts.
    pub start: f64,
}

/// The part of a record that is read.
#[derive(Deserialize)]
struct Record {
    condition: Conditions,
}

#[derive(Deserialize)]
struct Conditions {
    song: Option<Recorded>,
}

#[derive(Deserialize, PartialEq)]
struct Recorded {
    file: PathBuf,
    start: f64,
}

/// The song that the records beside the motions name, if it is the same for all that have one.
pub fn recorded(motions: &[PathBuf]) -> Option<Music> {
    let songs = motions.iter().filter_map(|motion| {
        let bytes = read_file(&motion.with_extension("json"), LARGEST_RECORD).ok()?;
        serde_json::from_slice::<Record>(&bytes)
            .ok()?
            .condition
            .song
    });
    let songs: Vec<Recorded> = songs.collect();
    let first = songs.first()?;
    if songs.iter().any(|song| song != first) {
        return None;
    }
    let (song, start) = (first.file.clone(), first.start);
    let shown = song.display();
    if !song.is_file() {
        tell!(
            "note: the record names the song {shown}, which is not there; `--audio` gives another"
        );
        return None;
    }
    tell!(
        "note: {shown} from {start} s, as the record has it; `--audio` and `--start` change that"
    );
    Some(Music { song, start })
}

/// The song with its beats during `seconds` of motion: the file, or the part during the motion as
/// uncompressed mono if that part is smaller. Fails if the song cannot be decoded, or the motion
/// would start outside the song.
pub fn song(music: &Music, seconds: f64) -> Result<Song, Error> {
    let Music { song: path, start } = music;
    let waveform = kinegrad_audio::decode(path)?;
    let rate = f64::from(SAMPLE_RATE);
    let length = waveform.samples.len() as f64 / rate;
    if !(0.0..length).contains(start) {
        let path = path.display();
        let message = format!("`--start` is {start}, the song has {length:.1} s: {path}");
        let hint = "give the second of the song at which the motion starts";
        return Err(Error::usage(message, hint));
    }
    let from = (start * rate) as usize;
    let to = (((start + seconds) * rate).ceil() as usize).min(waveform.samples.len());
    let part = &waveform.samples[from..to];
    // An excerpt has too few beats to find its tempo: beats are those of the whole song.
    must_fit(
        &format!("{}: the beats of {length:.0} s", path.display()),
        kinegrad_audio::Analysis::memory(waveform.samples.len()),
        "cut the song, or free memory",
    )?;
    let beats = extract(&waveform.samples)
        .map_err(unusable)?
        .beats()
        .times();
    let during = |beat: &f64| (from as f64 / rate..=to as f64 / rate).contains(beat);
    let beats: Vec<f64> = beats.into_iter().filter(during).collect();
    let bytes = read_file(path, LARGEST).map_err(Error::io("read", path))?;
    let shift = from as f64 / rate;
    let uncompressed = HEADER + 2 * part.len();
    Ok(match SongFormat::of(&bytes) {
        Some(format) if bytes.len() <= uncompressed => Song {
            format,
            bytes,
            start: shift,
            beats,
        },
        _ => Song {
            format: SongFormat::Wav,
            bytes: wav(part),
            start: 0.0,
            beats: beats.into_iter().map(|beat| beat - shift).collect(),
        },
    })
}

/// Bytes of a WAV file before its samples.
const HEADER: usize = 44;

/// Mono samples as a WAV file of 16 bits.
fn wav(samples: &[f32]) -> Vec<u8> {
    let data = 2 * samples.len() as u32;
    let mut bytes = Vec::with_capacity(HEADER + data as usize);
    bytes.extend(b"RIFF");
    bytes.extend((data + HEADER as u32 - 8).to_le_bytes());
    bytes.extend(b"WAVEfmt ");
    bytes.extend(16u32.to_le_bytes());
    // Integer samples, one channel.
    bytes.extend([1u16, 1].map(u16::to_le_bytes).concat());
    bytes.extend(
        [SAMPLE_RATE, 2 * SAMPLE_RATE]
            .map(u32::to_le_bytes)
            .concat(),
    );
    bytes.extend([2u16, 16].map(u16::to_le_bytes).concat());
    bytes.extend(b"data");
    bytes.extend(data.to_le_bytes());
    // The conversion to an integer saturates.
    let level = |sample: &f32| ((sample * 32768.0).round() as i16).to_le_bytes();
    bytes.extend(samples.iter().flat_map(level));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Five seconds with a click every half second.
    fn clicks() -> Vec<f32> {
        let sample = |n: u32| match n % (SAMPLE_RATE / 2) {
            0..400 => 0.8 * (n as f32 * 0.3).sin(),
            _ => 0.0,
        };
        (0..5 * SAMPLE_RATE).map(sample).collect()
    }

    #[test]
    fn beats_of_an_excerpt_are_those_of_the_song() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("song.wav");
        let long: Vec<f32> = (0..6).flat_map(|_| clicks()).collect();
        std::fs::write(&path, wav(&long)).unwrap();
        let beats = |start, seconds| {
            let music = Music {
                song: path.clone(),
                start,
            };
            let song = song(&music, seconds).unwrap();
            let beats = song.beats.iter().map(|beat| beat - song.start + start);
            beats.collect::<Vec<f64>>()
        };
        let all = beats(0.0, 30.0);
        let during: Vec<f64> = all
            .into_iter()
            .filter(|beat| (11.2..15.2).contains(beat))
            .collect();
        let part = beats(11.2, 4.0);
        assert_eq!(part.len(), during.len());
        assert_eq!(part.len(), 8);
        assert!(part.iter().zip(during).all(|(a, b)| (a - b).abs() < 1e-4));
    }

    #[test]
    fn records_name_the_song() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let song = at("song.mp3");
        let record = |name: &str, start: f64| {
            let condition = serde_json::json!({ "song": { "file": song, "start": start } });
            let text = serde_json::json!({ "seed": 1, "condition": condition }).to_string();
            std::fs::write(at(name), text).unwrap();
        };
        record("a.json", 30.0);
        let motions = ["a.npy", "none.npy"].map(at);
        assert!(recorded(&motions).is_none(), "the song is not there");
        std::fs::write(&song, "").unwrap();
        let found = recorded(&motions).unwrap();
        assert_eq!((found.song, found.start), (song.clone(), 30.0));
        record("b.json", 59.0);
        assert!(recorded(&["a.npy", "b.npy"].map(at)).is_none());
        assert!(recorded(&[at("none.npy")]).is_none());
    }

    #[test]
    fn the_part_during_the_motion_is_used_if_it_is_smaller() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("song.wav");
        std::fs::write(&path, wav(&clicks())).unwrap();
        let at = |start| Music {
            song: path.clone(),
            start,
        };
        let part = song(&at(1.5), 2.0).unwrap();
        assert_eq!(part.start, 0.0);
        assert!(part.bytes == wav(&clicks()[66150..154350]));
        assert!(part.beats.iter().all(|beat| (0.0..2.1).contains(beat)));
        let whole = song(&at(0.0), 9.0).unwrap();
        assert_eq!(whole.bytes.len(), HEADER + 10 * SAMPLE_RATE as usize);
        assert!(song(&at(5.5), 1.0).is_err());
    }
}
