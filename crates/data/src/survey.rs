//! Meeting every item of a dataset once.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use kinegrad_motion::Statistics;
use rayon::prelude::*;

use crate::cache::MemoryCache;
use crate::item::Item;
use crate::item_set::ItemSet;
use crate::library::{Entry, Library, Met, Origin};
use crate::listing::Listed;
use crate::split::{Side, Split};
use crate::{Counters, DataConfig, Digest, Error, FileError, OnBadPhrase, StoreError};

/// Progress callback with the number of items read and in total; called from several threads.
pub type OpenProgress<'a> = &'a (dyn Fn(usize, usize) + Sync);

/// A dataset whose items are known by name.
pub(crate) struct Survey<T: Item> {
    /// What the rows of the items are.
    pub representation: T::Representation,
    /// The statistics that the dataset brings along.
    pub given: Option<Statistics>,
    /// What is said of the side of the split; where there is nothing, the dataset decides.
    pub split: Option<Split>,
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

/// Items that are listed by a config.
pub(crate) trait Listable: Item {
    /// Lists the items of a valid `config`.
    ///
    /// # Errors
    /// [`Error::Config`] where `config` is of other items; [`Error::Scheme`], [`Error::Feature`],
    /// [`Error::Store`], [`Error::Manifest`], [`Error::File`], [`Error::MissingFolder`],
    /// [`Error::EmptyDataset`], [`Error::Io`].
    fn survey(config: &DataConfig) -> Result<Survey<Self>, Error>
    where
        Self: Sized;
}

/// What was read of a dataset.
pub(crate) struct Gathered<T> {
    pub entries: Vec<Entry>,
    /// Id and reason of each bad item.
    pub skipped: Vec<(String, String)>,
    /// Id and reason of each item that is in order and does not belong here.
    pub left_out: Vec<(String, String)>,
    /// Id and what is odd about it.
    pub notes: Vec<(String, String)>,
    pub memory: MemoryCache<T>,
}

/// Both sides of a dataset.
pub(crate) struct Sides<T> {
    pub train: ItemSet<T>,
    pub validation: ItemSet<T>,
    pub digest: Digest,
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

    /// Reads all items, keeps so many in memory as `config` allows, and sets bad ones apart as
    /// `on_bad` says.
    ///
    /// # Errors
    /// As [`meet_all`](Self::meet_all); [`Error::BadItem`] for the first bad item by id.
    pub fn gather(
        &self,
        config: &DataConfig,
        on_bad: OnBadPhrase,
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
                Err(cause) if on_bad == OnBadPhrase::Skip => {
                    gathered.skipped.push((id, cause.to_string()));
                }
                Err(cause) => return Err(Error::bad::<T>(&id, cause)),
            }
        }
        Ok(gathered)
    }

    /// The sides of the split of what was gathered.
    pub fn divide(self, entries: Vec<Entry>, memory: MemoryCache<T>) -> Sides<T> {
        let held_out = |entry: &Entry| match &self.split {
            Some(split) => split.holds_out(&entry.id, entry.side),
            None => entry.side == Some(Side::Validation),
        };
        let (validation, train): (Vec<usize>, Vec<usize>) =
            (0..entries.len()).partition(|&index| held_out(&entries[index]));
        let library = Library::new(self.origin, entries, memory, self.counters);
        let library = Arc::new(library.read_at_once(self.concurrency));
        Sides {
            digest: library.digest(&validation),
            train: ItemSet::new(library.clone(), train),
            validation: ItemSet::new(library, validation),
        }
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
