//! The dataset that a preparation writes.

use std::collections::{BTreeSet, HashMap};
use std::fs::{self, File, TryLockError};
use std::sync::Mutex;
use std::time::UNIX_EPOCH;

use kinegrad_data::file::lock_file;
use kinegrad_data::manifest::{self, ManifestRow};
use kinegrad_data::{AUDIO_FILE, MANIFEST, MOTION_FILE, PREPARATION};
use kinegrad_data::{Digest, Store, StoreError, features_path, motion_path};

use super::Report;
use super::plan::Plan;
use crate::Error;

/// The file that one preparation at a time holds locked, in a folder of this machine.
const LOCK: &str = "prepare/lock";

/// A dataset on its way.
pub(super) struct Output {
    pub store: Store,
    /// The files of phrases that were there before, with their lengths.
    present: HashMap<String, u64>,
    /// What stands in place of the report until there is one, and tells this preparation from
    /// every other.
    mark: Vec<u8>,
    begun: Mutex<Begun>,
}

#[derive(Default)]
struct Begun {
    /// Whether anything has been written.
    written: bool,
    /// Held until the end.
    lock: Option<File>,
}

impl Output {
    /// The place that the plan names, with nothing written yet.
    ///
    /// # Errors
    /// [`Error::Data`] if it holds a dataset that no preparation wrote or cannot be used,
    /// [`Error::Busy`] if another one is writing.
    pub fn open(plan: &Plan) -> Result<Self, Error> {
        let place = match plan.output.contains("://") {
            true => plan.output.clone(),
            false => plan.resolve(&plan.output).display().to_string(),
        };
        let store = Store::open(&place, &plan.store)?;
        if !store.is_writable() {
            return Err(StoreError::ReadOnly { uri: store.uri() }.into());
        }
        refuse_foreign(&store)?;
        let mut begun = Begun::default();
        // Where there is nothing yet, nothing is left behind if nothing can be made.
        if store.place(LOCK)?.is_some_and(|lock| lock.exists()) {
            begun.lock = lock(&store)?;
        }
        Ok(Self {
            present: present(&store)?,
            mark: mark(),
            begun: Mutex::new(begun),
            store,
        })
    }

    /// Whether both files of a phrase are there as they were written. Those of a bucket are known
    /// by their lengths alone.
    pub fn holds(&self, row: &ManifestRow) -> bool {
        let (motion, audio) = (motion_path(&row.id), features_path(&row.id));
        let files = [
            (motion, row.motion_bytes, row.motion_sha256),
            (audio, row.audio_bytes, row.audio_sha256),
        ];
        files.iter().all(|(path, bytes, digest)| {
            let as_long = self.present.get(path).copied() == u64::try_from(*bytes).ok();
            let same = || {
                let read = self.store.read(path, bytes.unsigned_abs());
                read.is_ok_and(|bytes| Digest::of(&bytes) == *digest)
            };
            as_long && (self.store.is_remote() || same())
        })
    }

    /// Writes a file of the dataset. Before the first, the manifest goes, which would no longer
    /// tell the truth, and the preparation's mark is left.
    ///
    /// # Errors
    /// [`Error::Busy`], [`Error::Data`].
    pub fn write(&self, path: &str, bytes: Vec<u8>) -> Result<(), Error> {
        {
            let mut begun = self.begun.lock().expect("no thread panics holding it");
            if !begun.written {
                if begun.lock.is_none() {
                    begun.lock = lock(&self.store)?;
                }
                self.store.write(PREPARATION, self.mark.clone())?;
                self.store.remove(MANIFEST)?;
                begun.written = true;
            }
        }
        Ok(self.store.write(path, bytes)?)
    }

    /// The ids of phrases that were there before and are not among `rows`.
    pub fn stale(&self, rows: &[ManifestRow]) -> BTreeSet<String> {
        let made: BTreeSet<&str> = rows.iter().map(|row| row.id.as_str()).collect();
        let ids = self.present.keys().filter_map(|path| {
            let (folder, _) = path.rsplit_once('/')?;
            folder.rsplit_once('/').map(|(_, id)| id)
        });
        ids.filter(|id| !made.contains(id))
            .map(str::to_owned)
            .collect()
    }

    /// Removes the files of phrases.
    ///
    /// # Errors
    /// [`Error::Data`].
    pub fn prune(&self, ids: &BTreeSet<String>) -> Result<(), Error> {
        for id in ids {
            self.store.remove(&motion_path(id))?;
            self.store.remove(&features_path(id))?;
        }
        Ok(())
    }

    /// Writes the manifest and the report, which end the preparation.
    ///
    /// # Errors
    /// [`Error::Busy`] if another preparation has begun meanwhile, [`Error::Data`].
    pub fn finish(&self, rows: Vec<ManifestRow>, report: &Report) -> Result<(), Error> {
        let mut begun = self.begun.lock().expect("no thread panics holding it");
        if begun.lock.is_none() {
            begun.lock = lock(&self.store)?;
        }
        // Buckets have no locks: the mark tells whether somebody else came between.
        if begun.written && self.store.is_remote() {
            let found = self.store.read(PREPARATION, manifest::MAX_BYTES)?;
            if found != self.mark {
                return Err(busy(&self.store));
            }
        }
        manifest::write(&self.store, rows)?;
        let text = serde_json::to_vec_pretty(report).expect("plain data");
        Ok(self.store.write(PREPARATION, text)?)
    }
}

/// See [`Output::mark`].
fn mark() -> Vec<u8> {
    let now = UNIX_EPOCH.elapsed().unwrap_or_default().as_nanos();
    let text = format!("{now} {}", std::process::id());
    let mark = serde_json::json!({ "preparation": Digest::of(text.as_bytes()) });
    mark.to_string().into_bytes()
}

fn busy(store: &Store) -> Error {
    Error::Busy {
        output: store.uri(),
    }
}

/// Takes the lock of a folder of this machine, which ends with this process.
fn lock(store: &Store) -> Result<Option<File>, Error> {
    let Some(path) = store.place(LOCK)? else {
        return Ok(None);
    };
    let io = kinegrad_data::Error::io;
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(|reason| io("create", folder, reason))?;
    }
    let file = lock_file(&path).map_err(|reason| io("create", &path, reason))?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Err(busy(store)),
        // Where files cannot be locked, whoever runs two preparations keeps them apart.
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// The files of phrases, with their lengths.
fn present(store: &Store) -> Result<HashMap<String, u64>, Error> {
    let mut files = HashMap::new();
    for (folder, file) in [MOTION_FILE, AUDIO_FILE] {
        match store.list(folder, file) {
            Ok(objects) => files.extend(objects.into_iter().map(|o| (o.path, o.bytes))),
            Err(StoreError::Missing { .. }) => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(files)
}

/// Rejects to write among the phrases of somebody else.
fn refuse_foreign(store: &Store) -> Result<(), Error> {
    let there = |path| {
        store
            .find(path, manifest::MAX_BYTES)
            .map(|found| found.is_some())
    };
    if there(PREPARATION)? {
        return Ok(());
    }
    if there(MANIFEST)? || !present(store)?.is_empty() {
        let path = store.uri().into();
        return Err(kinegrad_data::Error::Exists { path }.into());
    }
    Ok(())
}
