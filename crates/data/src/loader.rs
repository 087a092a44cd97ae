//! The endless stream of training batches.

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use kinegrad_motion::TrainingStatistics;
use kinegrad_motion::humanml::FeatureStatistics;
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::augment::Sampler;
use crate::batch::Shape;
use crate::humanml::{ClipMaker, ClipSet};
use crate::order::Order;
use crate::passage::Passages;
use crate::prefetch::Prefetch;
use crate::{Batch, Counters, DataConfig, Error, LoaderReport, PhraseSet};

/// Hands out training batches, one after the other, without end.
///
/// Sample `i` of batch `b` is sample `n = b * batch_size + i` of the stream: phrase (or clip)
/// number `n mod P` of epoch `n / P` over the `P` phrases, cropped and augmented by draws keyed by
/// `n`. So a batch follows from its number alone: a resumed run asks for the next number, and the
/// number of workers changes nothing. Batches cross epochs, and may hold more samples than there
/// are phrases.
pub struct Loader {
    maker: Box<dyn MakeBatch>,
    next_batch: u64,
    prefetch: Option<Prefetch<Result<Batch, Error>>>,
    counters: Arc<Counters>,
}

/// Makes any batch from its number.
pub(crate) trait MakeBatch: Send {
    /// Batch `number`.
    ///
    /// # Errors
    /// As [`Loader::next`].
    fn make(&mut self, number: u64) -> Result<Batch, Error>;
}

impl Loader {
    /// A loader that begins with batch `first_batch` of the stream of this `seed`.
    ///
    /// `data.num_workers` threads make batches ahead, at most two each; with 0, or where the system
    /// gives no threads, [`next`](Self::next) makes them itself, reading on all cores with 0.
    ///
    /// # Panics
    /// Panics if there are no phrases, or if `config` has not passed [`DataConfig::validate`].
    pub fn new(
        phrases: PhraseSet,
        statistics: Arc<TrainingStatistics>,
        config: &DataConfig,
        seed: u64,
        first_batch: u64,
    ) -> Self {
        assert!(!phrases.is_empty(), "a loader needs at least one phrase");
        assert!(config.batch_size > 0, "a batch holds at least one sample");
        let (counters, concurrency) = (phrases.counters().clone(), phrases.concurrency());
        let passages = if config.join_neighbours {
            Passages::joined(phrases, config.target_frames)
        } else {
            Passages::alone(phrases, config.target_frames)
        };
        let maker = PhraseMaker {
            samples: Samples::new(passages.len(), config, seed, concurrency),
            sampler: Sampler::new(config, seed),
            passages,
            statistics,
            frames: config.target_frames,
        };
        Self::start(maker, config.num_workers, first_batch, counters)
    }

    /// A loader of HumanML3D clips, in every other respect as [`new`](Self::new): `channels` of
    /// the features with the root that `config.humanml3d` names, normalised by `statistics`, and
    /// the embedding of a caption as the condition.
    ///
    /// # Panics
    /// As [`new`](Self::new); or if `statistics` or `channels` are not of the configured layout and
    /// root.
    pub fn clips(
        clips: ClipSet,
        statistics: Arc<FeatureStatistics>,
        channels: Range<usize>,
        config: &DataConfig,
        seed: u64,
        first_batch: u64,
    ) -> Self {
        assert!(!clips.is_empty(), "a loader needs at least one clip");
        assert!(config.batch_size > 0, "a batch holds at least one sample");
        let counters = clips.counters().clone();
        let samples = Samples::new(clips.len(), config, seed, clips.concurrency());
        let maker = ClipMaker::new(clips, statistics, channels, samples, config, seed);
        Self::start(maker, config.num_workers, first_batch, counters)
    }

    /// The stream that `maker`, all of whose clones make the same batches, gives.
    fn start<M: MakeBatch + Clone + 'static>(
        maker: M,
        workers: usize,
        first_batch: u64,
        counters: Arc<Counters>,
    ) -> Self {
        let prefetch = match workers {
            0 => None,
            workers => {
                let mut maker = maker.clone();
                Prefetch::start(workers, first_batch, move |number| maker.make(number))
            }
        };
        Self {
            maker: Box::new(maker),
            next_batch: first_batch,
            prefetch,
            counters,
        }
    }

    /// The next batch; blocks until it is ready.
    ///
    /// # Errors
    /// [`Error::BadItem`] for a phrase or clip whose files are gone, have changed or cannot be read any
    /// more since the dataset was opened.
    ///
    /// # Panics
    /// Goes on with the panic of a worker, if there was one.
    #[expect(
        clippy::should_implement_trait,
        reason = "the stream has no end, so no Option"
    )]
    pub fn next(&mut self) -> Result<Batch, Error> {
        let batch = self.next_unless(&|| false)?;
        Ok(batch.expect("nobody asks to stop"))
    }

    /// [`next`](Self::next), or `None` if `stop` comes to hold while a worker makes it, which may
    /// wait for a network.
    ///
    /// # Errors
    /// As [`next`](Self::next).
    ///
    /// # Panics
    /// As [`next`](Self::next).
    pub fn next_unless(&mut self, stop: &dyn Fn() -> bool) -> Result<Option<Batch>, Error> {
        let asked = Instant::now();
        let batch = match &mut self.prefetch {
            Some(prefetch) => match prefetch.next_unless(stop) {
                Some(batch) => batch,
                None => return Ok(None),
            },
            None => self.maker.make(self.next_batch),
        };
        self.next_batch += 1;
        let batch = batch?;
        self.counters.batch(batch.batch_size, asked.elapsed());
        Ok(Some(batch))
    }

    /// What loading has cost since the dataset was opened.
    pub fn report(&self) -> LoaderReport {
        self.counters.report()
    }

    /// The number of the batch that [`next`](Self::next) will give.
    pub fn next_batch(&self) -> u64 {
        self.next_batch
    }
}

/// Which items the samples of a batch are of.
#[derive(Clone)]
pub(crate) struct Samples {
    order: Order,
    batch_size: usize,
    /// Whether the items of a batch are read by rayon's threads and not one after the other.
    all_cores: bool,
    /// Threads that wait for a network, shared by all workers; there, they read the items.
    readers: Option<Arc<ThreadPool>>,
}

impl Samples {
    /// The samples of a run with this `seed` over so many items, of which `concurrency` may be
    /// read at once where they lie far away.
    pub fn new(items: usize, config: &DataConfig, seed: u64, concurrency: usize) -> Self {
        let readers = ThreadPoolBuilder::new().num_threads(concurrency);
        Self {
            readers: match concurrency {
                0 => None,
                _ => readers.build().ok().map(Arc::new),
            },
            order: Order::new(items, seed),
            batch_size: config.batch_size,
            all_cores: config.num_workers == 0,
        }
    }

    /// Makes batch `number` of samples of this `shape`: reads the items of its samples with
    /// `get`, ahead where that gains something, and hands them to `push` with the samples'
    /// numbers, in order.
    ///
    /// # Errors
    /// Those of `get`.
    pub fn make<T: Send>(
        &mut self,
        number: u64,
        shape: Shape,
        is_at_hand: impl Fn(usize) -> bool,
        get: impl Fn(usize) -> Result<T, Error> + Sync,
        mut push: impl FnMut(&mut Batch, u64, T),
    ) -> Result<Batch, Error> {
        let mut batch = Batch::with_capacity(self.batch_size, shape);
        let first = number.wrapping_mul(self.batch_size as u64);
        let samples = (0..self.batch_size as u64).map(|i| first.wrapping_add(i));
        let samples: Vec<(u64, usize)> = samples.map(|n| (n, self.order.phrase(n))).collect();
        let at_hand = |&(_, position): &(u64, usize)| is_at_hand(position);
        let read = || samples.par_iter().map(|&(_, item)| get(item)).collect();
        let at_once = self.all_cores || self.readers.is_some();
        let ahead: Vec<Result<T, Error>> = match &self.readers {
            _ if !at_once || samples.iter().all(at_hand) => Vec::new(),
            Some(readers) => readers.install(read),
            None => read(),
        };
        let mut ahead = ahead.into_iter();
        for (n, position) in samples {
            let item = match ahead.next() {
                Some(item) => item?,
                None => get(position)?,
            };
            push(&mut batch, n, item);
        }
        Ok(batch)
    }
}

/// Makes batches of phrases.
#[derive(Clone)]
struct PhraseMaker {
    passages: Passages,
    statistics: Arc<TrainingStatistics>,
    samples: Samples,
    sampler: Sampler,
    frames: usize,
}

impl MakeBatch for PhraseMaker {
    fn make(&mut self, number: u64) -> Result<Batch, Error> {
        let Self {
            passages,
            statistics,
            samples,
            sampler,
            frames,
        } = self;
        samples.make(
            number,
            Shape::of_phrases(*frames),
            |position| passages.is_at_hand(position),
            |position| passages.get(position),
            |batch, n, passage| {
                let (motion, audio) = sampler.windows(&passage, n);
                batch.push_phrase(&passage.id, motion, audio, statistics);
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Phrase;
    use crate::synthetic;
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

    fn phrases() -> Vec<Arc<Phrase>> {
        (0..7)
            .map(|index| Arc::new(synthetic::phrase(index, 14 + 3 * index, 9)))
            .collect()
    }

    fn loader(config: &DataConfig, seed: u64, first_batch: u64) -> Loader {
        let phrases = phrases();
        let motions = phrases.iter().map(|phrase| &phrase.motion);
        let statistics = Arc::new(TrainingStatistics::compute(motions).unwrap());
        Loader::new(phrases.into(), statistics, config, seed, first_batch)
    }

    fn batches(config: &DataConfig, seed: u64, first_batch: u64, count: usize) -> Vec<Batch> {
        let mut loader = loader(config, seed, first_batch);
        (0..count).map(|_| loader.next().unwrap()).collect()
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
    fn batches_of_files_are_those_of_memory_whoever_reads_them() {
        let folder = tempfile::tempdir().unwrap();
        synthetic::write_dataset(folder.path(), 9, 20, 3).unwrap();
        let batches = |num_workers, memory_mib| {
            let mut config = DataConfig {
                source: Some(folder.path().display().to_string()),
                num_workers,
                ..config()
            };
            config.cache.memory_mib = memory_mib;
            let phrases = crate::Dataset::open(&config).unwrap().train;
            let statistics = Arc::new(phrases.statistics().unwrap());
            let mut loader = Loader::new(phrases, statistics, &config, 1, 0);
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
                for (rows, channels) in [(&batch.x_start, 25), (&batch.cond, 163)] {
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
