//! The files of a dataset: a store, with a cache for remote ones.

use crate::cache::DiskCache;
use crate::digest::Digest;
use crate::listing::Expected;
use crate::store::Store;
use crate::{DataConfig, Error, StoreError};

/// Tries of a file whose bytes are not those expected: the first may have been damaged under way.
const TRIES: usize = 3;

/// A store, with the cache that stands before a remote one.
#[derive(Debug)]
pub(crate) struct Files {
    pub store: Store,
    pub disk: Option<DiskCache>,
    /// Most requests at a time; 0 where nothing is requested from afar.
    pub concurrency: usize,
}

impl Files {
    /// `store` with the disk cache of a valid `config`; a cache that cannot be had is a warning,
    /// unless the config names its folder.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn open(
        store: Store,
        config: &DataConfig,
        warnings: &mut Vec<String>,
    ) -> Result<Self, Error> {
        let disk = match (store.is_remote(), config.cache.disk_mib << 20) {
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
        let concurrency = match store.is_remote() {
            true => config.store.concurrency,
            false => 0,
        };
        Ok(Self {
            store,
            disk,
            concurrency,
        })
    }

    /// [`read`](Self::read) of a file of which nothing is known before; none where it is missing.
    pub fn find(&self, path: &str, limit: u64) -> Result<Option<(Vec<u8>, Digest)>, StoreError> {
        match self.read(path, &Expected::Version(String::new()), limit, "") {
            Err(StoreError::Missing { .. }) => Ok(None),
            read => read.map(Some),
        }
    }

    /// The bytes of one file, from the disk cache or the store, with their checksum.
    pub fn read(
        &self,
        path: &str,
        expected: &Expected,
        limit: u64,
        recorded: &'static str,
    ) -> Result<(Vec<u8>, Digest), StoreError> {
        let key = match expected {
            Expected::Version(version) if !version.is_empty() => {
                let uri = self.store.address();
                let parts = [uri.as_bytes(), path.as_bytes(), version.as_bytes()];
                Some(Digest::of_parts(parts))
            }
            _ => None,
        };
        if let Some(disk) = &self.disk {
            let known = match expected {
                Expected::Checksum(digest) => Some(*digest),
                Expected::Version(_) => key.and_then(|key| disk.name(&key)),
            };
            let cached = known.and_then(|digest| Some((disk.get(&digest)?, digest)));
            if let Some(found) = cached {
                self.store.counters().disk_hit();
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
                    self.store.counters().retry();
                }
                _ => break (bytes, found, version),
            }
        };
        if let Some(disk) = &self.disk {
            disk.put(&digest, &bytes);
            // What was overwritten since it was listed is another version than the key's.
            let as_listed = matches!(expected, Expected::Version(listed) if *listed == version);
            if let Some(key) = key.filter(|_| as_listed) {
                disk.put_name(&key, &digest);
            }
        }
        Ok((bytes, digest))
    }
}
