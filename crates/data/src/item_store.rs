//! The items of an open dataset, read on demand. Opening a dataset reads every item once and
//! records the checksums of its files. Later reads from memory, the disk cache or the store must
//! match these checksums, so training never uses files that change during a run.

use std::fmt::Debug;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::cache::MemoryCache;
use crate::digest::Digest;
use crate::files::Files;
use crate::item::Item;
use crate::listing::{Expected, Listed};
use crate::split::Side;
use crate::{Counters, Error, FileError};

/// The source of items, and the cached items.
#[derive(Debug)]
pub(crate) struct ItemStore<T> {
    pub entries: Vec<Entry>,
    source: Box<dyn ItemSource<T>>,
    memory: MemoryCache<T>,
    pub counters: Arc<Counters>,
    /// Maximum number of items to read at once from remote storage; 0 if local.
    pub concurrency: usize,
}

/// Facts about a usable item.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct Entry {
    pub id: String,
    pub frames: usize,
    /// The item's side of the split, if the dataset defines the split.
    pub side: Option<Side>,
    /// The item's label, such as the dance style.
    pub label: Option<String>,
    /// Checksums of its files.
    content: Vec<Digest>,
    /// Its index in the source.
    pub number: usize,
}

impl Entry {
    /// An item without files.
    fn of(item: &impl Item, number: usize) -> Self {
        Self {
            id: item.id().to_owned(),
            frames: item.frames(),
            side: None,
            label: item.label().map(str::to_owned),
            content: Vec::new(),
            number,
        }
    }
}

/// A request to read an item.
#[derive(Clone, Copy)]
pub(crate) struct ReadRequest<'a> {
    /// Its index in the source.
    pub number: usize,
    pub id: &'a str,
    /// Expected versions of its files.
    pub expected: &'a [Expected],
    /// Origin of the expected versions.
    pub recorded: &'static str,
}

/// A source of items.
pub(crate) trait ItemSource<T>: Debug + Send + Sync {
    /// Reads the requested item.
    fn read(&self, request: ReadRequest<'_>) -> Result<ReadItem<T>, FileError>;

    /// The files that items are read from, if any.
    fn files(&self) -> Option<&Files> {
        None
    }

    /// Maximum number of items to read at once from remote storage; 0 if local.
    fn concurrency(&self) -> usize {
        self.files().map_or(0, |files| files.concurrency)
    }

    /// True if every item is in memory.
    fn is_memory(&self) -> bool {
        false
    }

    /// Everything except the files that determines the items.
    fn fingerprint(&self) -> String {
        String::new()
    }
}

/// An item as read.
pub(crate) struct ReadItem<T> {
    pub item: Arc<T>,
    /// A note about it.
    pub note: Option<String>,
    /// The reason to leave out a valid item.
    pub left_out: Option<String>,
    /// Checksums of its files.
    pub content: Vec<Digest>,
}

impl<T> ReadItem<T> {
    /// An item without files and notes.
    pub fn of(item: impl Into<Arc<T>>) -> Self {
        Self {
            item: item.into(),
            note: None,
            left_out: None,
            content: Vec::new(),
        }
    }
}

/// Reads the listed item `number` of `source` for the first time.
pub(crate) fn index_item<T: Item>(
    source: &dyn ItemSource<T>,
    listed: &Listed,
    number: usize,
) -> Result<(Entry, ReadItem<T>), FileError> {
    let read = source.read(ReadRequest {
        number,
        id: &listed.id,
        expected: &listed.files,
        recorded: "in manifest.parquet",
    })?;
    let entry = Entry {
        id: listed.id.clone(),
        side: listed.side,
        content: read.content.clone(),
        ..Entry::of(&*read.item, number)
    };
    Ok((entry, read))
}

/// Items in memory.
#[derive(Debug)]
struct InMemory<T>(Vec<Arc<T>>);

impl<T: Item> ItemSource<T> for InMemory<T> {
    fn read(&self, request: ReadRequest<'_>) -> Result<ReadItem<T>, FileError> {
        Ok(ReadItem::of(self.0[request.number].clone()))
    }

    fn is_memory(&self) -> bool {
        true
    }
}

impl<T: Item> ItemStore<T> {
    /// A store of `entries`; `memory` contains already cached items by their index in the source.
    pub fn new(
        source: Box<dyn ItemSource<T>>,
        entries: Vec<Entry>,
        memory: MemoryCache<T>,
    ) -> Self {
        let counters = source.files().map(|files| files.store.counters().clone());
        Self {
            counters: counters.unwrap_or_default(),
            concurrency: source.concurrency(),
            entries,
            source,
            memory,
        }
    }

    /// A store of items in memory.
    pub fn in_memory(items: Vec<Arc<T>>) -> Self {
        let entry = |(number, item): (usize, &Arc<T>)| Entry::of(&**item, number);
        let entries = items.iter().enumerate().map(entry).collect();
        let memory = MemoryCache::new(0);
        Self::new(Box::new(InMemory(items)), entries, memory)
    }

    /// The item of entry `index`.
    pub fn get(&self, index: usize) -> Result<Arc<T>, Error> {
        let entry = &self.entries[index];
        if let Some(item) = self.memory.get(entry.number) {
            Counters::increment(&self.counters.memory_hits);
            return Ok(item);
        }
        let expected = entry.content.iter().copied().map(Expected::Checksum);
        let expected: Vec<Expected> = expected.collect();
        let read = self.source.read(ReadRequest {
            number: entry.number,
            id: &entry.id,
            expected: &expected,
            recorded: "when the dataset was opened",
        });
        let read = read.map_err(|cause| Error::bad::<T>(&entry.id, cause))?;
        let item = read.item;
        self.memory.put(entry.number, item.clone());
        Ok(item)
    }

    /// True if the item of entry `index` is in memory.
    pub fn is_cached(&self, index: usize) -> bool {
        self.source.is_memory() || self.memory.contains(self.entries[index].number)
    }

    /// Checksum of all items and of the `held_out` indices.
    pub fn digest(&self, held_out: &[usize]) -> Digest {
        let fingerprint = self.source.fingerprint();
        let parts = self.entries.iter().enumerate().flat_map(|(index, entry)| {
            let side: &[u8] = match held_out.binary_search(&index) {
                Ok(_) => b"validation",
                Err(_) => b"train",
            };
            let files = entry.content.iter().map(|file| file.as_bytes().as_slice());
            [entry.id.as_bytes(), side].into_iter().chain(files)
        });
        Digest::of_parts([fingerprint.as_bytes()].into_iter().chain(parts))
    }
}
