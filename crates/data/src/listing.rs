//! The phrases of a dataset, from the manifest or the folders.

use std::collections::{BTreeMap, HashMap};

use crate::audio_layout::AudioLayout;
use crate::digest::Digest;
use crate::layout::{AUDIO_FILE, MANIFEST, MOTION_FILE, PREPARATION};
use crate::manifest::{self, ManifestRow};
use crate::split::Side;
use crate::store::Store;
use crate::{Error, StoreError};

/// An item in the listing of a dataset.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Listed {
    pub id: String,
    /// The item's side of the split, if the dataset defines the split.
    pub side: Option<Side>,
    /// The item's files in layout order; for a phrase, motion and audio features.
    pub files: Vec<Expected>,
}

impl Listed {
    /// Entries for synthetic items without files.
    pub fn synthetic(items: usize, id: impl Fn(usize) -> String) -> Vec<Self> {
        let listed = |number| Self {
            id: id(number),
            side: None,
            files: Vec::new(),
        };
        (0..items).map(listed).collect()
    }
}

/// The ids of listed items.
pub(crate) fn ids(listed: &[Listed]) -> impl Iterator<Item = &str> + Clone {
    listed.iter().map(|item| item.id.as_str())
}

/// The expected checksum or version of a file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Expected {
    /// The file's checksum, from the manifest.
    Checksum(Digest),
    /// The file's version from a listing; empty if unknown.
    Version(String),
}

/// All phrases of a dataset, sorted by id.
#[derive(Debug, Default)]
pub(crate) struct Listing {
    pub phrases: Vec<Listed>,
    /// Ids with motion only.
    pub only_motion: Vec<String>,
    /// Ids with audio features only.
    pub only_audio: Vec<String>,
    pub warnings: Vec<String>,
    /// The first phrase without beat features in the manifest.
    pub without_beats: Option<String>,
    /// Labels in the manifest, by id.
    pub labels: HashMap<String, String>,
}

impl Listing {
    /// Reads the manifest or, without a manifest, lists the folders.
    pub fn read(store: &Store) -> Result<Self, Error> {
        let object = || store.name_of(MANIFEST);
        match manifest::read(store) {
            Ok(Some(rows)) => Ok(Self::of(rows)),
            Ok(None) if prepared(store)? => Err(Error::Manifest {
                object: object(),
                problem: "it is missing: the dataset's preparation has not ended".to_owned(),
            }),
            Ok(None) => list(store),
            // In a prepared dataset, old phrases outside the manifest may remain.
            Err(Error::Feature { .. }) if store.is_writable() && !prepared(store)? => {
                let mut listing = list(store)?;
                listing.warnings.push(format!(
                    "{} is not read by this build (feature `manifest`): its checksums \
                     and its split are ignored",
                    object()
                ));
                Ok(listing)
            }
            Err(error) => Err(error),
        }
    }

    /// The phrases of a manifest.
    fn of(rows: Vec<ManifestRow>) -> Self {
        let lacking = |row: &&ManifestRow| {
            let groups = row.audio_features.as_deref();
            groups.is_some_and(|groups| !AudioLayout::of(groups).beats)
        };
        let without_beats = rows.iter().find(lacking).map(|row| row.id.clone());
        let label = |row: &ManifestRow| Some((row.id.clone(), row.label.clone()?));
        let labels = rows.iter().filter_map(label).collect();
        let phrase = |row: ManifestRow| Listed {
            id: row.id,
            side: row.split,
            files: [row.motion_sha256, row.audio_sha256]
                .map(Expected::Checksum)
                .to_vec(),
        };
        let mut phrases: Vec<Listed> = rows.into_iter().map(phrase).collect();
        phrases.sort_unstable_by(|a, b| a.id.cmp(&b.id));
        Self {
            phrases,
            without_beats,
            labels,
            ..Self::default()
        }
    }
}

/// True if `kinegrad data prepare` has started to write to this store.
fn prepared(store: &Store) -> Result<bool, Error> {
    Ok(store.is_writable() && store.find(PREPARATION, u64::MAX - 1)?.is_some())
}

fn list(store: &Store) -> Result<Listing, Error> {
    let missing = |error| match error {
        StoreError::Missing(object) => Error::MissingFolder(object.into()),
        error => error.into(),
    };
    // Listings are sorted by `ID/`.
    let mut found: BTreeMap<String, [Option<String>; 2]> = BTreeMap::new();
    for (kind, (folder, file)) in [MOTION_FILE, AUDIO_FILE].into_iter().enumerate() {
        for object in store.list(folder, file).map_err(missing)? {
            let id = &object.path[folder.len() + 1..object.path.len() - file.len()];
            found.entry(id.to_owned()).or_default()[kind] = Some(object.version);
        }
    }
    let mut listing = Listing::default();
    for (id, versions) in found {
        let id = id.trim_end_matches('/').to_owned();
        match versions {
            [Some(motion), Some(audio)] => listing.phrases.push(Listed {
                id,
                side: None,
                files: [motion, audio].map(Expected::Version).to_vec(),
            }),
            [Some(_), None] => listing.only_motion.push(id),
            [None, _] => listing.only_audio.push(id),
        }
    }
    Ok(listing)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StoreConfig;
    use std::fs;

    #[test]
    fn a_listing_pairs_the_folders() {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "motion/b",
            "motion/a",
            "motion/only",
            "motion/.hidden",
            "audio_features/a",
            "audio_features/b",
            "audio_features/alone",
        ] {
            fs::create_dir_all(folder.path().join(name)).unwrap();
        }
        fs::write(folder.path().join("motion/file"), b"").unwrap();
        let store = Store::open(
            &folder.path().display().to_string(),
            &StoreConfig::default(),
        )
        .unwrap();
        let listing = Listing::read(&store).unwrap();
        let ids: Vec<_> = listing.phrases.iter().map(|p| p.id.as_str()).collect();
        assert_eq!(ids, ["a", "b"]);
        assert_eq!(listing.only_motion, ["only"]);
        assert_eq!(listing.only_audio, ["alone"]);
    }
}
