//! Meeting every item of a dataset once.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use crate::cache::MemoryCache;
use crate::files::Files;
use crate::item::{Item, ItemSet};
use crate::library::{Entry, Library, Met, Origin};
use crate::listing::{Listed, Listing};
use crate::phrase_set::{MadeUpPhrases, PhraseFiles};
use crate::store::Store;
use crate::{
    Counters, DataConfig, DataKind, Digest, Error, FileError, OnBadPhrase, Phrase, StoreError,
    synthetic,
};

/// Hears how many of how many items have been read; called from several threads.
pub type OpenProgress<'a> = &'a (dyn Fn(usize, usize) + Sync);

/// A dataset whose items are known by name.
pub(crate) struct Survey<T> {
    pub origin: Box<dyn Origin<T>>,
    /// What is odd about the dataset as a whole.
    pub warnings: Vec<String>,
    pub counters: Arc<Counters>,
    /// How messages name the dataset.
    pub source: String,
    pub listed: Vec<Listed>,
    /// Most requests at a time; 0 where nothing is requested from afar.
    pub concurrency: usize,
    /// Whether items that are not as they were recorded are to be listed as well.
    pub tolerates_changes: bool,
}

/// The items of a dataset that can be used, and what was said of the others.
pub(crate) struct Gathered<T> {
    pub entries: Vec<Entry>,
    /// Id and reason of each bad item.
    pub skipped: Vec<(String, String)>,
    /// Id and reason of each item that is in order and does not belong here.
    pub left_out: Vec<(String, String)>,
    /// Id and what is odd about it.
    pub notes: Vec<(String, String)>,
    memory: MemoryCache<T>,
}

/// Both sides of a dataset.
pub(crate) struct Sides<T> {
    pub train: ItemSet<T>,
    pub validation: ItemSet<T>,
    pub digest: Digest,
}

impl Survey<Phrase> {
    /// Lists the phrases of a valid `config`.
    ///
    /// # Errors
    /// [`Error::Config`] where `config` is not of phrases; [`Error::Scheme`], [`Error::Feature`],
    /// [`Error::Store`], [`Error::Manifest`], [`Error::MissingFolder`], [`Error::EmptyDataset`],
    /// [`Error::Io`].
    pub fn phrases(config: &DataConfig) -> Result<Self, Error> {
        match config.kind {
            DataKind::Phrases => Self::of_files(config),
            DataKind::Synthetic => Ok(Self {
                origin: Box::new(MadeUpPhrases(config.synthetic.clone())),
                warnings: Vec::new(),
                counters: Arc::default(),
                source: "synthetic".to_owned(),
                listed: Listed::made_up(config.synthetic.phrases, synthetic::id),
                concurrency: 0,
                tolerates_changes: false,
            }),
            kind @ (DataKind::Humanml3d | DataKind::SyntheticWalks) => Err(Error::wrong_kind(
                kind,
                "\"phrases\" or \"synthetic\"",
                "clips are no phrases of motion and music: another recipe or command takes them",
            )),
        }
    }

    fn of_files(config: &DataConfig) -> Result<Self, Error> {
        let source = config.source.as_deref().unwrap_or_default();
        let store = Store::open(source, &config.store)?;
        let Listing {
            mut phrases,
            only_motion,
            only_audio,
            mut warnings,
        } = Listing::read(&store)?;
        if phrases.is_empty() {
            return Err(Error::EmptyDataset {
                source_uri: store.uri(),
                only_motion: only_motion.len(),
                only_audio: only_audio.len(),
            });
        }
        for (alone, place, lacking) in [
            (&only_motion, "motion", "audio_features"),
            (&only_audio, "audio_features", "motion"),
        ] {
            if let Some(first) = alone.first() {
                let count = alone.len();
                warnings.push(format!(
                    "{count} folder(s) under {place}/ have no counterpart under {lacking}/ and \
                     are left out, the first: {first}"
                ));
            }
        }
        phrases.truncate(config.num_phrases.unwrap_or(usize::MAX));
        let files = Files::open(store, config, &mut warnings)?;
        Ok(Self {
            warnings,
            counters: files.store.counters().clone(),
            source: files.store.uri(),
            listed: phrases,
            concurrency: files.concurrency(config),
            tolerates_changes: false,
            origin: Box::new(PhraseFiles(files)),
        })
    }
}

impl<T: Item> Survey<T> {
    /// Reads each item and hands it to `take` with its number; id and outcome of each, in order.
    ///
    /// # Errors
    /// [`Error::Store`] if the store itself fails; never for a single bad item.
    #[expect(clippy::type_complexity, reason = "ids and outcomes, nothing more")]
    pub fn meet_all<M: Send>(
        &self,
        progress: OpenProgress,
        take: impl Fn(usize, Met<T>) -> M + Sync,
    ) -> Result<Vec<(String, Result<M, FileError>)>, Error> {
        let (total, met) = (self.listed.len(), AtomicUsize::new(0));
        let meet = |number: usize| {
            let listed = &self.listed[number];
            let outcome = Met::read(&*self.origin, listed, number);
            if let Err(FileError::Store(error)) = &outcome
                && !self.concerns_one_item(error)
            {
                return Err(Error::Store(error.clone()));
            }
            progress(met.fetch_add(1, Ordering::Relaxed) + 1, total);
            Ok((listed.id.clone(), outcome.map(|met| take(number, met))))
        };
        let all = || (0..total).into_par_iter().map(meet).collect();
        // Threads that wait for a network are not bound to the number of cores.
        if self.concurrency == 0 {
            return all();
        }
        let pool = rayon::ThreadPoolBuilder::new().num_threads(self.concurrency);
        match pool.build() {
            Ok(pool) => pool.install(all),
            Err(_) => all(),
        }
    }

    /// Reads all items of a valid `config`, and keeps so many in memory as it allows.
    ///
    /// # Errors
    /// As [`meet_all`](Self::meet_all); [`Error::BadItem`] for the first bad item by id, or
    /// [`Error::AllSkipped`].
    pub fn gather(
        &self,
        config: &DataConfig,
        progress: OpenProgress,
    ) -> Result<Gathered<T>, Error> {
        let memory = MemoryCache::new(config.cache.memory_bytes());
        let outcomes = self.meet_all(progress, |number, met| {
            if met.left_out.is_none() {
                memory.put(number, met.item);
            }
            (met.entry, met.note, met.left_out)
        })?;
        let mut gathered = Gathered {
            entries: Vec::with_capacity(outcomes.len()),
            skipped: Vec::new(),
            left_out: Vec::new(),
            notes: Vec::new(),
            memory,
        };
        for (id, outcome) in outcomes {
            match outcome {
                Ok((_, _, Some(reason))) => gathered.left_out.push((id, reason)),
                Ok((entry, note, None)) => {
                    gathered.notes.extend(note.map(|note| (id, note)));
                    gathered.entries.push(entry);
                }
                Err(cause) if config.on_bad_phrase == OnBadPhrase::Skip => {
                    gathered.skipped.push((id, cause.to_string()));
                }
                Err(cause) => return Err(Error::bad::<T>(&id, cause)),
            }
        }
        if let (true, Some((id, reason))) = (gathered.entries.is_empty(), gathered.skipped.first())
        {
            return Err(Error::AllSkipped {
                kind: T::KIND,
                skipped: gathered.skipped.len(),
                first: format!("{} `{id}`: {reason}", T::KIND),
            });
        }
        Ok(gathered)
    }

    /// The sides of the split of what was gathered, of which `held_out` picks the second.
    ///
    /// # Errors
    /// [`Error::EmptyTrainSplit`].
    pub fn split(
        self,
        gathered: Gathered<T>,
        held_out: impl Fn(&Entry) -> bool,
    ) -> Result<Sides<T>, Error> {
        let Gathered {
            entries, memory, ..
        } = gathered;
        let (validation, train): (Vec<usize>, Vec<usize>) =
            (0..entries.len()).partition(|&index| held_out(&entries[index]));
        if train.is_empty() {
            return Err(Error::EmptyTrainSplit {
                kind: T::KIND,
                items: validation.len(),
            });
        }
        let library = Library::new(self.origin, entries, memory, self.counters);
        let library = library.read_at_once(self.concurrency);
        let library = Arc::new(library);
        Ok(Sides {
            digest: library.digest(&validation),
            train: ItemSet::new(library.clone(), train),
            validation: ItemSet::new(library, validation),
        })
    }

    /// Whether other items may be good all the same.
    fn concerns_one_item(&self, error: &StoreError) -> bool {
        // A file that this machine does not give out says nothing of the next one.
        let here = self.concurrency == 0;
        let unreadable = matches!(error, StoreError::Denied { .. } | StoreError::Failed { .. });
        let changed = matches!(error, StoreError::Changed { .. });
        error.concerns_one_object() || (here && unreadable) || (self.tolerates_changes && changed)
    }
}
