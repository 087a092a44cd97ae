//! A song's features over its whole length.

use std::path::Path;

use kinegrad_audio::{Analysis, Beats};
use kinegrad_data::AudioFeatures;

/// What preparation needs of a song.
#[derive(Debug)]
pub(super) struct Song {
    /// The 163 features.
    pub features: AudioFeatures,
    /// The beats that are tracked where nothing is known of them.
    pub beats: Beats,
    /// Onset strength that beats are tracked in, `[T]`.
    pub onset: Vec<f32>,
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
        let analysis = Analysis::new(&waveform.samples)
            .map_err(|error| format!("{}: {error}", path.display()))?;
        let onset = analysis.onset.median.clone();
        let features = analysis.features();
        let damage = waveform.damage();
        Ok(Self {
            beats: features.beats().clone(),
            onset,
            features: AudioFeatures::from(&features),
            damage: damage.map(|damage| format!("the song: {damage}")),
        })
    }
}
