//! The driver makes changed takes again, several at a time.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use kinegrad_data::Digest;
use rayon::prelude::*;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::journal::Journal;
use super::output::Output;
use crate::Error;

/// Options of a preparation.
#[derive(Clone, Copy, Debug, Default)]
pub struct PrepareOptions {
    /// Make every take again.
    pub again: bool,
    /// Remove the items that belong to no take of the plan.
    pub prune: bool,
}

/// Progress of a preparation, and requests to stop it. The methods are called from several threads.
pub trait PrepareObserver: Sync {
    /// Reports that `takes` of `total` takes are done.
    fn done(&self, takes: usize, total: usize);
    /// Returns true to stop after the takes under way.
    fn stop_requested(&self) -> bool;
}

/// Frames of a take in no phrase or clip.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Rejection {
    /// First frame on the take's timeline.
    pub first_frame: usize,
    /// Number of frames.
    pub frames: usize,
    /// The reason.
    pub reason: String,
}

/// An item of a dataset, as the journal of its take lists it.
pub(crate) trait Row: DeserializeOwned + Serialize + Send {
    /// Path, length and checksum of each of its files.
    fn files(&self) -> [(String, i64, Digest); 2];
}

pub(crate) trait Report: DeserializeOwned + Serialize + Send {
    /// The report of the take `name`, which cannot be used.
    fn failed(name: &str, problem: String) -> Self;
    /// The reason if the take cannot be used, and the frames in no item.
    fn problems(&self) -> (Option<&str>, &[Rejection]);
}

/// A maker of the items of one kind of dataset.
pub(crate) trait Maker: Sync {
    /// The kind of item, for messages.
    const ITEM: &'static str;
    type Take: Sync;
    /// Data that is read before the decision to make the take again.
    type Input;
    /// Data that the takes of a group share.
    type Shared: Default;
    type Row: Row;
    type Report: Report;

    fn name<'a>(&self, take: &'a Self::Take) -> &'a str;

    /// Reads a take's inputs, with a checksum of the inputs and the take's part of the plan. An
    /// error is the reason why the take cannot be used.
    fn read(&self, take: &Self::Take) -> Result<(Digest, Self::Input), String>;

    /// Writes the items of a take. The report of an unusable take contains the reason.
    fn make(
        &self,
        take: &Self::Take,
        input: Self::Input,
        shared: &Self::Shared,
        output: &Output,
    ) -> Result<(Vec<Self::Row>, Self::Report), Error>;
}

/// The journals of a maker's takes.
pub(crate) type Journals<M> = Vec<Journal<<M as Maker>::Row, <M as Maker>::Report>>;

/// Makes the takes that have changed and returns all journals, sorted by name. One thread makes the
/// takes of a group, one after the other. `None` if the observer stopped the preparation.
/// [`Error::Plan`] if no take gave an item.
pub(crate) fn make_takes<M: Maker>(
    maker: &M,
    groups: &[Vec<&M::Take>],
    plan_file: &Path,
    output: &Output,
    options: PrepareOptions,
    observer: &dyn PrepareObserver,
) -> Result<Option<Journals<M>>, Error> {
    let (total, done) = (groups.iter().map(Vec::len).sum(), AtomicUsize::new(0));
    observer.done(0, total);
    let of_group = |takes: &Vec<&M::Take>| {
        let shared = M::Shared::default();
        let mut journals = Vec::with_capacity(takes.len());
        for take in takes {
            if observer.stop_requested() {
                return Ok(None);
            }
            journals.push(one(maker, take, &shared, output, options)?);
            observer.done(done.fetch_add(1, Ordering::Relaxed) + 1, total);
        }
        Ok(Some(journals))
    };
    let groups = groups.par_iter().map(of_group);
    let Some(groups) = groups.collect::<Result<Option<Vec<_>>, Error>>()? else {
        return Ok(None);
    };
    let mut journals: Journals<M> = groups.into_iter().flatten().collect();
    journals.sort_by(|a, b| a.name.cmp(&b.name));
    if journals.iter().all(|journal| journal.rows.is_empty()) {
        let problem = format!("no take gave a {}{}", M::ITEM, reasons::<M>(&journals));
        return Err(Error::plan(plan_file, problem));
    }
    // Takes without items are recorded once there is a dataset.
    for journal in journals.iter().filter(|journal| !journal.reused) {
        if journal.rows.is_empty() && journal.report.problems().0.is_none() {
            journal.write(output)?;
        }
    }
    Ok(Some(journals))
}

/// The journal of a take: the stored one if nothing has changed.
fn one<M: Maker>(
    maker: &M,
    take: &M::Take,
    shared: &M::Shared,
    output: &Output,
    options: PrepareOptions,
) -> Result<Journal<M::Row, M::Report>, Error> {
    let name = maker.name(take);
    let journal = |key, rows, report| Journal {
        name: name.to_owned(),
        key,
        rows,
        report,
        reused: false,
    };
    let (key, input) = match maker.read(take) {
        Ok(read) => read,
        Err(problem) => {
            let report = M::Report::failed(name, problem);
            return Ok(journal(Digest::of(b""), Vec::new(), report));
        }
    };
    if !options.again
        && let Some(journal) = Journal::<M::Row, M::Report>::read(&output.store, name, key)?
    {
        let mut files = journal.rows.iter().flat_map(Row::files);
        if files.all(|(path, bytes, digest)| output.holds(&path, bytes, digest)) {
            return Ok(journal);
        }
    }
    let (rows, report) = maker.make(take, input, shared, output)?;
    let journal = journal(key, rows, report);
    // A take that cannot be used is tried again by the next preparation.
    if !journal.rows.is_empty() {
        journal.write(output)?;
    }
    Ok(journal)
}

/// The reasons why the first takes gave nothing.
fn reasons<M: Maker>(journals: &[Journal<M::Row, M::Report>]) -> String {
    const SHOWN: usize = 5;
    let reason = |journal: &Journal<M::Row, M::Report>| {
        let (failure, rejected) = journal.report.problems();
        let rejected = rejected.first().map(|rejection| rejection.reason.as_str());
        let reason = failure.or(rejected).unwrap_or_default();
        format!("; {}: {reason}", journal.name)
    };
    let mut text: String = journals.iter().take(SHOWN).map(reason).collect();
    if journals.len() > SHOWN {
        text += &format!("; and {} more", journals.len() - SHOWN);
    }
    text
}
