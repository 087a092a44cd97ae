//! Which phrases a dataset holds: from its manifest, else by listing its folders.

use crate::digest::Digest;
use crate::layout::{AUDIO_FILE, MANIFEST, MOTION_FILE, PREPARATION};
use crate::manifest::{self, ManifestRow};
use crate::split::Side;
use crate::store::{Object, Store};
use crate::{Error, StoreError};

/// An item that a dataset should hold.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Listed {
    pub id: String,
    /// Its side of the split, where the dataset states one.
    pub side: Option<Side>,
    /// Its files, in the order in which the item's layout names them; of a phrase, motion and
    /// audio features.
    pub files: Vec<Expected>,
}

impl Listed {
    /// So many items that are made up and have no files.
    pub fn made_up(items: usize, id: impl Fn(usize) -> String) -> Vec<Self> {
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

/// What is known of a file before it is read.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Expected {
    /// Its checksum, from the manifest.
    Checksum(Digest),
    /// What changes when it does, from a listing; empty where the store tells nothing.
    Version(String),
}

/// All phrases of a dataset, sorted by id.
#[derive(Debug, Default)]
pub(crate) struct Listing {
    pub phrases: Vec<Listed>,
    /// Ids with motion alone.
    pub only_motion: Vec<String>,
    /// Ids with audio features alone.
    pub only_audio: Vec<String>,
    pub warnings: Vec<String>,
}

impl Listing {
    /// Reads the manifest, or lists the folders where there is none.
    ///
    /// # Errors
    /// [`Error::Manifest`], [`Error::Store`], [`Error::MissingFolder`].
    pub fn read(store: &Store) -> Result<Self, Error> {
        let object = || store.name_of(MANIFEST);
        match manifest::read(store) {
            Ok(Some(rows)) => Ok(Self::of(rows)),
            Ok(None) if prepared(store)? => Err(Error::Manifest {
                object: object(),
                problem: "it is missing: the dataset's preparation has not ended".to_owned(),
            }),
            Ok(None) => list(store),
            // Phrases of an older plan may lie beside those of the manifest.
            Err(Error::Feature { .. }) if store.is_writable() && !prepared(store)? => {
                let mut listing = list(store)?;
                listing.warnings.push(format!(
                    "{} is not read by this build (feature `manifest`): files are not held \
                     against its checksums, and its split does not count",
                    object()
                ));
                Ok(listing)
            }
            Err(error) => Err(error),
        }
    }

    /// The phrases of a manifest.
    fn of(rows: Vec<ManifestRow>) -> Self {
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
            ..Self::default()
        }
    }
}

/// Whether `kinegrad data prepare` has begun to write here.
fn prepared(store: &Store) -> Result<bool, Error> {
    Ok(store.is_writable() && store.find(PREPARATION, u64::MAX - 1)?.is_some())
}

fn list(store: &Store) -> Result<Listing, Error> {
    let objects = |(folder, file): (&str, &str)| match store.list(folder, file) {
        Ok(objects) => Ok(objects),
        Err(StoreError::Missing { object }) => Err(Error::MissingFolder {
            path: object.into(),
        }),
        Err(error) => Err(error.into()),
    };
    let (motion, audio) = (objects(MOTION_FILE)?, objects(AUDIO_FILE)?);
    let (mut motion, mut audio) = (motion.into_iter().peekable(), audio.into_iter().peekable());
    let mut listing = Listing::default();
    loop {
        let order = match (motion.peek(), audio.peek()) {
            (Some(a), Some(b)) => id_of(a).cmp(id_of(b)),
            (Some(_), None) => std::cmp::Ordering::Less,
            (None, Some(_)) => std::cmp::Ordering::Greater,
            (None, None) => break,
        };
        let left = if order.is_le() { motion.next() } else { None };
        let right = if order.is_ge() { audio.next() } else { None };
        match (left, right) {
            (Some(left), Some(right)) => {
                let id = id_of(&left).to_owned();
                listing.phrases.push(Listed {
                    id,
                    side: None,
                    files: [left.version, right.version]
                        .map(Expected::Version)
                        .to_vec(),
                });
            }
            (Some(left), None) => listing.only_motion.push(id_of(&left).to_owned()),
            (None, Some(right)) => listing.only_audio.push(id_of(&right).to_owned()),
            (None, None) => break,
        }
    }
    Ok(listing)
}

/// The id in `FOLDER/ID/FILE`.
fn id_of(object: &Object) -> &str {
    let (folder, _) = object.path.rsplit_once('/').unwrap_or((&object.path, ""));
    folder.rsplit_once('/').map_or(folder, |(_, id)| id)
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
