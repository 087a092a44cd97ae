//! The items of an open dataset, read on demand.
//!
//! Opening a dataset reads every item once and notes the checksums of its files. From then on an
//! item comes from memory, from the disk cache or from the store again, and in the last two
//! cases only with those checksums: what changes under a run is never trained on.

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

/// Where items come from, and those that are held in memory.
#[derive(Debug)]
pub(crate) struct ItemStore<T> {
    pub entries: Vec<Entry>,
    source: Box<dyn ItemSource<T>>,
    memory: MemoryCache<T>,
    pub counters: Arc<Counters>,
    /// Most items worth reading at once from afar; 0 where they are not far.
    pub concurrency: usize,
}

/// What is known of an item that can be used.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct Entry {
    pub id: String,
    pub frames: usize,
    /// Its side of the split, where the dataset states one.
    pub side: Option<Side>,
    /// What the item is called, such as the kind of dance.
    pub label: Option<String>,
    /// Checksums of its files; none where there are no files.
    content: Vec<Digest>,
    /// Number of the item in its source.
    number: usize,
}

/// Which item is to be read.
#[derive(Clone, Copy)]
pub(crate) struct ReadRequest<'a> {
    /// Its number in its source.
    pub number: usize,
    pub id: &'a str,
    /// What its files are to be.
    pub expected: &'a [Expected],
    /// Where that comes from.
    pub recorded: &'static str,
}

/// A maker of items.
pub(crate) trait ItemSource<T>: Debug + Send + Sync {
    /// Reads the requested item.
    ///
    /// # Errors
    /// [`FileError`].
    fn read(&self, request: ReadRequest<'_>) -> Result<ReadItem<T>, FileError>;

    /// The files that they are read from; none where there are none.
    fn files(&self) -> Option<&Files> {
        None
    }

    /// Most items worth reading at once from afar; 0 where they are not far.
    fn concurrency(&self) -> usize {
        self.files().map_or(0, |files| files.concurrency)
    }

    /// Whether every item is in memory already.
    fn is_memory(&self) -> bool {
        false
    }

    /// What decides the items beside their files.
    fn fingerprint(&self) -> String {
        String::new()
    }
}

/// An item as it was read.
pub(crate) struct ReadItem<T> {
    pub item: Arc<T>,
    /// What is odd about it.
    pub note: Option<String>,
    /// Why it does not belong to the dataset although it is in order.
    pub left_out: Option<String>,
    /// Checksums of its files.
    pub content: Vec<Digest>,
}

impl<T> ReadItem<T> {
    /// An item without files, about which nothing is odd.
    pub fn of(item: impl Into<Arc<T>>) -> Self {
        Self {
            item: item.into(),
            note: None,
            left_out: None,
            content: Vec::new(),
        }
    }
}

/// Reads listed item `number` of `source` for the first time.
///
/// # Errors
/// [`FileError`].
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
        frames: read.item.frames(),
        side: listed.side,
        label: read.item.label().map(str::to_owned),
        content: read.content.clone(),
        number,
    };
    Ok((entry, read))
}

/// Items that are all there already.
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
    /// A store of `entries`; `memory` may hold some of them already, by their numbers in the
    /// source.
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

    /// A store of items that stay in memory.
    pub fn in_memory(items: Vec<Arc<T>>) -> Self {
        let entry = |(number, item): (usize, &Arc<T>)| Entry {
            id: item.id().to_owned(),
            frames: item.frames(),
            side: None,
            label: item.label().map(str::to_owned),
            content: Vec::new(),
            number,
        };
        let entries = items.iter().enumerate().map(entry).collect();
        let memory = MemoryCache::new(0);
        Self::new(Box::new(InMemory(items)), entries, memory)
    }

    /// The item of entry `index`.
    ///
    /// # Errors
    /// [`Error::BadItem`] if its files are gone, have changed or cannot be read any more.
    pub fn get(&self, index: usize) -> Result<Arc<T>, Error> {
        let entry = &self.entries[index];
        if let Some(item) = self.memory.get(entry.number) {
            self.counters.memory_hit();
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
        let item = read
            .map_err(|cause| Error::bad::<T>(&entry.id, cause))?
            .item;
        self.memory.put(entry.number, item.clone());
        Ok(item)
    }

    /// Number of the item of entry `index` in its source.
    pub fn number(&self, index: usize) -> usize {
        self.entries[index].number
    }

    /// Whether the item of entry `index` needs neither reading nor making now.
    pub fn is_cached(&self, index: usize) -> bool {
        self.source.is_memory() || self.memory.contains(self.entries[index].number)
    }

    /// A checksum of everything the items hold, and of which of them (by index) are `held_out`.
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
