//! Stores: reading, writing and listing the files of a dataset, local or remote.
//!
//! Local folders are read directly, because the local store of `object_store` follows symbolic
//! links out of the folder. Buckets and web servers use `object_store` (Cargo feature `cloud`).

#[cfg(feature = "cloud")]
mod bounded;
mod error;
mod local;
#[cfg(feature = "cloud")]
mod remote;
#[cfg(feature = "cloud")]
mod services;

use std::collections::HashMap;
use std::fmt::Debug;
use std::path::PathBuf;
use std::sync::Arc;

pub use error::StoreError;

use crate::location::Location;
use crate::{Counters, Error, StoreConfig};

/// The location of a dataset. Clones share connections and counters.
#[derive(Clone, Debug)]
pub struct Store {
    backend: Arc<dyn Backend>,
    counters: Arc<Counters>,
}

/// A folder, a bucket or a web server.
trait Backend: Debug + Send + Sync {
    fn uri(&self) -> String;

    /// The address and endpoint: two providers may have buckets of the same name.
    fn address(&self) -> String {
        self.uri()
    }

    fn is_writable(&self) -> bool {
        true
    }

    fn is_remote(&self) -> bool;

    /// The object's bytes and version.
    fn read(&self, path: &str, limit: u64) -> Result<(Vec<u8>, String), StoreError>;

    fn write(&self, path: &str, bytes: Vec<u8>) -> Result<(), StoreError>;

    fn remove(&self, path: &str) -> Result<(), StoreError>;

    fn place(&self, path: &str) -> Result<Option<PathBuf>, StoreError>;

    /// All objects `FOLDER/ANY/FILE` or, without a file, `FOLDER/NAME`.
    fn list(&self, folder: &str, file: Option<&str>) -> Result<Vec<Object>, StoreError>;
}

/// An object in a listing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Object {
    /// Its path within the store.
    pub path: String,
    /// Its length in bytes.
    pub bytes: u64,
    /// Version of its contents: entity tag or modification time.
    pub version: String,
}

impl Store {
    /// Opens the store of `source` (see [`crate::DataConfig::source`]). A local folder need not
    /// exist yet. Fails with [`Error::Scheme`] for another kind of source; [`Error::Feature`] for a
    /// remote source in a build without `cloud`; [`Error::Store`] for unusable credentials or
    /// endpoints.
    pub fn open(source: &str, config: &StoreConfig) -> Result<Self, Error> {
        let counters = Arc::new(Counters::default());
        let backend: Arc<dyn Backend> = match Location::parse(source)? {
            Location::Folder(folder) => Arc::new(local::Folder::new(folder)),
            #[cfg(feature = "cloud")]
            Location::Remote { service, uri } => {
                let counters = counters.clone();
                Arc::new(remote::Remote::open(service, uri, config, counters)?)
            }
            #[cfg(not(feature = "cloud"))]
            Location::Remote { uri, .. } => {
                let _ = config;
                return Err(Error::Feature {
                    what: format!("data.source = \"{uri}\""),
                    feature: "cloud",
                });
            }
        };
        Ok(Self { backend, counters })
    }

    /// The address of the store in messages.
    pub fn uri(&self) -> String {
        self.backend.uri()
    }

    /// The store's address with its endpoint.
    pub(crate) fn address(&self) -> String {
        self.backend.address()
    }

    /// True if it is writable.
    pub fn is_writable(&self) -> bool {
        self.backend.is_writable()
    }

    /// Name of the object at `path` in messages.
    pub fn name_of(&self, path: &str) -> String {
        format!("{}/{path}", self.uri().trim_end_matches('/'))
    }

    /// True if reads use a network and therefore need a cache.
    pub fn is_remote(&self) -> bool {
        self.backend.is_remote()
    }

    /// Reads the object at `path`, at most `limit` bytes. Fails with [`StoreError::Missing`],
    /// [`StoreError::TooLarge`] and others.
    pub fn read(&self, path: &str, limit: u64) -> Result<Vec<u8>, StoreError> {
        Ok(self.read_version(path, limit)?.0)
    }

    /// Reads the object at `path`, if it exists. Fails as [`read`](Self::read), but not with
    /// [`StoreError::Missing`].
    pub fn find(&self, path: &str, limit: u64) -> Result<Option<Vec<u8>>, StoreError> {
        match self.read(path, limit) {
            Err(StoreError::Missing(_)) => Ok(None),
            read => read.map(Some),
        }
    }

    /// [`read`](Self::read) that also returns the object's version.
    pub(crate) fn read_version(
        &self,
        path: &str,
        limit: u64,
    ) -> Result<(Vec<u8>, String), StoreError> {
        let (bytes, version) = self.backend.read(path, limit)?;
        self.counters.read(bytes.len());
        Ok((bytes, version))
    }

    /// Writes the object at `path` atomically. Fails with [`StoreError`]; [`StoreError::ReadOnly`]
    /// for a web server.
    pub fn write(&self, path: &str, bytes: Vec<u8>) -> Result<(), StoreError> {
        self.backend.write(path, bytes)
    }

    /// Removes the object at `path`, if it exists. Fails with [`StoreError`];
    /// [`StoreError::ReadOnly`] for a web server.
    pub fn remove(&self, path: &str) -> Result<(), StoreError> {
        self.backend.remove(path)
    }

    /// Local path of the object at `path`, which need not exist; `None` for remote stores. Fails
    /// with [`StoreError::Outside`] if a link leads out of the folder.
    pub fn place(&self, path: &str) -> Result<Option<PathBuf>, StoreError> {
        self.backend.place(path)
    }

    /// All objects named `FOLDER/ANY/FILE`, sorted by path. Fails with [`StoreError`];
    /// [`StoreError::NoListing`] for a web server.
    pub fn list(&self, folder: &str, file: &str) -> Result<Vec<Object>, StoreError> {
        let mut objects = self.backend.list(folder, Some(file))?;
        objects.sort_unstable_by(|a, b| a.path.cmp(&b.path));
        Ok(objects)
    }

    /// All objects named `FOLDER/NAME.ENDING`, sorted by path; empty without the folder. Fails with
    /// [`StoreError`]; [`StoreError::NoListing`] for a web server.
    pub fn list_files(&self, folder: &str, ending: &str) -> Result<Vec<Object>, StoreError> {
        let mut objects = match self.backend.list(folder, None) {
            Err(StoreError::Missing(_)) => Vec::new(),
            listed => listed?,
        };
        let dotted = format!(".{ending}");
        objects.retain(|object| object.path.ends_with(&dotted));
        objects.sort_unstable_by(|a, b| a.path.cmp(&b.path));
        Ok(objects)
    }

    /// The version of each object in `folder`, by path; empty for local stores and without a
    /// listing.
    pub(crate) fn versions(&self, folder: &str) -> Result<HashMap<String, String>, StoreError> {
        if !self.is_remote() {
            return Ok(HashMap::new());
        }
        let objects = match self.backend.list(folder, None) {
            Err(StoreError::NoListing(_)) => Vec::new(),
            listed => listed?,
        };
        let versions = objects
            .into_iter()
            .map(|object| (object.path, object.version));
        Ok(versions.collect())
    }

    /// Counters of reads.
    pub fn counters(&self) -> &Arc<Counters> {
        &self.counters
    }
}
