//! The phrases of an opened dataset, read when they are asked for.
//!
//! Opening a dataset reads every phrase once and notes the checksums of its files. From then on a
//! phrase comes from memory, from the disk cache or from the store again, and in the last two
//! cases only with those checksums: what changes under a run is never trained on.

use std::sync::Arc;

use crate::cache::{DiskCache, MemoryCache};
use crate::digest::Digest;
use crate::layout::{features_path, motion_path};
use crate::listing::{Expected, Listed};
use crate::npy::MAX_MOTION_BYTES;
use crate::npz::MAX_FEATURES_BYTES;
use crate::phrase::Named;
use crate::split::Side;
use crate::store::Store;
use crate::{Counters, Error, FileError, Phrase, StoreError, SyntheticConfig, synthetic};

/// Tries of a file whose bytes are not those expected: the first may have been damaged under way.
const TRIES: usize = 3;

/// Where phrases come from, and those that are held in memory.
#[derive(Debug)]
pub(crate) struct Library {
    pub entries: Vec<Entry>,
    origin: Origin,
    memory: MemoryCache,
    pub counters: Arc<Counters>,
}

/// What is known of a phrase that can be used.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    pub id: String,
    pub frames: usize,
    /// Its side of the split, where the manifest states one.
    pub side: Option<Side>,
    /// Checksums of the motion and of the audio file; none where there are no files.
    content: Option<(Digest, Digest)>,
    /// Number of the phrase in its origin.
    number: usize,
}

/// The makers of phrases.
#[derive(Debug)]
pub(crate) enum Origin {
    /// Made up anew each time.
    Synthetic(SyntheticConfig),
    /// Read from files.
    Files(Files),
    /// All there already.
    Held(Vec<Arc<Phrase>>),
}

/// A store, with the cache that stands before a remote one.
#[derive(Debug)]
pub(crate) struct Files {
    pub store: Store,
    pub disk: Option<DiskCache>,
}

/// A phrase as it is first met.
pub(crate) struct Met {
    pub entry: Entry,
    pub phrase: Arc<Phrase>,
    pub note: Option<String>,
}

impl Library {
    /// A library of `entries`; `memory` may hold some of them already, by their numbers in the
    /// origin.
    pub fn new(
        origin: Origin,
        entries: Vec<Entry>,
        memory: MemoryCache,
        counters: Arc<Counters>,
    ) -> Self {
        Self {
            entries,
            origin,
            memory,
            counters,
        }
    }

    /// A library of phrases that stay in memory.
    pub fn held(phrases: Vec<Arc<Phrase>>) -> Self {
        let entry = |(number, phrase): (usize, &Arc<Phrase>)| Entry {
            id: phrase.id.clone(),
            frames: phrase.frames(),
            side: None,
            content: None,
            number,
        };
        let entries = phrases.iter().enumerate().map(entry).collect();
        let memory = MemoryCache::new(0);
        Self::new(Origin::Held(phrases), entries, memory, Arc::default())
    }

    /// The phrase of entry `index`.
    ///
    /// # Errors
    /// [`Error::BadPhrase`] if its files are gone, have changed or cannot be read any more.
    pub fn get(&self, index: usize) -> Result<Arc<Phrase>, Error> {
        let entry = &self.entries[index];
        if let Some(phrase) = self.memory.get(entry.number) {
            self.counters.memory_hit();
            return Ok(phrase);
        }
        let phrase = match &self.origin {
            Origin::Held(phrases) => return Ok(phrases[entry.number].clone()),
            Origin::Synthetic(config) => Arc::new(made_up(config, entry.number)),
            Origin::Files(files) => {
                let (motion, audio) = entry.content.expect("a phrase of files has checksums");
                let read = files.phrase(
                    &entry.id,
                    &Expected::Checksum(motion),
                    &Expected::Checksum(audio),
                    "when the dataset was opened",
                );
                let (phrase, ..) = read.map_err(|cause| Error::BadPhrase {
                    id: entry.id.clone(),
                    cause: Box::new(cause),
                })?;
                Arc::new(phrase)
            }
        };
        self.memory.put(entry.number, phrase.clone());
        Ok(phrase)
    }

    /// Whether the phrase of entry `index` needs neither reading nor making now.
    pub fn is_at_hand(&self, index: usize) -> bool {
        matches!(self.origin, Origin::Held(_)) || self.memory.holds(self.entries[index].number)
    }

    /// A checksum of everything the phrases hold, and of which of them (by index) are `held_out`.
    pub fn digest(&self, held_out: &[usize]) -> Digest {
        let made_up = match &self.origin {
            Origin::Synthetic(config) => format!("{config:?}"),
            Origin::Files(_) | Origin::Held(_) => String::new(),
        };
        let parts = self.entries.iter().enumerate().flat_map(|(index, entry)| {
            let side: &[u8] = match held_out.binary_search(&index) {
                Ok(_) => b"validation",
                Err(_) => b"train",
            };
            let content = entry.content.as_ref();
            let files = content.map(|(motion, audio)| [motion.as_bytes(), audio.as_bytes()]);
            let files = files.into_iter().flatten().map(<[u8; 32]>::as_slice);
            [entry.id.as_bytes(), side].into_iter().chain(files)
        });
        Digest::of_parts([made_up.as_bytes()].into_iter().chain(parts))
    }
}

/// Synthetic phrase `number`, for the first time.
pub(crate) fn meet_synthetic(config: &SyntheticConfig, number: usize) -> Met {
    let phrase = Arc::new(made_up(config, number));
    let entry = Entry {
        id: phrase.id.clone(),
        frames: phrase.frames(),
        side: None,
        content: None,
        number,
    };
    Met {
        entry,
        phrase,
        note: None,
    }
}

fn made_up(config: &SyntheticConfig, number: usize) -> Phrase {
    synthetic::phrase(number, config.frames, config.seed)
}

impl Files {
    /// Reads a listed phrase for the first time and notes its checksums.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn meet(&self, listed: &Listed, number: usize) -> Result<Met, FileError> {
        let (phrase, note, content) = self.phrase(
            &listed.id,
            &listed.motion,
            &listed.audio,
            "in manifest.parquet",
        )?;
        let phrase = Arc::new(phrase);
        let entry = Entry {
            id: listed.id.clone(),
            frames: phrase.frames(),
            side: listed.side,
            content: Some(content),
            number,
        };
        Ok(Met {
            entry,
            phrase,
            note,
        })
    }

    /// A phrase, a note on it, and the checksums of its motion and audio files. `recorded` says
    /// where expected checksums come from.
    #[expect(clippy::type_complexity, reason = "three answers of one reading")]
    fn phrase(
        &self,
        id: &str,
        motion: &Expected,
        audio: &Expected,
        recorded: &'static str,
    ) -> Result<(Phrase, Option<String>, (Digest, Digest)), FileError> {
        let paths = (motion_path(id), features_path(id));
        let (motion, motion_digest) = self.read(&paths.0, motion, MAX_MOTION_BYTES, recorded)?;
        let (audio, audio_digest) = self.read(&paths.1, audio, MAX_FEATURES_BYTES, recorded)?;
        let names = (self.store.name_of(&paths.0), self.store.name_of(&paths.1));
        let motion = Named {
            bytes: &motion,
            name: &names.0,
        };
        let audio = Named {
            bytes: &audio,
            name: &names.1,
        };
        let (phrase, note) = Phrase::parse(id, motion, audio)?;
        Ok((phrase, note, (motion_digest, audio_digest)))
    }

    /// The bytes of one file, from the disk cache or the store, with their checksum.
    fn read(
        &self,
        path: &str,
        expected: &Expected,
        limit: u64,
        recorded: &'static str,
    ) -> Result<(Vec<u8>, Digest), StoreError> {
        let key = match expected {
            Expected::Version(version) if !version.is_empty() => {
                let uri = self.store.address();
                let parts = [uri.as_bytes(), path.as_bytes(), version.as_bytes()];
                Some(Digest::of_parts(parts))
            }
            _ => None,
        };
        if let Some(disk) = &self.disk {
            let known = match expected {
                Expected::Checksum(digest) => Some(*digest),
                Expected::Version(_) => key.and_then(|key| disk.name(&key)),
            };
            let cached = known.and_then(|digest| Some((disk.get(&digest)?, digest)));
            if let Some(found) = cached {
                self.store.counters().disk_hit();
                return Ok(found);
            }
        }
        let mut tries = 0;
        let (bytes, digest, version) = loop {
            tries += 1;
            let (bytes, version) = self.store.read_version(path, limit)?;
            let found = Digest::of(&bytes);
            match expected {
                Expected::Checksum(digest) if *digest != found => {
                    if tries >= TRIES || !self.store.is_remote() {
                        return Err(StoreError::Changed {
                            object: self.store.name_of(path),
                            recorded,
                            found: found.to_string(),
                            expected: digest.to_string(),
                        });
                    }
                    self.store.counters().retry();
                }
                _ => break (bytes, found, version),
            }
        };
        if let Some(disk) = &self.disk {
            disk.put(&digest, &bytes);
            // What was overwritten since it was listed is another version than the key's.
            let as_listed = matches!(expected, Expected::Version(listed) if *listed == version);
            if let Some(key) = key.filter(|_| as_listed) {
                disk.put_name(&key, &digest);
            }
        }
        Ok((bytes, digest))
    }
}
