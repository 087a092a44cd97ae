//! Phrases in memory, bounded in bytes; the one unused for longest goes first.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lru::LruCache;

use crate::Phrase;

/// Phrases by their number in the dataset.
#[derive(Debug)]
pub(crate) struct MemoryCache {
    limit: usize,
    held: Mutex<Held>,
}

#[derive(Debug)]
struct Held {
    phrases: LruCache<usize, Arc<Phrase>>,
    bytes: usize,
}

impl MemoryCache {
    /// An empty cache of at most `limit` bytes.
    pub fn new(limit: usize) -> Self {
        let held = Held {
            phrases: LruCache::unbounded(),
            bytes: 0,
        };
        Self {
            limit,
            held: Mutex::new(held),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Held> {
        // Nothing that panics runs under the lock.
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Phrase `number`, if it is held.
    pub fn get(&self, number: usize) -> Option<Arc<Phrase>> {
        self.lock().phrases.get(&number).cloned()
    }

    /// Whether phrase `number` is held now; counts as no use of it.
    pub fn holds(&self, number: usize) -> bool {
        self.lock().phrases.contains(&number)
    }

    /// Holds phrase `number` from now on, unless it alone exceeds the limit.
    pub fn put(&self, number: usize, phrase: Arc<Phrase>) {
        let bytes = size_of(&phrase);
        if bytes > self.limit {
            return;
        }
        let mut held = self.lock();
        if let Some(before) = held.phrases.put(number, phrase) {
            held.bytes -= size_of(&before);
        }
        held.bytes += bytes;
        while held.bytes > self.limit {
            let Some((_, oldest)) = held.phrases.pop_lru() else {
                break;
            };
            held.bytes -= size_of(&oldest);
        }
    }
}

/// Bytes that a phrase takes in memory.
fn size_of(phrase: &Phrase) -> usize {
    let values = phrase.motion.as_slice().len() + phrase.audio.as_slice().len();
    size_of_val(phrase) + phrase.id.len() + 4 * values
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
        let one = size_of(&phrases[0]);
        let cache = MemoryCache::new(3 * one);
        for (number, phrase) in phrases.iter().enumerate().take(3) {
            cache.put(number, phrase.clone());
        }
        assert!(cache.get(0).is_some());
        cache.put(3, phrases[3].clone());
        cache.put(3, phrases[3].clone());
        let held: Vec<bool> = (0..4).map(|n| cache.get(n).is_some()).collect();
        assert_eq!(held, [true, false, true, true]);
        assert!(cache.lock().bytes <= 3 * one);
    }

    #[test]
    fn what_is_larger_than_the_bound_is_not_held() {
        let cache = MemoryCache::new(100);
        cache.put(0, Arc::new(synthetic::phrase(0, 10, 0)));
        assert!(cache.get(0).is_none());
        assert_eq!(cache.lock().bytes, 0);
    }
}
