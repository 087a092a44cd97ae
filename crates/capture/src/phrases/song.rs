//! A song's features over its whole length.

use std::path::Path;

use kinegrad_audio::{Analysis, Beats};
use kinegrad_data::{AudioFeatures, AudioLayout};

/// A song's features, beats and onset strength.
#[derive(Debug)]
pub(super) struct Song {
    /// The 163 features.
    pub features: AudioFeatures,
    /// The tracked beats.
    pub beats: Beats,
    /// Onset strength for tracking beats, `[T]`.
    pub onset: Vec<f32>,
    /// Damage of the file, or a note about its length.
    pub damage: Option<String>,
}

impl Song {
    /// Reads the song at `path`.
    pub fn read(path: &Path) -> Result<Self, String> {
        let waveform = kinegrad_audio::decode(path).map_err(|error| error.to_string())?;
        let analysis = Analysis::new(&waveform.samples)
            .map_err(|error| format!("{}: {error}", path.display()))?;
        let onset = analysis.onset.median.clone();
        let features = analysis.features();
        let note = waveform.note().map(str::to_owned);
        let damage = waveform.damage().or(note);
        Ok(Self {
            beats: features.beats().clone(),
            onset,
            features: AudioFeatures::of_song(&features, AudioLayout::CCMOTION, None),
            damage: damage.map(|damage| format!("the song: {damage}")),
        })
    }
}
