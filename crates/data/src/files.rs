//! The files of a dataset: a store and, for a remote store, a cache.

use crate::cache::DiskCache;
use crate::digest::Digest;
use crate::listing::Expected;
use crate::store::Store;
use crate::{Counters, DataConfig, Error, StoreError};

/// Maximum number of reads until a file has the expected checksum.
const TRIES: usize = 3;

/// A store and, for a remote store, a cache.
#[derive(Debug)]
pub(crate) struct Files {
    pub store: Store,
    pub disk: Option<DiskCache>,
    /// Maximum number of concurrent requests; 0 for a local store.
    pub concurrency: usize,
}

impl Files {
    /// `store` with the disk cache of `config`. An unusable default cache only causes a warning.
    pub fn open(
        store: Store,
        config: &DataConfig,
        warnings: &mut Vec<String>,
    ) -> Result<Self, Error> {
        let is_remote = store.is_remote();
        let limit = config.cache.disk_mib << 20;
        let folder = config.cache.folder().filter(|_| is_remote && limit > 0);
        let disk = match folder.map(|folder| DiskCache::open(folder, limit)) {
            Some(Err(error)) if config.cache.dir.is_none() => {
                warnings.push(format!("no file is cached: {error}"));
                None
            }
            opened => opened.transpose()?,
        };
        let concurrency = if is_remote {
            config.store.concurrency
        } else {
            0
        };
        Ok(Self {
            store,
            disk,
            concurrency,
        })
    }

    /// [`read`](Self::read) of a file without an expected version; `None` if it is missing.
    pub fn find(&self, path: &str, limit: u64) -> Result<Option<(Vec<u8>, Digest)>, StoreError> {
        match self.read(path, &Expected::Version(String::new()), limit, "") {
            Err(StoreError::Missing(_)) => Ok(None),
            read => read.map(Some),
        }
    }

    /// The bytes of a file, from the disk cache or the store, with their checksum.
    pub fn read(
        &self,
        path: &str,
        expected: &Expected,
        limit: u64,
        recorded: &'static str,
    ) -> Result<(Vec<u8>, Digest), StoreError> {
        let key = |version: &str| {
            let uri = self.store.address();
            Digest::of_parts([uri.as_bytes(), path.as_bytes(), version.as_bytes()])
        };
        if let Some(disk) = &self.disk {
            let known = match expected {
                Expected::Checksum(digest) => Some(*digest),
                Expected::Version(version) if version.is_empty() => None,
                Expected::Version(version) => disk.name(&key(version)),
            };
            let cached = known.and_then(|digest| Some((disk.get(&digest)?, digest)));
            if let Some(found) = cached {
                Counters::increment(&self.store.counters().disk_hits);
                return Ok(found);
            }
        }
        let mut tries = 0;
        let (bytes, digest, version) = loop {
            tries += 1;
            let (bytes, version) = self.store.read_version(path, limit)?;
            let found = Digest::of(&bytes);
            match expected {
                Expected::Checksum(digest) if *digest != found => {
                    if tries >= TRIES || !self.store.is_remote() {
                        return Err(StoreError::Changed {
                            object: self.store.name_of(path),
                            recorded,
                            found: found.to_string(),
                            expected: digest.to_string(),
                        });
                    }
                    Counters::increment(&self.store.counters().retries);
                }
                _ => break (bytes, found, version),
            }
        };
        if let Some(disk) = &self.disk {
            disk.put(&digest, &bytes);
            // An object that changed after the listing has another version.
            if matches!(expected, Expected::Version(listed) if *listed == version && !listed.is_empty())
            {
                disk.put_name(&key(&version), &digest);
            }
        }
        Ok((bytes, digest))
    }
}
