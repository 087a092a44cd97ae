//! Reading every item of a dataset once.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use kinegrad_motion::Statistics;
use kinegrad_ranks::{Sharing, shared};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::cache::MemoryCache;
use crate::item::Item;
use crate::item_set::ItemSet;
use crate::item_store::{Entry, ItemSource, ItemStore, index_item};
use crate::listing::Listed;
use crate::loader::pool;
use crate::progress::{OpenProgress, report};
use crate::split::{Side, Split};
use crate::{DataConfig, Digest, Error, FileError, OnBadPhrase, StoreError};

/// Number of items between two progress callbacks on the opening thread.
const CHUNK: usize = 512;

/// A dataset whose items are listed but not read.
pub(crate) struct Scan<T: Item> {
    /// Representation of the motion.
    pub representation: T::Representation,
    /// Statistics from the dataset's files.
    pub stored_statistics: Option<Statistics>,
    /// The rule of the split; `None` for the dataset's own split.
    pub split: Option<Split>,
    pub source: Box<dyn ItemSource<T>>,
    /// Warnings about the dataset.
    pub warnings: Vec<String>,
    pub listed: Vec<Listed>,
}

/// Kinds of items that a config can list.
pub(crate) trait Listable: Item + Sized {
    /// Lists the items of a valid `config`. Fails with [`Error::Config`] if `config` is for other
    /// items; [`Error::Scheme`], [`Error::Feature`], [`Error::Store`], [`Error::Manifest`],
    /// [`Error::File`], [`Error::MissingFolder`], [`Error::NothingToTrainOn`], [`Error::Io`].
    fn scan(config: &DataConfig) -> Result<Scan<Self>, Error>;
}

/// The result of reading a dataset.
pub(crate) struct Gathered<T> {
    pub entries: Vec<Entry>,
    /// Id and reason of each bad item.
    pub skipped: Vec<(String, String)>,
    /// Id and reason of each valid item that is left out.
    pub left_out: Vec<(String, String)>,
    /// Id and note of items.
    pub notes: Vec<(String, String)>,
    pub memory: MemoryCache<T>,
}

/// The outcome of reading an item.
#[derive(Deserialize, Serialize)]
enum Outcome {
    /// Usable, with a note.
    Good(Entry, Option<String>),
    /// A valid item that is left out, with the reason.
    LeftOut(String),
    /// Unusable, with the reason.
    Bad(String),
}

impl<T: Item> Scan<T> {
    /// Reads all items, caches the number that `config` allows, and handles bad items by `on_bad`.
    /// With `None`, all bad items are collected, including changed items. Each rank reads and
    /// caches a part of the items. Fails with [`Error::Store`] if the store fails;
    /// [`Error::BadItem`] for the first bad item by id; [`Error::Interrupted`];
    /// [`Error::OtherListing`]; [`Error::OtherReader`].
    pub fn gather(
        &self,
        config: &DataConfig,
        on_bad: Option<OnBadPhrase>,
        progress: OpenProgress,
        sharing: &dyn Sharing<Error>,
    ) -> Result<Gathered<T>, Error> {
        self.must_list_the_same(sharing)?;
        let memory = MemoryCache::new(config.cache.memory_mib << 20);
        let (total, done) = (self.listed.len(), AtomicUsize::new(0));
        let (concurrency, ranks) = (self.source.concurrency(), sharing.size());
        let read_one = |number: usize| {
            let outcome = index_item(&*self.source, &self.listed[number], number);
            if let Err(FileError::Store(error)) = &outcome
                && !concerns_one_item(error, concurrency == 0, on_bad.is_none())
            {
                return Err(Error::Store(error.clone()));
            }
            let read = (done.fetch_add(1, Ordering::Relaxed) + 1) * ranks;
            report(progress, read.min(total), total)?;
            Ok(outcome.map(|(entry, read)| match read.left_out {
                Some(reason) => Outcome::LeftOut(reason),
                None => {
                    memory.put(number, read.item);
                    Outcome::Good(entry, read.note)
                }
            }))
        };
        let pool = pool(concurrency);
        let mut outcomes = Vec::with_capacity(total);
        // The first bad item of this rank.
        let mut bad = None;
        let chunk = CHUNK * ranks;
        for start in (0..total).step_by(chunk) {
            let work = |own: Vec<usize>| -> Result<Vec<Outcome>, Error> {
                report(progress, start, total)?;
                let read = || own.par_iter().map(|&number| read_one(number)).collect();
                let read: Result<Vec<_>, Error> = match &pool {
                    Some(pool) => pool.install(read),
                    None => read(),
                };
                let read = own.iter().zip(read?).map(|(&number, outcome)| {
                    outcome.unwrap_or_else(|cause| {
                        let bad_item = Outcome::Bad(cause.to_string());
                        bad.get_or_insert((number, cause));
                        bad_item
                    })
                });
                Ok(read.collect())
            };
            let numbers = start..(start + chunk).min(total);
            outcomes.extend(shared(sharing, numbers, |number| number, work)?);
            let is_bad = |outcome: &Outcome| matches!(outcome, Outcome::Bad(_));
            if on_bad == Some(OnBadPhrase::Error)
                && let Some(number) = outcomes.iter().position(is_bad)
            {
                return Err(match bad {
                    Some((own, cause)) if own == number => {
                        Error::bad::<T>(&self.listed[number].id, cause)
                    }
                    _ => Error::OtherReader {
                        rank: number % ranks,
                        code: 2,
                    },
                });
            }
        }
        let mut gathered = Gathered {
            entries: Vec::with_capacity(total),
            skipped: Vec::new(),
            left_out: Vec::new(),
            notes: Vec::new(),
            memory,
        };
        for (Listed { id, .. }, outcome) in self.listed.iter().zip(outcomes) {
            match outcome {
                Outcome::LeftOut(reason) => gathered.left_out.push((id.clone(), reason)),
                Outcome::Bad(cause) => gathered.skipped.push((id.clone(), cause)),
                Outcome::Good(entry, note) => {
                    gathered.notes.extend(note.map(|note| (id.clone(), note)));
                    gathered.entries.push(entry);
                }
            }
        }
        Ok(gathered)
    }

    /// Rejects a dataset if ranks list different items.
    fn must_list_the_same(&self, sharing: &dyn Sharing<Error>) -> Result<(), Error> {
        let own = Digest::of_parts(self.listed.iter().map(|listed| listed.id.as_bytes()));
        let all = sharing.exchange(Ok(own.as_bytes().to_vec()))?;
        match all.iter().position(|listing| *listing != all[0]) {
            None => Ok(()),
            Some(rank) => Err(Error::OtherListing {
                kind: T::KIND,
                rank,
            }),
        }
    }

    /// The training and held-out items, and a checksum of all.
    pub fn divide(
        self,
        entries: Vec<Entry>,
        memory: MemoryCache<T>,
    ) -> (ItemSet<T>, ItemSet<T>, Digest) {
        let stated = entries.iter().map(|entry| (entry.id.as_str(), entry.side));
        let held_out = match &self.split {
            Some(split) => split.holds_out(&stated.collect::<Vec<_>>()),
            None => stated
                .map(|(_, side)| side == Some(Side::Validation))
                .collect(),
        };
        let (validation, train): (Vec<usize>, Vec<usize>) =
            (0..entries.len()).partition(|&index| held_out[index]);
        let store = Arc::new(ItemStore::new(self.source, entries, memory));
        let digest = store.digest(&validation);
        let train = ItemSet::new(store.clone(), train);
        (train, ItemSet::new(store, validation), digest)
    }
}

/// True if a store error concerns a single item; `here` is true for a local store.
fn concerns_one_item(error: &StoreError, here: bool, tolerated: bool) -> bool {
    match error {
        // Other local files may be accessible.
        StoreError::Denied { .. } | StoreError::Failed { .. } => here,
        StoreError::Changed { .. } => tolerated,
        _ => error.concerns_one_object(),
    }
}
