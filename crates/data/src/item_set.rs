//! A subset of the items of a dataset.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use kinegrad_motion::{Measured, Statistics};
use kinegrad_ranks::{Sharing, shared};
use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::Error;
use crate::item::Item;
use crate::item_store::ItemStore;
use crate::progress::{OpenProgress, report};

/// Number of items per measured chunk.
const CHUNK: usize = 256;

/// A subset of the items of a dataset, ordered by id and read on demand. Clones share the items.
#[derive(Debug)]
pub struct ItemSet<T> {
    store: Arc<ItemStore<T>>,
    /// Indices in the store.
    indices: Arc<[usize]>,
}

impl<T> Clone for ItemSet<T> {
    fn clone(&self) -> Self {
        Self {
            store: self.store.clone(),
            indices: self.indices.clone(),
        }
    }
}

impl<T: Item> ItemSet<T> {
    pub(crate) fn new(store: Arc<ItemStore<T>>, indices: Vec<usize>) -> Self {
        Self {
            store,
            indices: indices.into(),
        }
    }

    /// Number of items.
    pub fn len(&self) -> usize {
        self.indices.len()
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.indices.is_empty()
    }

    /// Their ids, in order.
    pub fn ids(&self) -> impl Iterator<Item = &str> {
        (0..self.len()).map(|position| self.id(position))
    }

    /// Frames of item `position`, without reading it.
    pub fn frames(&self, position: usize) -> usize {
        self.store.entries[self.indices[position]].frames
    }

    /// Id of item `position`, without reading it.
    pub fn id(&self, position: usize) -> &str {
        &self.store.entries[self.indices[position]].id
    }

    /// Index of item `position` in the dataset's listing; ranks divide the items by this index.
    pub(crate) fn number(&self, position: usize) -> usize {
        self.store.entries[self.indices[position]].number
    }

    /// Label of item `position`, without reading it.
    pub fn label(&self, position: usize) -> Option<&str> {
        self.store.entries[self.indices[position]].label.as_deref()
    }

    /// Their distinct labels, in order.
    pub fn labels(&self) -> BTreeSet<&str> {
        let labels = (0..self.len()).filter_map(|position| self.label(position));
        labels.collect()
    }

    /// Item `position`. Fails with [`Error::BadItem`] if the item's files are gone, changed or
    /// unreadable.
    pub fn get(&self, position: usize) -> Result<Arc<T>, Error> {
        self.store.get(self.indices[position])
    }

    /// The item `id`; `None` for an unknown id.
    pub fn find(&self, id: &str) -> Result<Option<Arc<T>>, Error> {
        let position = self.ids().position(|found| found == id);
        position.map(|position| self.get(position)).transpose()
    }

    /// Maximum number of items to read at once from remote storage; 0 if local.
    pub(crate) fn concurrency(&self) -> usize {
        self.store.concurrency
    }

    /// True if item `position` is in memory now.
    pub(crate) fn is_cached(&self, position: usize) -> bool {
        self.store.is_cached(self.indices[position])
    }

    /// The items whose ids `choose` picks.
    #[must_use]
    pub fn filter(&self, choose: impl Fn(&str) -> bool) -> Self {
        let chosen = |index: &&usize| choose(&self.store.entries[**index].id);
        let indices = self.indices.iter().filter(chosen).copied().collect();
        Self::new(self.store.clone(), indices)
    }

    /// The first `count` items.
    pub fn first(&self, count: usize) -> Result<Vec<Arc<T>>, Error> {
        let positions = 0..count.min(self.len());
        positions.map(|position| self.get(position)).collect()
    }

    /// `count` evenly spaced items, because neighbors are similar.
    pub fn evenly(&self, count: usize) -> Result<Vec<Arc<T>>, Error> {
        let taken = count.min(self.len());
        let positions = (0..taken).map(|index| index * self.len() / taken);
        positions.map(|position| self.get(position)).collect()
    }

    /// All items, in memory.
    pub fn load(&self) -> Result<Vec<Arc<T>>, Error> {
        (0..self.len())
            .into_par_iter()
            .map(|position| self.get(position))
            .collect()
    }

    /// Motion statistics in `representation`; `None` for an empty set. Each rank measures a part of
    /// the items. Collective. Fails as [`measure_among`](Self::measure_among).
    pub fn statistics_among(
        &self,
        representation: &T::Representation,
        progress: OpenProgress,
        sharing: &dyn Sharing<Error>,
    ) -> Result<Option<Statistics>, Error> {
        let measure = |item: &T| Measured::of(representation, &item.rows(representation));
        let mut all: Option<Measured> = None;
        let take = |measured| match &mut all {
            Some(all) => all.merge(measured),
            None => all = Some(measured),
        };
        self.measure_among(measure, take, progress, sharing)?;
        Ok(all.map(|all| all.statistics(representation)))
    }

    /// Measures each item on all cores and passes the results to `take` in order. Each rank
    /// measures a part of the items and takes all results. Collective. Fails as [`get`](Self::get);
    /// [`Error::Interrupted`]; [`Error::OtherReader`].
    pub fn measure_among<M: Send + Serialize + DeserializeOwned>(
        &self,
        measure: impl Fn(&T) -> M + Sync,
        take: impl FnMut(M),
        progress: OpenProgress,
        sharing: &dyn Sharing<Error>,
    ) -> Result<(), Error> {
        let measure = |position| Ok(measure(&*self.get(position)?));
        // The rank that read an item when the dataset was opened has the item in memory.
        let owner = |position| self.number(position);
        measure_among(self.len(), owner, measure, take, progress, sharing)
    }

    pub(crate) fn counters(&self) -> &Arc<crate::Counters> {
        &self.store.counters
    }
}

/// Measures `total` items on all cores, each item on the rank of its `owner`, and passes the
/// results to `take` in order. Collective.
pub(crate) fn measure_among<M: Send + Serialize + DeserializeOwned>(
    total: usize,
    owner: impl Fn(usize) -> usize,
    measure: impl Fn(usize) -> Result<M, Error> + Sync,
    mut take: impl FnMut(M),
    progress: OpenProgress,
    sharing: &dyn Sharing<Error>,
) -> Result<(), Error> {
    let done = AtomicUsize::new(0);
    let measure = |position| {
        let measured = measure(position)?;
        report(progress, done.fetch_add(1, Ordering::Relaxed) + 1, total)?;
        Ok(measured)
    };
    let chunk = CHUNK * sharing.size();
    for start in (0..total).step_by(chunk) {
        let end = (start + chunk).min(total);
        let measured = shared(sharing, start..end, &owner, |own| {
            report(progress, start, total)?;
            own.into_par_iter().map(measure).collect()
        })?;
        // The count includes other ranks' items.
        done.store(end, Ordering::Relaxed);
        measured.into_iter().for_each(&mut take);
    }
    Ok(())
}

impl<T: Item> From<Vec<Arc<T>>> for ItemSet<T> {
    /// Items in memory, in this order.
    fn from(items: Vec<Arc<T>>) -> Self {
        let indices = (0..items.len()).collect();
        Self::new(Arc::new(ItemStore::in_memory(items)), indices)
    }
}
