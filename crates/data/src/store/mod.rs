//! Stores: reading, writing and listing the files of a dataset anywhere.
//!
//! Local folders are read directly, because `object_store`'s local store follows symbolic links out
//! of the folder. Buckets and web servers use `object_store` (Cargo feature `cloud`).

mod error;
mod local;
#[cfg(feature = "cloud")]
mod remote;
#[cfg(feature = "cloud")]
mod services;

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

pub use error::StoreError;

use crate::location::Location;
use crate::{Counters, Error, StoreConfig};

/// The location of a dataset. Clones share connections and counters.
#[derive(Clone, Debug)]
pub struct Store {
    kind: Kind,
    counters: Arc<Counters>,
}

#[derive(Clone, Debug)]
enum Kind {
    Local(local::Folder),
    #[cfg(feature = "cloud")]
    Remote(Arc<remote::Remote>),
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
    /// The store of `source` (see [`crate::DataConfig::source`]). A local folder need not exist
    /// yet.
    ///
    /// # Errors
    /// [`Error::Scheme`] for another kind of source; [`Error::Feature`] for a remote source in a
    /// build without `cloud`; [`Error::Store`] for unusable credentials or endpoints.
    pub fn open(source: &str, config: &StoreConfig) -> Result<Self, Error> {
        let counters = Arc::new(Counters::default());
        let kind = match Location::parse(source)? {
            Location::Folder(folder) => Kind::Local(local::Folder::new(folder)),
            #[cfg(feature = "cloud")]
            Location::Remote { service, uri } => {
                let remote = remote::Remote::open(service, uri, config, counters.clone())?;
                Kind::Remote(Arc::new(remote))
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
        Ok(Self { kind, counters })
    }

    /// The store's address, for messages.
    pub fn uri(&self) -> String {
        match &self.kind {
            Kind::Local(folder) => folder.root().display().to_string(),
            #[cfg(feature = "cloud")]
            Kind::Remote(remote) => remote.uri().to_owned(),
        }
    }

    /// The store's address with its endpoint: two providers may have the same bucket.
    pub(crate) fn address(&self) -> String {
        match &self.kind {
            Kind::Local(_) => self.uri(),
            #[cfg(feature = "cloud")]
            Kind::Remote(remote) => remote.address(),
        }
    }

    /// True if it is writable.
    pub fn is_writable(&self) -> bool {
        match &self.kind {
            Kind::Local(_) => true,
            #[cfg(feature = "cloud")]
            Kind::Remote(remote) => remote.is_writable(),
        }
    }

    /// Name of the object at `path` in messages.
    pub fn name_of(&self, path: &str) -> String {
        format!("{}/{path}", self.uri().trim_end_matches('/'))
    }

    /// True if reads use a network, so that caching helps.
    pub fn is_remote(&self) -> bool {
        match &self.kind {
            Kind::Local(_) => false,
            #[cfg(feature = "cloud")]
            Kind::Remote(_) => true,
        }
    }

    /// Reads the object at `path`, of at most `limit` bytes.
    ///
    /// # Errors
    /// [`StoreError::Missing`], [`StoreError::TooLarge`] and others.
    pub fn read(&self, path: &str, limit: u64) -> Result<Vec<u8>, StoreError> {
        Ok(self.read_version(path, limit)?.0)
    }

    /// Reads the object at `path`, if it exists.
    ///
    /// # Errors
    /// As [`read`](Self::read), but for [`StoreError::Missing`].
    pub fn find(&self, path: &str, limit: u64) -> Result<Option<Vec<u8>>, StoreError> {
        match self.read(path, limit) {
            Err(StoreError::Missing { .. }) => Ok(None),
            read => read.map(Some),
        }
    }

    /// [`read`](Self::read) with the version of the object.
    pub(crate) fn read_version(
        &self,
        path: &str,
        limit: u64,
    ) -> Result<(Vec<u8>, String), StoreError> {
        let (bytes, version) = match &self.kind {
            Kind::Local(folder) => (folder.read(path, limit)?, String::new()),
            #[cfg(feature = "cloud")]
            Kind::Remote(remote) => remote.read(path, limit)?,
        };
        self.counters.read(bytes.len());
        Ok((bytes, version))
    }

    /// Writes the object at `path`, atomically.
    ///
    /// # Errors
    /// [`StoreError`]; [`StoreError::ReadOnly`] for a web server.
    pub fn write(&self, path: &str, bytes: Vec<u8>) -> Result<(), StoreError> {
        match &self.kind {
            Kind::Local(folder) => folder.write(path, &bytes),
            #[cfg(feature = "cloud")]
            Kind::Remote(remote) => remote.write(path, bytes),
        }
    }

    /// Removes the object at `path`, if it exists.
    ///
    /// # Errors
    /// [`StoreError`]; [`StoreError::ReadOnly`] for a web server.
    pub fn remove(&self, path: &str) -> Result<(), StoreError> {
        match &self.kind {
            Kind::Local(folder) => folder.remove(path),
            #[cfg(feature = "cloud")]
            Kind::Remote(remote) => remote.remove(path),
        }
    }

    /// Local path of the object at `path`, existing or not; `None` for remote stores.
    ///
    /// # Errors
    /// [`StoreError::Outside`] if a link leads out of the folder.
    pub fn place(&self, path: &str) -> Result<Option<PathBuf>, StoreError> {
        match &self.kind {
            Kind::Local(folder) => folder.place(path).map(Some),
            #[cfg(feature = "cloud")]
            Kind::Remote(_) => Ok(None),
        }
    }

    /// All objects named `FOLDER/ANY/FILE`, sorted by path.
    ///
    /// # Errors
    /// [`StoreError`]; [`StoreError::NoListing`] for a web server.
    pub fn list(&self, folder: &str, file: &str) -> Result<Vec<Object>, StoreError> {
        let mut objects = match &self.kind {
            Kind::Local(root) => root.list(folder, file)?,
            #[cfg(feature = "cloud")]
            Kind::Remote(remote) => {
                remote.list(folder, |path| middle(path, folder, file).is_some())?
            }
        };
        objects.sort_unstable_by(|a, b| a.path.cmp(&b.path));
        Ok(objects)
    }

    /// All objects named `FOLDER/NAME.ENDING`, sorted by path; none without the folder.
    ///
    /// # Errors
    /// [`StoreError`]; [`StoreError::NoListing`] for a web server.
    pub fn list_files(&self, folder: &str, ending: &str) -> Result<Vec<Object>, StoreError> {
        let listed = match &self.kind {
            Kind::Local(root) => root.list_files(folder),
            #[cfg(feature = "cloud")]
            Kind::Remote(remote) => remote.list(folder, |path| directly_below(path, folder)),
        };
        let mut objects = match listed {
            Err(StoreError::Missing { .. }) => Vec::new(),
            listed => listed?,
        };
        let dotted = format!(".{ending}");
        objects.retain(|object| object.path.ends_with(&dotted));
        objects.sort_unstable_by(|a, b| a.path.cmp(&b.path));
        Ok(objects)
    }

    /// The version of each object directly in `folder`, by path, for the cache. Empty without a
    /// cache or listing.
    ///
    /// # Errors
    /// [`StoreError`].
    #[cfg_attr(not(feature = "cloud"), expect(unused_variables))]
    pub(crate) fn versions(&self, folder: &str) -> Result<HashMap<String, String>, StoreError> {
        match &self.kind {
            Kind::Local(_) => Ok(HashMap::new()),
            #[cfg(feature = "cloud")]
            Kind::Remote(remote) => {
                let objects = match remote.list(folder, |path| directly_below(path, folder)) {
                    Err(StoreError::NoListing { .. }) => Vec::new(),
                    listed => listed?,
                };
                let versions = objects
                    .into_iter()
                    .map(|object| (object.path, object.version));
                Ok(versions.collect())
            }
        }
    }

    /// Counters of reads.
    pub fn counters(&self) -> &Arc<Counters> {
        &self.counters
    }
}

/// True if `path` is `FOLDER/NAME`.
#[cfg(feature = "cloud")]
fn directly_below(path: &str, folder: &str) -> bool {
    let rest = path.strip_prefix(folder);
    let name = rest.and_then(|rest| rest.strip_prefix('/'));
    name.is_some_and(|name| !name.contains('/') && !name.starts_with('.'))
}

/// The object's folder below `folder`, if `path` is `FOLDER/ANY/FILE`.
#[cfg(feature = "cloud")]
fn middle<'a>(path: &'a str, folder: &str, file: &str) -> Option<&'a str> {
    let rest = path.strip_prefix(folder)?.strip_prefix('/')?;
    let (middle, name) = rest.rsplit_once('/')?;
    (name == file && !middle.contains('/') && !middle.starts_with('.')).then_some(middle)
}
