//! The dataset that a preparation writes.

use std::collections::{BTreeSet, HashMap};
use std::fs::{self, File, TryLockError};
use std::path::Path;
use std::sync::Mutex;
use std::time::UNIX_EPOCH;

use kinegrad_data::manifest;
use kinegrad_data::{Digest, Object, PREPARATION, Store, StoreError};
use serde::Serialize;

use crate::Error;
use crate::plan::Plan;

/// The lock file of a dataset in a local folder: one preparation at a time locks it.
const LOCK: &str = "prepare/lock";

/// The files of a dataset of one kind.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parts {
    /// Lists the files of its items.
    pub list: fn(&Store) -> Result<Vec<Object>, StoreError>,
    /// The id of the item that a file belongs to.
    pub id: fn(&str) -> Option<&str>,
    /// Files that list the dataset's items. They are written last.
    pub index: &'static [&'static str],
}

/// A dataset that is being written.
pub(crate) struct Output {
    pub store: Store,
    parts: Parts,
    /// The earlier files of items, with their lengths.
    present: HashMap<String, u64>,
    /// Identifies this preparation; written in place of the report until the end.
    mark: Vec<u8>,
    state: Mutex<WriteState>,
}

#[derive(Default)]
struct WriteState {
    /// True once a file has been written.
    written: bool,
    /// Locked until the end.
    lock: Option<File>,
}

/// Removes the files of interrupted writes, in the folder of the dataset and those in it.
fn remove_unfinished(store: &Store) -> Result<(), Error> {
    let Some(prepared) = store.place(LOCK)? else {
        return Ok(());
    };
    let Some(root) = prepared.parent().and_then(Path::parent) else {
        return Ok(());
    };
    kinegrad_output::remove_unfinished(root);
    Ok(())
}

impl Output {
    /// Opens the place that the plan names. [`Error::Data`] if the place contains a dataset of
    /// another origin or cannot be used, [`Error::Busy`] if another preparation is writing.
    pub fn open(plan: &Plan, parts: Parts) -> Result<Self, Error> {
        let folder = plan.resolve(&plan.output);
        let place = match (plan.output.contains("://"), folder.to_str()) {
            (true, _) => &plan.output,
            (false, Some(folder)) => folder,
            (false, None) => {
                return Err(Error::Plan {
                    file: folder.display().to_string(),
                    problem: "the path of the output folder is not UTF-8".into(),
                });
            }
        };
        let store = Store::open(place, &plan.store)?;
        if !store.is_writable() {
            return Err(StoreError::ReadOnly(store.uri()).into());
        }
        let files = (parts.list)(&store)?.into_iter();
        let present: HashMap<_, _> = files.map(|file| (file.path, file.bytes)).collect();
        refuse_foreign(&store, parts, present.is_empty())?;
        let now = UNIX_EPOCH.elapsed().unwrap_or_default().as_nanos();
        let text = format!("{now} {}", std::process::id());
        let mark = serde_json::json!({ "preparation": Digest::of(text.as_bytes()) });
        let mut state = WriteState::default();
        // An empty folder stays empty if nothing can be made.
        if store.place(LOCK)?.is_some_and(|lock| lock.exists()) {
            state.lock = lock(&store)?;
            remove_unfinished(&store)?;
        }
        Ok(Self {
            present,
            parts,
            mark: mark.to_string().into_bytes(),
            state: Mutex::new(state),
            store,
        })
    }

    /// True if a file has an unchanged checksum, or in a bucket an unchanged length.
    pub fn holds(&self, path: &str, bytes: i64, digest: Digest) -> bool {
        let as_long = self.present.get(path).copied() == u64::try_from(bytes).ok();
        let same = || {
            let read = self.store.read(path, bytes.unsigned_abs());
            read.is_ok_and(|bytes| Digest::of(&bytes) == digest)
        };
        as_long && (self.store.is_remote() || same())
    }

    /// Writes a file of the dataset. Before the first file, the outdated index is removed and this
    /// preparation's mark is written.
    pub fn write(&self, path: &str, bytes: Vec<u8>) -> Result<(), Error> {
        {
            let mut state = self.state.lock().expect("no thread panics");
            if !state.written {
                if state.lock.is_none() {
                    state.lock = lock(&self.store)?;
                }
                self.store.write(PREPARATION, self.mark.clone())?;
                for index in self.parts.index {
                    self.store.remove(index)?;
                }
                state.written = true;
            }
        }
        Ok(self.store.write(path, bytes)?)
    }

    /// Ends the preparation: writes the index with `write_index`, then the report, which is made from
    /// the number of stale items. With `prune`, the older files that are not in `made` are removed.
    /// [`Error::Busy`] if another preparation has started meanwhile.
    pub fn finish<R: Serialize>(
        &self,
        made: &BTreeSet<String>,
        prune: bool,
        report: impl FnOnce(usize) -> R,
        write_index: impl FnOnce(&Store) -> Result<(), Error>,
    ) -> Result<R, Error> {
        let stale = self.present.keys().filter(|path| !made.contains(*path));
        let stale: BTreeSet<&String> = stale.collect();
        let ids = stale.iter().filter_map(|path| (self.parts.id)(path));
        let left = ids.collect::<BTreeSet<&str>>().len();
        let report = report(if prune { 0 } else { left });
        let mut state = self.state.lock().expect("no thread panics");
        if state.lock.is_none() {
            state.lock = lock(&self.store)?;
        }
        // Buckets have no locks: the mark detects another preparation.
        if state.written && self.store.is_remote() {
            let found = self.store.read(PREPARATION, manifest::MAX_BYTES)?;
            if found != self.mark {
                return Err(busy(&self.store));
            }
        }
        write_index(&self.store)?;
        let text = serde_json::to_vec_pretty(&report).expect("plain data");
        self.store.write(PREPARATION, text)?;
        // Stale files are removed last, because the old index lists them.
        if prune {
            for path in stale {
                self.store.remove(path)?;
            }
        }
        Ok(report)
    }
}

fn busy(store: &Store) -> Error {
    Error::Busy {
        output: store.uri(),
    }
}

/// Locks a folder of this machine until this process ends.
fn lock(store: &Store) -> Result<Option<File>, Error> {
    let Some(path) = store.place(LOCK)? else {
        return Ok(None);
    };
    let io = kinegrad_data::Error::io;
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(|reason| io("create", folder, reason))?;
    }
    let file = kinegrad_output::lock(&path).map_err(|reason| io("create", &path, reason))?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Err(busy(store)),
        // The user must keep preparations apart where files cannot be locked.
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// Rejects a place that contains items of another origin.
fn refuse_foreign(store: &Store, parts: Parts, is_empty: bool) -> Result<(), Error> {
    let exists = |path| Ok::<_, Error>(store.find(path, manifest::MAX_BYTES)?.is_some());
    if exists(PREPARATION)? {
        return Ok(());
    }
    let mut foreign = !is_empty;
    for index in parts.index {
        foreign = foreign || exists(index)?;
    }
    if foreign {
        return Err(kinegrad_data::Error::Exists(store.uri().into()).into());
    }
    Ok(())
}
