//! Which phrases are danced to one song.

use std::collections::{BTreeMap, BTreeSet};

use kinegrad_random::{Key, Purpose};

use crate::manifest::{self, ManifestRow};
use crate::{DataConfig, DataKind, Error, Store, synthetic};

/// The song of the phrase `id`: the `audio_source` that its manifest states, else the take that ids
/// `TAKE_FIRSTFRAME` name. Each synthetic phrase has music of its own.
pub fn song_of(id: &str, audio_source: Option<&str>) -> String {
    let made_up = || {
        let number = id.rsplit_once('_')?.1.parse().ok()?;
        (id == synthetic::id(number)).then_some(id)
    };
    let take = || id.rsplit_once('_').map_or(id, |(take, _)| take);
    let song = audio_source.or_else(made_up);
    song.unwrap_or_else(take).to_owned()
}

/// The part `fraction` of `songs` that is held out, in alphabetical order: those with the lowest
/// hashes of their names, at least one if `fraction` is not 0, never all. Depends on the names alone.
pub fn held_out_songs(songs: BTreeSet<String>, fraction: f64) -> Vec<String> {
    let most = songs.len().saturating_sub(1);
    let share = (fraction * songs.len() as f64).round() as usize;
    let wanted = if fraction > 0.0 { share.max(1) } else { 0 };
    let hash = |song: &String| Key::new(0, Purpose::Split).named(song).uniform();
    let mut order: Vec<(f64, String)> = songs.into_iter().map(|song| (hash(&song), song)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    order.truncate(wanted.min(most));
    let mut held_out: Vec<String> = order.into_iter().map(|(_, song)| song).collect();
    held_out.sort_unstable();
    held_out
}

/// What a dataset says of the music of its phrases.
#[derive(Clone, Debug, Default)]
pub struct Songs {
    stated: BTreeMap<String, ManifestRow>,
}

impl Songs {
    /// What the manifest of the dataset that `config` describes says; nothing where it has none, or
    /// this build reads none.
    ///
    /// # Errors
    /// [`Error::Scheme`], [`Error::Store`], and [`Error::Manifest`] for a manifest that cannot be
    /// used.
    pub fn read(config: &DataConfig) -> Result<Self, Error> {
        if config.kind != DataKind::Phrases {
            return Ok(Self::default());
        }
        let source = config.source.as_deref().unwrap_or_default();
        let rows = match manifest::read(&Store::open(source, &config.store)?) {
            Ok(rows) => rows.unwrap_or_default(),
            Err(Error::Feature { .. }) => Vec::new(),
            Err(error) => return Err(error),
        };
        let stated = rows.into_iter().map(|row| (row.id.clone(), row));
        Ok(Self {
            stated: stated.collect(),
        })
    }

    /// The song of a phrase, see [`song_of`].
    pub fn song(&self, id: &str) -> String {
        let row = self.stated.get(id);
        song_of(id, row.and_then(|row| row.audio_source.as_deref()))
    }

    /// The tempo of a phrase, beats per minute, where the manifest states one.
    pub fn tempo(&self, id: &str) -> Option<f64> {
        self.stated.get(id)?.tempo
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn takes_stand_for_songs_that_are_not_stated() {
        for (id, stated, song) in [
            ("C_5_00188", None, "C_5"),
            ("C_5_00188", Some("songs/cha.mp3"), "songs/cha.mp3"),
            ("alone", None, "alone"),
            ("synthetic_00007", None, "synthetic_00007"),
            ("synthetic_7", None, "synthetic"),
            ("a_synthetic_00007", None, "a_synthetic"),
        ] {
            assert_eq!(song_of(id, stated), song, "{id} {stated:?}");
        }
    }

    #[test]
    fn datasets_without_a_manifest_state_nothing() {
        let folder = tempfile::tempdir().unwrap();
        synthetic::write_dataset(folder.path(), 2, 8, 1).unwrap();
        let config = DataConfig {
            source: Some(folder.path().display().to_string()),
            ..DataConfig::default()
        };
        let songs = Songs::read(&config).unwrap();
        assert_eq!(songs.song("W_1_00030"), "W_1");
        assert_eq!(songs.tempo("W_1_00030"), None);
        let made_up = DataConfig {
            kind: DataKind::Synthetic,
            ..DataConfig::default()
        };
        assert_eq!(Songs::read(&made_up).unwrap().song("a_0"), "a");
    }
}
