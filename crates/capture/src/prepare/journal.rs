//! The record of finished takes, stored with the phrases.

use std::collections::BTreeSet;

use kinegrad_data::{Digest, Store};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::motion::bytes;
use super::output::Output;
use super::plan::Plan;
use super::resolve::Take;
use crate::Error;

/// The longest journal: some hundred thousand phrases.
const MAX_BYTES: u64 = 64 << 20;

/// Changes when phrases of the same plan would come out otherwise.
const MAKER: &str = "kinegrad phrases 4";

/// What was made of a take: a row for each item, and what there is to say of it.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct Journal<Row, Report> {
    /// What it was made of, see [`key`].
    pub key: Digest,
    pub rows: Vec<Row>,
    pub report: Report,
    /// Whether it was made before.
    #[serde(skip)]
    pub kept: bool,
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
    let segments = take.plan.segments.iter();
    let names: BTreeSet<&str> = segments.map(|segment| segment.motion.as_str()).collect();
    let segments = names.into_iter().map(|name| (name, plan.resolve(name)));
    let whole = take.motion.iter().chain(&take.audio);
    let whole = whole.map(|path| ("", path.clone()));
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

impl<Row, Report> Journal<Row, Report> {
    /// The journal of a take of which nothing could be made. It is not kept: the next preparation
    /// tries again.
    pub fn failed(report: Report) -> Self {
        Self {
            key: Digest::of(b""),
            rows: Vec::new(),
            report,
            kept: false,
        }
    }
}

impl<Row: DeserializeOwned, Report: DeserializeOwned> Journal<Row, Report> {
    /// What was made of the take `name`, if it was made of what `key` stands for.
    ///
    /// # Errors
    /// [`Error::Data`]; a journal that cannot be read is none.
    pub fn read(store: &Store, name: &str, key: Digest) -> Result<Option<Self>, Error> {
        let bytes = store.find(&path(name), MAX_BYTES)?;
        let journal = bytes.and_then(|bytes| serde_json::from_slice::<Self>(&bytes).ok());
        let journal = journal.filter(|journal| journal.key == key);
        Ok(journal.map(|journal| Self {
            kept: true,
            ..journal
        }))
    }
}

impl<Row: Serialize, Report: Serialize> Journal<Row, Report> {
    /// Keeps it as that of the take `name`.
    ///
    /// # Errors
    /// As [`Output::write`].
    pub fn write(&self, name: &str, output: &Output) -> Result<(), Error> {
        let bytes = serde_json::to_vec_pretty(self).expect("plain data");
        output.write(&path(name), bytes)
    }
}
