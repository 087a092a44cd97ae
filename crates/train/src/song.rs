//! Songs and their features.

use std::fs;
use std::path::{Path, PathBuf};

use kinegrad_audio::{
    Analysis, Features, Pulse, SAMPLE_RATE, Waveform, decode, extract, extract_near,
};
use miette::Diagnostic;
use serde::{Deserialize, Serialize};

use crate::error::Error;
use crate::memory::must_fit;

/// Tempi that can be stated, in beats per minute.
const TEMPI: std::ops::RangeInclusive<f64> = 10.0..=600.0;

/// Beats in a bar if only a downbeat is stated.
const BEATS_PER_BAR: u32 = 4;

/// Known facts about a song's beats, instead of tracked ones.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct KnownBeats {
    /// Approximate tempo, beats per minute, to resolve octave errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tempo: Option<f64>,
    /// Beats in a bar.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beats_per_bar: Option<u32>,
    /// Time of a downbeat, seconds; without a downbeat, bars are unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub downbeat: Option<f64>,
}

impl KnownBeats {
    /// True if no fact is known.
    pub fn is_empty(&self) -> bool {
        self.given().is_empty()
    }

    /// Names of the known facts.
    pub fn given(&self) -> Vec<&'static str> {
        let options = [
            ("tempo", self.tempo.is_some()),
            ("beats_per_bar", self.beats_per_bar.is_some()),
            ("downbeat", self.downbeat.is_some()),
        ];
        let given = options.into_iter().filter(|(_, given)| *given);
        given.map(|(name, _)| name).collect()
    }

    /// Rejects an invalid tempo, bar or downbeat.
    ///
    /// # Errors
    /// [`Error::Usage`] for the first invalid fact.
    pub fn validate(&self) -> Result<(), Error> {
        if let Some(tempo) = self.tempo.filter(|tempo| !TEMPI.contains(tempo)) {
            let message = format!("option `tempo` is {tempo}, allowed: {TEMPI:?} beats per minute");
            return Err(Error::usage(
                message,
                "count the beats of 15 seconds, times four",
            ));
        }
        if self.beats_per_bar == Some(0) {
            let message = "option `beats_per_bar` is 0, allowed: 1 or more";
            return Err(Error::usage(
                message,
                "3 for a waltz, 4 for most other music",
            ));
        }
        if let Some(downbeat) = self.downbeat.filter(|seconds| !seconds.is_finite()) {
            let message =
                format!("option `downbeat` is {downbeat}, allowed: seconds into the song");
            return Err(Error::usage(message, "give a moment at which a bar begins"));
        }
        if self.beats_per_bar.is_some() && self.downbeat.is_none() {
            return Err(Error::usage(
                "option `beats_per_bar` without option `downbeat`",
                "pass option `downbeat` too: bars are not tracked",
            ));
        }
        Ok(())
    }

    /// The beats of a song with these features, in bars if a downbeat is known; `None` without
    /// beats.
    pub fn pulse(&self, features: &Features) -> Option<Pulse> {
        let pulse = Pulse::tracked(features.beats())?;
        Some(match self.downbeat {
            Some(downbeat) => {
                pulse.with_downbeat(self.beats_per_bar.unwrap_or(BEATS_PER_BAR), downbeat)
            }
            None => pulse,
        })
    }
}

/// Endings of songs that can be decoded.
const ENDINGS: [&str; 5] = ["flac", "mp3", "oga", "ogg", "wav"];

/// The songs in a folder, sorted by name; a file is one song.
///
/// # Errors
/// [`Error::Usage`] for a folder without songs.
pub fn songs_in(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    if folder.is_file() {
        return Ok(vec![folder.to_path_buf()]);
    }
    let entries = fs::read_dir(folder).map_err(Error::io("read", folder))?;
    let mut songs = Vec::new();
    for entry in entries {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let ending = path.extension().and_then(|ending| ending.to_str());
        let ending = ending.unwrap_or_default().to_ascii_lowercase();
        if ENDINGS.contains(&ending.as_str()) && path.is_file() {
            songs.push(path);
        }
    }
    songs.sort();
    match songs.is_empty() {
        false => Ok(songs),
        true => Err(Error::usage(
            format!("{} contains no song", folder.display()),
            format!(
                "songs end in {}",
                ENDINGS.map(|ending| format!(".{ending}")).join(", ")
            ),
        )),
    }
}

/// Decodes the song at `path` and computes its features, with beats near the `known` tempo.
///
/// # Errors
/// If the song cannot be decoded, has unusable samples, or is too long for the free memory.
pub fn song_features(path: &Path, known: &KnownBeats) -> Result<(Waveform, Features), Error> {
    known.validate()?;
    let waveform = decode(path)?;
    let samples = waveform.samples.len();
    let minutes = samples as f64 / f64::from(SAMPLE_RATE) / 60.0;
    must_fit(
        &format!("{}: the analysis of {minutes:.0} minutes", path.display()),
        Analysis::memory(samples),
        "cut the song into pieces, or free memory",
    )?;
    let features = match known.tempo {
        Some(tempo) => extract_near(&waveform.samples, tempo),
        None => extract(&waveform.samples),
    };
    let features = features.map_err(|error| {
        let hint = error.help().map(|hint| hint.to_string());
        let message = format!("{}: {error}", path.display());
        Error::usage(message, hint.unwrap_or_default())
    })?;
    Ok((waveform, features))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn songs_of_a_folder_are_sorted_and_other_files_ignored() {
        let folder = tempfile::tempdir().expect("a folder");
        let empty = songs_in(folder.path()).expect_err("no song").to_string();
        assert!(empty.contains("contains no song"), "{empty}");
        for name in ["b.WAV", "a.mp3", "notes.txt", "c.flac.part"] {
            std::fs::write(folder.path().join(name), "").expect("written");
        }
        let songs = songs_in(folder.path()).expect("songs");
        let expected = ["a.mp3", "b.WAV"].map(|name| folder.path().join(name));
        assert_eq!(songs, expected);
        assert_eq!(songs_in(&expected[0]).expect("a song"), expected[..1]);
        songs_in(&folder.path().join("none")).expect_err("no folder");
    }

    #[test]
    fn what_cannot_be_known_is_refused() {
        let known = |tempo, beats_per_bar, downbeat| KnownBeats {
            tempo,
            beats_per_bar,
            downbeat,
        };
        for (wrong, expected) in [
            (known(Some(0.0), None, None), "option `tempo` is 0"),
            (known(Some(f64::NAN), None, None), "option `tempo` is NaN"),
            (
                known(None, Some(0), Some(1.0)),
                "option `beats_per_bar` is 0",
            ),
            (known(None, Some(3), None), "option `beats_per_bar` without"),
            (
                known(None, None, Some(f64::INFINITY)),
                "option `downbeat` is inf",
            ),
        ] {
            let error = wrong.validate().expect_err(expected).to_string();
            assert!(error.starts_with(expected), "{error}");
        }
        known(Some(90.0), Some(3), Some(-0.5))
            .validate()
            .expect("a waltz");
        assert_eq!(known(None, None, Some(0.0)).given(), ["downbeat"]);
    }
}
