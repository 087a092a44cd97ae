//! Content-addressed disk cache of remote files.
//!
//! `objects/AB/SHA256` contains the bytes with that SHA-256: reads detect damage, and equal files
//! are stored once. `names/KEY` contains the checksum of one version of one object, for stores
//! without a manifest. Files appear by a rename and never change, so processes may share the
//! folder. One process at a time evicts files.

use std::fs::{self, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::SystemTime;

use crate::digest::Digest;
use crate::file::{read_file, read_text};
use crate::{Error, atomic};

/// Share of the limit that remains in use after eviction.
const KEPT_SHARE: f64 = 0.9;

/// A folder of files with a size limit.
#[derive(Debug)]
pub(crate) struct DiskCache {
    folder: PathBuf,
    limit: u64,
    /// Bytes written since the last measurement.
    unmeasured: AtomicU64,
}

impl DiskCache {
    /// The cache in `folder`, created if missing.
    pub fn open(folder: PathBuf, limit: u64) -> Result<Self, Error> {
        for part in ["objects", "names"] {
            let part = folder.join(part);
            fs::create_dir_all(&part)
                .map_err(|reason| Error::io("create data.cache.dir", &part, reason))?;
        }
        let cache = Self {
            folder,
            limit,
            unmeasured: AtomicU64::new(0),
        };
        cache.make_room();
        Ok(cache)
    }

    /// The bytes with this checksum, if cached and intact. A damaged file is removed.
    pub fn get(&self, digest: &Digest) -> Option<Vec<u8>> {
        let path = self.object(digest);
        let bytes = read_file(&path, self.limit).ok()?;
        if Digest::of(&bytes) != *digest {
            let _ = fs::remove_file(&path);
            return None;
        }
        // Eviction uses the modification time; a read-only cache works without it.
        if let Ok(file) = kinegrad_output::append(&path) {
            let _ = file.set_modified(SystemTime::now());
        }
        Some(bytes)
    }

    /// Stores `bytes`. A full disk is not an error: the item is read from its source again.
    pub fn put(&self, digest: &Digest, bytes: &[u8]) {
        if bytes.len() as u64 > self.limit {
            return;
        }
        let path = self.object(digest);
        if path.exists() || atomic::write(&path, bytes).is_err() {
            return;
        }
        let written = bytes.len() as u64;
        let unmeasured = self.unmeasured.fetch_add(written, Ordering::Relaxed) + written;
        if unmeasured > self.limit / 20 {
            self.make_room();
        }
    }

    /// The checksum stored under `key`.
    pub fn name(&self, key: &Digest) -> Option<Digest> {
        let text = read_text(&self.folder.join("names").join(key.to_string())).ok()?;
        Digest::parse(text.trim())
    }

    /// Stores a checksum under `key`.
    pub fn put_name(&self, key: &Digest, digest: &Digest) {
        let path = self.folder.join("names").join(key.to_string());
        let text = digest.to_string();
        // Without the name, the object is read again.
        let _ = atomic::write(&path, text.as_bytes());
    }

    fn object(&self, digest: &Digest) -> PathBuf {
        let name = digest.to_string();
        self.folder.join("objects").join(&name[..2]).join(name)
    }

    /// Removes the least recently used files until the cache is below the limit, unless another
    /// process is evicting.
    fn make_room(&self) {
        let Ok(lock) = kinegrad_output::lock(&self.folder.join("lock")) else {
            return;
        };
        // Without file locks, each process evicts by itself.
        if matches!(lock.try_lock(), Err(TryLockError::WouldBlock)) {
            return;
        }
        self.unmeasured.store(0, Ordering::Relaxed);
        let mut files = Vec::new();
        collect(&self.folder.join("objects"), &mut files);
        collect(&self.folder.join("names"), &mut files);
        let mut total: u64 = files.iter().map(|(.., bytes)| bytes).sum();
        if total <= self.limit {
            return;
        }
        files.sort_unstable();
        let target = (self.limit as f64 * KEPT_SHARE) as u64;
        for (_, path, bytes) in files {
            if total <= target {
                break;
            }
            if fs::remove_file(&path).is_ok() {
                total -= bytes;
            }
        }
    }
}

/// All files in `folder` with their last use and size.
fn collect(folder: &Path, files: &mut Vec<(SystemTime, PathBuf, u64)>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let Ok(metadata) = entry.metadata() else {
            continue;
        };
        if metadata.is_dir() {
            collect(&entry.path(), files);
        } else {
            let used = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
            files.push((used, entry.path(), metadata.len()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn bytes_in(folder: &Path) -> u64 {
        let mut files = Vec::new();
        collect(folder, &mut files);
        files.iter().map(|(.., bytes)| bytes).sum()
    }

    #[test]
    fn a_damaged_file_is_not_given_out_and_goes() {
        let folder = tempfile::tempdir().unwrap();
        let cache = DiskCache::open(folder.path().to_owned(), 1000).unwrap();
        let digest = Digest::of(b"phrase");
        assert!(cache.get(&digest).is_none());
        cache.put(&digest, b"phrase");
        assert_eq!(cache.get(&digest).unwrap(), b"phrase");
        fs::write(cache.object(&digest), b"phrasf").unwrap();
        assert!(cache.get(&digest).is_none());
        assert!(!cache.object(&digest).exists());
    }

    #[test]
    fn names_lead_to_checksums() {
        let folder = tempfile::tempdir().unwrap();
        let cache = DiskCache::open(folder.path().to_owned(), 1000).unwrap();
        let (key, digest) = (Digest::of(b"key"), Digest::of(b"bytes"));
        assert!(cache.name(&key).is_none());
        cache.put_name(&key, &digest);
        assert_eq!(cache.name(&key), Some(digest));
        fs::write(folder.path().join("names").join(key.to_string()), "short").unwrap();
        assert!(cache.name(&key).is_none());
    }

    #[test]
    fn the_bound_holds_and_the_files_used_last_stay() {
        let folder = tempfile::tempdir().unwrap();
        let cache = DiskCache::open(folder.path().to_owned(), 1000).unwrap();
        let first = Digest::of(b"first");
        for number in 0..30u8 {
            let bytes = [number; 100];
            cache.put(&Digest::of(&bytes), &bytes);
            let used = SystemTime::now() - Duration::from_secs(1000 - u64::from(number));
            let path = cache.object(&Digest::of(&bytes));
            if let Ok(file) = fs::File::options().append(true).open(path) {
                file.set_modified(used).unwrap();
            }
            if number == 0 {
                cache.put(&first, b"first");
            }
            assert!(cache.get(&first).is_some(), "used each time");
        }
        assert!(
            bytes_in(folder.path()) <= 1000,
            "{}",
            bytes_in(folder.path())
        );
        assert!(cache.get(&Digest::of(&[29u8; 100])).is_some());
        assert!(cache.get(&Digest::of(&[0u8; 100])).is_none());
    }

    #[test]
    fn several_processes_may_share_it() {
        let folder = tempfile::tempdir().unwrap();
        std::thread::scope(|scope| {
            for worker in 0..4u8 {
                let folder = folder.path().to_owned();
                scope.spawn(move || {
                    let cache = DiskCache::open(folder, 2000).unwrap();
                    for number in 0..200u8 {
                        let bytes = [number.wrapping_mul(worker % 2 + 1); 100];
                        let digest = Digest::of(&bytes);
                        cache.put(&digest, &bytes);
                        if let Some(found) = cache.get(&digest) {
                            assert_eq!(found, bytes);
                        }
                    }
                });
            }
        });
        let cache = DiskCache::open(folder.path().to_owned(), 2000).unwrap();
        assert!(bytes_in(&cache.folder) <= 2000);
    }
}
