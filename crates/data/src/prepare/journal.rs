//! What has been made of each take, kept beside the phrases.

use serde::{Deserialize, Serialize};

use super::motion::bytes;
use super::output::Output;
use super::plan::Plan;
use super::report::TakeReport;
use super::resolve::Take;
use crate::manifest::ManifestRow;
use crate::{Digest, Error, Store, StoreError};

/// The longest journal: some hundred thousand phrases.
const MAX_BYTES: u64 = 64 << 20;

/// Changes when phrases of the same plan would come out otherwise.
const MAKER: &str = "kinegrad phrases 3";

/// What was made of a take.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Journal {
    /// What it was made of, see [`key`].
    pub key: Digest,
    pub rows: Vec<ManifestRow>,
    pub report: TakeReport,
}

/// A checksum of all that a take's phrases follow from: its plan and its files, wherever the plan
/// is run from.
///
/// # Errors
/// A file that cannot be read, by name.
pub(super) fn key(plan: &Plan, take: &Take) -> Result<Digest, String> {
    let wanted = (&take.name, &take.plan, &plan.phrases, &plan.joining);
    let text = serde_json::to_string(&wanted).expect("plain data");
    let mut parts = vec![MAKER.as_bytes().to_vec(), text.into_bytes()];
    let mut names: Vec<&str> = take
        .plan
        .segments
        .iter()
        .map(|s| s.motion.as_str())
        .collect();
    names.sort_unstable();
    names.dedup();
    let whole = take.motion.iter().chain(&take.audio);
    let whole = whole.map(|path| ("", path.clone()));
    let segments = names.into_iter().map(|name| (name, plan.resolve(name)));
    // A segment whose file is missing is a gap.
    for (name, file) in segments.filter(|(_, path)| path.exists()).chain(whole) {
        parts.push(name.as_bytes().to_vec());
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
    /// As [`Output::write`].
    pub fn write(&self, output: &Output) -> Result<(), Error> {
        let bytes = serde_json::to_vec_pretty(self).expect("plain data");
        output.write(&path(&self.report.name), bytes)
    }
}
