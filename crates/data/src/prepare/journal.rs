//! What has been made of each take, kept beside the phrases.

use serde::{Deserialize, Serialize};

use super::motion::bytes;
use super::plan::Plan;
use super::take::{Take, TakeReport};
use crate::manifest::ManifestRow;
use crate::{Digest, Error, Store, StoreError};

/// The longest journal: some hundred thousand phrases.
const MAX_BYTES: u64 = 64 << 20;

/// Changes when phrases of the same plan would come out otherwise.
const MAKER: &str = "kinegrad phrases 1";

/// What was made of a take.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Journal {
    /// What it was made of, see [`key`].
    pub key: Digest,
    pub rows: Vec<ManifestRow>,
    pub report: TakeReport,
}

/// A checksum of all that a take's phrases follow from: its plan and its files.
///
/// # Errors
/// A file that cannot be read, by name.
pub(super) fn key(plan: &Plan, take: &Take) -> Result<Digest, String> {
    let text = serde_json::to_string(&(take, &plan.phrases, &plan.joining)).expect("plain data");
    let mut parts = vec![MAKER.as_bytes().to_vec(), text.into_bytes()];
    let segments = take.plan.segments.iter();
    let mut files: Vec<_> = segments
        .map(|segment| plan.resolve(&segment.motion))
        .filter(|path| path.exists())
        .chain(take.motion.clone())
        .chain(take.audio.clone())
        .collect();
    files.sort_unstable();
    files.dedup();
    for file in files {
        parts.push(Digest::of(&bytes(&file)?).as_bytes().to_vec());
    }
    Ok(Digest::of_parts(parts.iter().map(Vec::as_slice)))
}

fn path(name: &str) -> String {
    format!("prepare/takes/{name}.json")
}

impl Journal {
    /// The journal of a take of which nothing could be made. It is not kept: the next preparation
    /// tries again.
    pub fn failed(take: &Take, problem: String) -> Self {
        Self {
            key: Digest::of(b""),
            rows: Vec::new(),
            report: TakeReport {
                name: take.name.clone(),
                failure: Some(problem),
                ..TakeReport::default()
            },
        }
    }

    /// What was made of the take `name`, if it was made of what `key` stands for.
    ///
    /// # Errors
    /// [`Error::Store`]; a journal that cannot be read is none.
    pub fn read(store: &Store, name: &str, key: Digest) -> Result<Option<Self>, Error> {
        match store.read(&path(name), MAX_BYTES) {
            Ok(bytes) => {
                let journal = serde_json::from_slice::<Self>(&bytes).ok();
                Ok(journal.filter(|journal| journal.key == key))
            }
            Err(StoreError::Missing { .. }) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// Keeps it.
    ///
    /// # Errors
    /// [`Error::Store`].
    pub fn write(&self, store: &Store) -> Result<(), Error> {
        let bytes = serde_json::to_vec_pretty(self).expect("plain data");
        Ok(store.write(&path(&self.report.name), bytes)?)
    }
}
