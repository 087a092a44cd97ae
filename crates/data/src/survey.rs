//! Meeting every phrase of a dataset once.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use crate::cache::DiskCache;
use crate::library::{Files, Met, Origin, meet_synthetic};
use crate::listing::{Listed, Listing};
use crate::store::Store;
use crate::{Counters, DataConfig, DataKind, Error, FileError, StoreError};

/// Hears how many of how many phrases have been read; called from several threads.
pub type OpenProgress<'a> = &'a (dyn Fn(usize, usize) + Sync);

/// A dataset whose phrases are known by name.
pub(crate) struct Survey {
    pub origin: Origin,
    /// What is odd about the dataset as a whole.
    pub warnings: Vec<String>,
    pub counters: Arc<Counters>,
    /// How messages name the dataset.
    pub source: String,
    listed: Vec<Listed>,
    /// Most requests at a time; 0 where nothing is requested from afar.
    concurrency: usize,
}

impl Survey {
    /// Lists the phrases of a valid `config`.
    ///
    /// # Errors
    /// [`Error::Scheme`], [`Error::Feature`], [`Error::Store`], [`Error::Manifest`],
    /// [`Error::MissingFolder`], [`Error::EmptyDataset`], [`Error::Io`].
    pub fn new(config: &DataConfig) -> Result<Self, Error> {
        if config.kind == DataKind::Synthetic {
            return Ok(Self {
                origin: Origin::Synthetic(config.synthetic.clone()),
                warnings: Vec::new(),
                counters: Arc::default(),
                source: "synthetic".to_owned(),
                listed: Vec::new(),
                concurrency: 0,
            });
        }
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
        let disk = match (store.is_remote(), config.cache.disk_bytes()) {
            (false, _) | (_, 0) => None,
            (true, limit) => {
                let opened = config
                    .cache
                    .folder()
                    .map(|folder| DiskCache::open(folder, limit));
                match opened.transpose() {
                    Ok(disk) => disk,
                    Err(error) if config.cache.dir.is_some() => return Err(error),
                    Err(error) => {
                        warnings.push(format!("no file is cached: {error}"));
                        None
                    }
                }
            }
        };
        Ok(Self {
            warnings,
            counters: store.counters().clone(),
            source: store.uri(),
            listed: phrases,
            concurrency: match store.is_remote() {
                true => config.store.concurrency,
                false => 0,
            },
            origin: Origin::Files(Files { store, disk }),
        })
    }

    /// Reads each phrase and hands it to `take` with its number; id and outcome of each, in order.
    ///
    /// # Errors
    /// [`Error::Store`] if the store itself fails; never for a single bad phrase.
    #[expect(clippy::type_complexity, reason = "ids and outcomes, nothing more")]
    pub fn meet_all<T: Send>(
        &self,
        progress: OpenProgress,
        take: impl Fn(usize, Met) -> T + Sync,
    ) -> Result<Vec<(String, Result<T, FileError>)>, Error> {
        let (total, met) = (self.total(), AtomicUsize::new(0));
        let meet = |number: usize| {
            let (id, outcome) = self.meet(number);
            if let Err(FileError::Store(error)) = &outcome
                && !self.concerns_one_phrase(error)
            {
                return Err(Error::Store(error.clone()));
            }
            progress(met.fetch_add(1, Ordering::Relaxed) + 1, total);
            Ok((id, outcome.map(|met| take(number, met))))
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

    /// Whether other phrases may be good all the same.
    fn concerns_one_phrase(&self, error: &StoreError) -> bool {
        // A file that this machine does not give out says nothing of the next one.
        let here = self.concurrency == 0;
        let unreadable = matches!(error, StoreError::Denied { .. } | StoreError::Failed { .. });
        error.concerns_one_object() || (here && unreadable)
    }

    fn total(&self) -> usize {
        match &self.origin {
            Origin::Synthetic(config) => config.phrases,
            Origin::Files(_) | Origin::Held(_) => self.listed.len(),
        }
    }

    fn meet(&self, number: usize) -> (String, Result<Met, FileError>) {
        match &self.origin {
            Origin::Files(files) => {
                let listed = &self.listed[number];
                (listed.id.clone(), files.meet(listed, number))
            }
            Origin::Synthetic(config) => {
                let met = meet_synthetic(config, number);
                (met.entry.id.clone(), Ok(met))
            }
            Origin::Held(_) => unreachable!("held phrases are not surveyed"),
        }
    }
}
