//! The songs of phrases, by the manifest.

use std::collections::BTreeMap;

use super::ManifestRow;
use crate::{DataConfig, DataKind, Error, Store, song_of};

/// The manifest's facts about the music of phrases.
#[derive(Clone, Debug, Default)]
pub struct Songs {
    stated: BTreeMap<String, ManifestRow>,
}

impl Songs {
    /// Reads the manifest of the dataset of `config`; empty without a manifest, or if this build
    /// cannot read manifests. Fails with [`Error::Scheme`], [`Error::Store`], and
    /// [`Error::Manifest`] for an invalid manifest.
    pub fn read(config: &DataConfig) -> Result<Self, Error> {
        if config.kind != DataKind::Phrases {
            return Ok(Self::default());
        }
        let source = config.source.as_deref().unwrap_or_default();
        let rows = match super::read(&Store::open(source, &config.store)?) {
            Ok(rows) => rows.unwrap_or_default(),
            Err(Error::Feature { .. }) => Vec::new(),
            Err(error) => return Err(error),
        };
        let stated = rows.into_iter().map(|row| (row.id.clone(), row));
        Ok(Self {
            stated: stated.collect(),
        })
    }

    /// The song of a phrase, as in [`song_of`].
    pub fn song(&self, id: &str) -> String {
        let row = self.stated.get(id);
        song_of(id, row.and_then(|row| row.audio_source.as_deref()))
    }

    /// The tempo of a phrase, beats per minute, if the manifest has one.
    pub fn tempo(&self, id: &str) -> Option<f64> {
        self.stated.get(id)?.tempo
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    #[test]
    fn datasets_without_a_manifest_state_nothing() {
        let folder = tempfile::tempdir().unwrap();
        synthetic::write_dataset(folder.path(), crate::AudioLayout::CCMOTION, 2, 8, 1).unwrap();
        let config = DataConfig {
            source: Some(folder.path().display().to_string()),
            ..DataConfig::default()
        };
        let songs = Songs::read(&config).unwrap();
        assert_eq!(songs.song("W_1_00030"), "W_1");
        assert_eq!(songs.tempo("W_1_00030"), None);
        let synthetic = DataConfig {
            kind: DataKind::Synthetic,
            ..DataConfig::default()
        };
        assert_eq!(Songs::read(&synthetic).unwrap().song("a_0"), "a");
    }
}
