//! A song's features over its whole length.

use std::path::Path;

use kinegrad_data::AudioFeatures;

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

impl Song {
    /// Reads the song at `path`.
    ///
    /// # Errors
    /// Why it cannot be used, in words that name the file.
    pub fn read(path: &Path) -> Result<Self, String> {
        let waveform = kinegrad_audio::decode(path).map_err(|error| error.to_string())?;
        let features = kinegrad_audio::extract(&waveform.samples)
            .map_err(|error| format!("{}: {error}", path.display()))?;
        let damage = waveform.damage();
        Ok(Self {
            tempo: features.beats().tempo,
            beats: features.beats().times(),
            features: AudioFeatures::from(&features),
            damage: damage.map(|damage| format!("the song: {damage}")),
        })
    }
}
