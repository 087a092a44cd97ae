//! A song's features over its whole length.

use std::cell::OnceCell;
use std::path::Path;

use crate::AudioFeatures;

/// What preparation needs of a song.
#[derive(Debug)]
pub(super) struct Song {
    pub features: AudioFeatures,
    /// Beats per minute, as tracked; 0 where there is none.
    pub tempo: f64,
    /// Seconds of the tracked beats.
    pub beats: Vec<f64>,
    /// What of it was lost, in words.
    pub damage: Option<String>,
}

/// A song that is read when the first take asks for it.
#[derive(Debug)]
pub(super) struct LazySong<'a> {
    path: &'a Path,
    song: OnceCell<Result<Song, String>>,
}

impl<'a> LazySong<'a> {
    /// The song at `path`, not read yet.
    pub fn new(path: &'a Path) -> Self {
        Self {
            path,
            song: OnceCell::new(),
        }
    }

    /// The song.
    ///
    /// # Errors
    /// Why it cannot be used, in words that name the file.
    pub fn get(&self) -> Result<&Song, String> {
        let song = self.song.get_or_init(|| read(self.path));
        song.as_ref().map_err(String::clone)
    }
}

fn read(path: &Path) -> Result<Song, String> {
    let waveform = kinegrad_audio::decode(path).map_err(|error| error.to_string())?;
    let features = kinegrad_audio::extract(&waveform.samples)
        .map_err(|error| format!("{}: {error}", path.display()))?;
    Ok(Song {
        tempo: features.beats().tempo,
        beats: features.beats().times(),
        features: AudioFeatures::from(&features),
        damage: waveform
            .damage()
            .map(|damage| format!("the song: {damage}")),
    })
}
