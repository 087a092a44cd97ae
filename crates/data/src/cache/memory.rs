//! Items in memory, with a size limit and least-recently-used eviction.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lru::LruCache;

use crate::Item;

/// Items by their index in the dataset.
#[derive(Debug)]
pub(crate) struct MemoryCache<T> {
    limit: usize,
    entries: Mutex<Entries<T>>,
}

#[derive(Debug)]
struct Entries<T> {
    items: LruCache<usize, Arc<T>>,
    bytes: usize,
}

impl<T: Item> MemoryCache<T> {
    /// An empty cache of at most `limit` bytes.
    pub fn new(limit: usize) -> Self {
        let entries = Entries {
            items: LruCache::unbounded(),
            bytes: 0,
        };
        Self {
            limit,
            entries: Mutex::new(entries),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Entries<T>> {
        // No code under the lock panics.
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Item `number`, if cached.
    pub fn get(&self, number: usize) -> Option<Arc<T>> {
        self.lock().items.get(&number).cloned()
    }

    /// True if item `number` is cached. This check does not count as a use.
    pub fn contains(&self, number: usize) -> bool {
        self.lock().items.contains(&number)
    }

    /// Caches item `number`, unless it exceeds the limit.
    pub fn put(&self, number: usize, item: Arc<T>) {
        let bytes = item.bytes();
        if bytes > self.limit {
            return;
        }
        let mut entries = self.lock();
        if let Some(before) = entries.items.put(number, item) {
            entries.bytes -= before.bytes();
        }
        entries.bytes += bytes;
        while entries.bytes > self.limit {
            let Some((_, oldest)) = entries.items.pop_lru() else {
                break;
            };
            entries.bytes -= oldest.bytes();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    #[test]
    fn the_phrase_unused_for_longest_goes_first_and_the_bound_holds() {
        let phrases: Vec<_> = (0..4)
            .map(|i| Arc::new(synthetic::phrase(i, 10, 0)))
            .collect();
        let one = phrases[0].bytes();
        let cache = MemoryCache::new(3 * one);
        for (number, phrase) in phrases.iter().enumerate().take(3) {
            cache.put(number, phrase.clone());
        }
        assert!(cache.get(0).is_some());
        cache.put(3, phrases[3].clone());
        cache.put(3, phrases[3].clone());
        let cached: Vec<bool> = (0..4).map(|n| cache.get(n).is_some()).collect();
        assert_eq!(cached, [true, false, true, true]);
        assert!(cache.lock().bytes <= 3 * one);
    }

    #[test]
    fn what_is_larger_than_the_bound_is_not_cached() {
        let cache = MemoryCache::new(100);
        cache.put(0, Arc::new(synthetic::phrase(0, 10, 0)));
        assert!(cache.get(0).is_none());
        assert_eq!(cache.lock().bytes, 0);
    }
}
