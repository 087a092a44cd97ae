//! The endless stream of training batches.

use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::batch::SampleShape;
use crate::item::Item;
use crate::item_set::ItemSet;
use crate::order::Order;
use crate::prefetch::Prefetch;
use crate::{Batch, Counters, DataConfig, Error, LoaderReport};

/// Conversion of the items of a set to samples.
pub trait Samples: Clone + Send + Sync + 'static {
    /// Kind of the items.
    type Item: Item;

    /// The data that one sample needs.
    type Read: Send;

    /// The items.
    fn items(&self) -> &ItemSet<Self::Item>;

    /// The shape of every sample.
    fn shape(&self) -> SampleShape;

    /// True if item `position` is in memory.
    fn is_cached(&self, position: usize) -> bool {
        self.items().is_cached(position)
    }

    /// Reads the data for a sample of item `position`. Fails with [`Error::BadItem`] if the item's
    /// files are missing, changed or unreadable.
    fn read(&self, position: usize) -> Result<Self::Read, Error>;

    /// Adds training sample `number` or, without a number, the validation sample.
    fn push(&self, batch: &mut Batch, read: &Self::Read, number: Option<u64>);

    /// The validation samples of the items at `positions`, in one batch. Fails as
    /// [`read`](Self::read).
    fn collate(&self, positions: std::ops::Range<usize>) -> Result<Batch, Error> {
        let mut batch = Batch::with_capacity(positions.len(), &self.shape());
        for position in positions {
            self.push(&mut batch, &self.read(position)?, None);
        }
        Ok(batch)
    }
}

/// The batches of a loader: in each cycle of `of` batches, `each` batches from `offset` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BatchShare {
    /// Number of batches returned before.
    pub done: u64,
    /// First batch of this share in a cycle.
    pub offset: u64,
    /// Number of this share's batches in a cycle.
    pub each: u64,
    /// Batches in a cycle.
    pub of: u64,
}

impl BatchShare {
    /// All batches from `first` on.
    pub fn all(first: u64) -> Self {
        Self {
            done: first,
            offset: 0,
            each: 1,
            of: 1,
        }
    }

    /// The stream number of the batch after `done` returned batches.
    pub fn number(self, done: u64) -> u64 {
        (done / self.each).wrapping_mul(self.of) + self.offset + done % self.each
    }
}

/// An endless stream of training batches. Sample `i` of batch `b` is sample `n = b * batch_size +
/// i` of the stream: item `n mod P` of epoch `n / P`, for `P` items. The key of the crop and
/// augmentation is `n`. A batch therefore depends only on its number, also on resume and for any
/// number of workers. Batches cross epochs.
pub struct Loader {
    make: Box<dyn FnMut(u64) -> Result<Batch, Error> + Send>,
    share: BatchShare,
    prefetch: Option<Prefetch<Result<Batch, Error>>>,
    counters: Arc<Counters>,
}

impl Loader {
    /// A loader of `samples` whose first batch is batch `first_batch` of the stream of this `seed`.
    ///
    /// `data.num_workers` threads prefetch at most two batches each. Without threads,
    /// [`next`](Self::next) prepares each batch on all cores. Panics without items and for an
    /// invalid `config`.
    pub fn new(samples: impl Samples, config: &DataConfig, seed: u64, first_batch: u64) -> Self {
        Self::of_share(samples, config, seed, BatchShare::all(first_batch))
    }

    /// A loader of a share of the stream's batches.
    pub fn of_share(
        samples: impl Samples,
        config: &DataConfig,
        seed: u64,
        share: BatchShare,
    ) -> Self {
        let items = samples.items();
        assert!(!items.is_empty(), "a loader needs at least one item");
        assert!(config.batch_size > 0, "a batch has at least one sample");
        let counters = items.counters().clone();
        let mut maker = Maker::new(samples, config, seed);
        let make = move |done| maker.make(share.number(done));
        let prefetch = match config.num_workers {
            0 => None,
            workers => Prefetch::start(workers, share.done, make.clone()),
        };
        Self {
            make: Box::new(make),
            share,
            prefetch,
            counters,
        }
    }

    /// The next batch; blocks until the batch is ready. Fails with [`Error::BadItem`] if the files
    /// of an item are missing, unreadable or changed since the dataset was opened. Resumes the
    /// panic of a worker.
    #[expect(
        clippy::should_implement_trait,
        reason = "the stream has no end, so no Option"
    )]
    pub fn next(&mut self) -> Result<Batch, Error> {
        let batch = self.next_unless(&|| false)?;
        Ok(batch.expect("it never stops"))
    }

    /// [`next`](Self::next), or `None` if `stop` becomes true during the wait. Fails as
    /// [`next`](Self::next).
    pub fn next_unless(&mut self, stop: &dyn Fn() -> bool) -> Result<Option<Batch>, Error> {
        let started = Instant::now();
        let batch = match &mut self.prefetch {
            Some(prefetch) => match prefetch.next_unless(stop) {
                Some(batch) => batch,
                None => return Ok(None),
            },
            None => (self.make)(self.share.done),
        };
        self.share.done += 1;
        let batch = batch?;
        self.counters.batch(batch.batch_size, started.elapsed());
        Ok(Some(batch))
    }

    /// Loading statistics since the dataset was opened.
    pub fn report(&self) -> LoaderReport {
        self.counters.report()
    }

    /// The number of the next batch.
    pub fn next_batch(&self) -> u64 {
        self.share.number(self.share.done)
    }
}

/// A pool of threads that wait for a network; the pool may exceed the number of cores. `None` for
/// 0.
pub(crate) fn pool(threads: usize) -> Option<ThreadPool> {
    let pool = ThreadPoolBuilder::new().num_threads(threads);
    (threads > 0).then(|| pool.build().ok()).flatten()
}

/// Creates batches from their numbers.
#[derive(Clone)]
struct Maker<S> {
    samples: S,
    order: Order,
    batch_size: usize,
    /// True if the items of a batch are read in parallel.
    all_cores: bool,
    /// Threads for network reads of items, shared by all workers.
    readers: Option<Arc<ThreadPool>>,
}

impl<S: Samples> Maker<S> {
    fn new(samples: S, config: &DataConfig, seed: u64) -> Self {
        let concurrency = samples.items().concurrency();
        Self {
            readers: pool(concurrency).map(Arc::new),
            order: Order::new(samples.items().len(), seed),
            batch_size: config.batch_size,
            all_cores: config.num_workers == 0,
            samples,
        }
    }

    /// Creates batch `number`; reads uncached items in parallel if possible.
    fn make(&mut self, number: u64) -> Result<Batch, Error> {
        let Self { samples, .. } = self;
        let mut batch = Batch::with_capacity(self.batch_size, &samples.shape());
        let first = number.wrapping_mul(self.batch_size as u64);
        let numbers = (0..self.batch_size as u64).map(|i| first.wrapping_add(i));
        let numbers: Vec<(u64, usize)> = numbers.map(|n| (n, self.order.item(n))).collect();
        let is_cached = |&(_, position): &(u64, usize)| samples.is_cached(position);
        let read = || {
            let items = numbers
                .par_iter()
                .map(|&(_, position)| samples.read(position));
            items.collect()
        };
        let ahead: Vec<Result<S::Read, Error>> = match &self.readers {
            None if !self.all_cores => Vec::new(),
            _ if numbers.iter().all(is_cached) => Vec::new(),
            Some(readers) => readers.install(read),
            None => read(),
        };
        let mut ahead = ahead.into_iter();
        for (n, position) in numbers {
            let read = match ahead.next() {
                Some(read) => read?,
                None => samples.read(position)?,
            };
            samples.push(&mut batch, &read, Some(n));
        }
        Ok(batch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PhraseItem, PhraseSamples, synthetic};
    use kinegrad_motion::phrase_statistics;
    use std::collections::BTreeMap;

    fn config() -> DataConfig {
        let mut config = DataConfig {
            target_frames: 16,
            batch_size: 3,
            ..DataConfig::default()
        };
        config.augment.rotate_yaw = true;
        config.augment.mirror = true;
        config.augment.min_frames = Some(12);
        config.augment.audio_noise = 0.1;
        config
    }

    fn phrases() -> Vec<Arc<PhraseItem>> {
        (0..7)
            .map(|index| Arc::new(synthetic::phrase(index, 14 + 3 * index, 9)))
            .collect()
    }

    fn loader(config: &DataConfig, seed: u64, first_batch: u64) -> Loader {
        let phrases = phrases();
        let motions = phrases.iter().map(|phrase| &phrase.motion);
        let statistics = Arc::new(phrase_statistics(motions).unwrap());
        let samples = PhraseSamples::new(phrases.into(), statistics, config, seed);
        Loader::new(samples, config, seed, first_batch)
    }

    fn batches(config: &DataConfig, seed: u64, first_batch: u64, count: usize) -> Vec<Batch> {
        let mut loader = loader(config, seed, first_batch);
        (0..count).map(|_| loader.next().unwrap()).collect()
    }

    #[test]
    fn shares_are_parts_of_the_stream_and_continue_where_they_stopped() {
        let config = DataConfig {
            num_workers: 2,
            ..config()
        };
        let phrases = phrases();
        let motions = phrases.iter().map(|phrase| &phrase.motion);
        let statistics = Arc::new(phrase_statistics(motions).unwrap());
        let samples = PhraseSamples::new(phrases.into(), statistics, &config, 1);
        let all = batches(&config, 1, 0, 24);
        for rank in 0..3 {
            // Each rank has two of every six batches.
            let share = BatchShare {
                done: 0,
                offset: 2 * rank,
                each: 2,
                of: 6,
            };
            for done in [0, 4] {
                let share = BatchShare { done, ..share };
                let mut loader = Loader::of_share(samples.clone(), &config, 1, share);
                for taken in done..8 {
                    let number = 6 * (taken / 2) + 2 * rank + taken % 2;
                    assert_eq!(loader.next_batch(), number);
                    assert_eq!(loader.next().unwrap(), all[number as usize]);
                }
            }
        }
    }

    #[test]
    fn batches_are_the_same_with_any_number_of_workers_and_from_any_start() {
        let with = |num_workers| DataConfig {
            num_workers,
            ..config()
        };
        let expected = batches(&with(0), 1, 0, 20);
        for workers in [1, 2, 5] {
            assert_eq!(
                batches(&with(workers), 1, 0, 20),
                expected,
                "{workers} workers"
            );
            assert_eq!(
                batches(&with(workers), 1, 13, 7),
                expected[13..],
                "{workers} workers"
            );
        }
        assert_eq!(batches(&with(0), 1, 13, 7), expected[13..]);
        let other = batches(&with(0), 2, 0, 20);
        assert!(
            other
                .iter()
                .zip(&expected)
                .all(|(a, b)| a.x_start != b.x_start)
        );
        assert!(expected.iter().zip(&expected[1..]).all(|(a, b)| a != b));
    }

    #[test]
    fn batches_of_files_equal_those_of_memory_with_any_number_of_readers() {
        let folder = tempfile::tempdir().unwrap();
        synthetic::write_dataset(folder.path(), crate::AudioLayout::CCMOTION, 9, 20, 3).unwrap();
        let batches = |num_workers, memory_mib| {
            let mut config = DataConfig {
                source: Some(folder.path().display().to_string()),
                num_workers,
                ..config()
            };
            config.cache.memory_mib = memory_mib;
            let dataset = crate::Dataset::open(&config).unwrap();
            let statistics = Arc::new(dataset.statistics().unwrap());
            let samples = PhraseSamples::new(dataset.train, statistics, &config, 1);
            let mut loader = Loader::new(samples, &config, 1, 0);
            (0..8).map(|_| loader.next().unwrap()).collect::<Vec<_>>()
        };
        let expected = batches(2, 1024);
        for (workers, memory) in [(0, 0), (0, 1024), (2, 0)] {
            assert_eq!(batches(workers, memory), expected, "{workers} {memory}");
        }
    }

    #[test]
    fn a_batch_may_exceed_the_dataset_and_epochs_are_even() {
        let config = DataConfig {
            batch_size: 35,
            num_workers: 2,
            ..config()
        };
        for batch in batches(&config, 4, 0, 2) {
            assert_eq!(
                (batch.batch_size, batch.frames, batch.ids.len()),
                (35, 16, 35)
            );
            let mut counts: BTreeMap<String, usize> = BTreeMap::new();
            for id in batch.ids {
                *counts.entry(id).or_default() += 1;
            }
            assert_eq!(counts.into_values().collect::<Vec<_>>(), [5; 7]);
        }
    }

    #[test]
    fn the_sampling_does_not_depend_on_the_batch_size() {
        let small = batches(
            &DataConfig {
                batch_size: 3,
                ..config()
            },
            1,
            0,
            4,
        );
        let large = batches(
            &DataConfig {
                batch_size: 12,
                ..config()
            },
            1,
            0,
            1,
        );
        let joined: Vec<f32> = small
            .iter()
            .flat_map(|batch| batch.x_start.clone())
            .collect();
        assert_eq!(joined, large[0].x_start);
    }

    #[test]
    fn padding_is_zero_where_the_mask_is() {
        let mut padded = 0;
        for batch in batches(&config(), 6, 0, 5) {
            for (sample, mask) in batch.mask.chunks(batch.frames).enumerate() {
                let valid = mask.iter().filter(|&&value| value == 1.0).count();
                assert!(mask[..valid].iter().all(|&value| value == 1.0));
                assert!(mask[valid..].iter().all(|&value| value == 0.0));
                assert!(valid >= 12);
                padded += batch.frames - valid;
                for (rows, channels) in [(&batch.x_start, 25), (&batch.conditions[0].values, 163)] {
                    let values =
                        &rows[sample * channels * batch.frames..][..channels * batch.frames];
                    for row in values.chunks(batch.frames) {
                        assert!(row[valid..].iter().all(|&value| value == 0.0));
                    }
                }
            }
        }
        assert!(padded > 0, "the case came up");
    }
}
