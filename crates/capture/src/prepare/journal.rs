//! The record of a finished take, stored with its items.

use kinegrad_data::{Digest, Store};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::output::Output;
use crate::Error;

/// Bytes of the longest journal: some hundred thousand items.
const MAX_BYTES: u64 = 64 << 20;

/// A finished take: a row for each item, and its report.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct Journal<Row, Report> {
    /// Name of the take.
    #[serde(skip)]
    pub name: String,
    /// A checksum of the take's files and its part of the plan.
    pub key: Digest,
    pub rows: Vec<Row>,
    pub report: Report,
    /// True if an earlier preparation wrote the journal.
    #[serde(skip)]
    pub reused: bool,
}

fn path(name: &str) -> String {
    format!("prepare/takes/{name}.json")
}

impl<Row: DeserializeOwned, Report: DeserializeOwned> Journal<Row, Report> {
    /// The journal of the take `name`, if it is readable and has this `key`.
    pub fn read(store: &Store, name: &str, key: Digest) -> Result<Option<Self>, Error> {
        let bytes = store.find(&path(name), MAX_BYTES)?;
        let journal = bytes.and_then(|bytes| serde_json::from_slice::<Self>(&bytes).ok());
        let journal = journal.filter(|journal| journal.key == key);
        Ok(journal.map(|journal| Self {
            name: name.to_owned(),
            reused: true,
            ..journal
        }))
    }
}

impl<Row: Serialize, Report: Serialize> Journal<Row, Report> {
    /// Writes the journal.
    pub fn write(&self, output: &Output) -> Result<(), Error> {
        let bytes = serde_json::to_vec_pretty(self).expect("plain data");
        output.write(&path(&self.name), bytes)
    }
}
