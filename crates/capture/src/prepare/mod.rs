//! `kinegrad data prepare`: from captures and songs to a dataset of phrases.
//!
//! A plan lists takes; each is converted to phrases in the dataset layout, and the manifest is
//! written last. Finished takes are recorded in `prepare/TAKE.json` next to the phrases, so that an
//! interrupted preparation continues with the remaining takes, and takes whose plan and files have
//! not changed are not processed again.

mod choreonet;
mod grid;
pub(crate) mod journal;
mod lay;
pub(crate) mod motion;
pub(crate) mod output;
mod plan;
mod report;
pub(crate) mod resolve;
mod song;
mod span;
mod split;
mod take;
mod units;

use std::cell::OnceCell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use kinegrad_data::manifest::{self, Flag, ManifestRow};
use kinegrad_data::{
    AUDIO_FILE, MANIFEST, MOTION_FILE, Object, Store, StoreError, features_path, matches,
    motion_path,
};
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::Serialize;

pub use grid::{Grid, GridReport};
pub use plan::Plan;
pub(crate) use plan::{LEAST_FPS, SMALLEST_UNIT, SplitPlan, check_end, check_name, check_number};
pub use report::{Rejection, TakeReport};
pub use units::Units;

use crate::Error;
use output::{Output, Parts};
use resolve::Take;
use song::Song;

/// What was made of a take.
type Journal = journal::Journal<ManifestRow, TakeReport>;

/// The files of a dataset of phrases.
const PHRASES: Parts = Parts {
    list: phrase_files,
    index: &[MANIFEST],
};

/// What became of a plan.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Where the dataset is.
    pub output: String,
    /// Phrases in it.
    pub phrases: usize,
    /// Their length in hours.
    pub hours: f64,
    /// Takes that had been made before.
    pub kept: usize,
    /// Phrases that lie there and belong to no take of the plan, and so not to the dataset.
    pub stale: usize,
    /// Entries of `split.validation` that match no phrase.
    pub idle_entries: Vec<String>,
    /// Songs held out whole, where the plan names no phrase; a take without a song by its name.
    pub held_out_songs: Vec<String>,
    /// What there is to say of the split.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub split_note: Option<String>,
    /// Each take, by name.
    pub takes: Vec<TakeReport>,
}

/// What to do beyond what is left to do.
#[derive(Clone, Copy, Debug, Default)]
pub struct PrepareOptions {
    /// Make every take again.
    pub again: bool,
    /// Remove the phrases that belong to no take of the plan.
    pub prune: bool,
}

/// How far a preparation is, and whether it should go on. Called from several threads.
pub trait PrepareObserver: Sync {
    /// So many of so many takes are done.
    fn done(&self, takes: usize, total: usize);
    /// Whether to stop after the takes under way.
    fn stop_requested(&self) -> bool;
}

/// Makes the dataset of `plan`. `None` if it was stopped: the takes done are kept, and the next
/// preparation goes on from there.
///
/// # Errors
/// [`Error::Plan`] for files that are not there, [`Error::Busy`] if another preparation is writing
/// to the output, [`Error::Data`] if that holds a dataset that no preparation wrote or cannot be
/// written. A take that cannot be used is no error: its report says why.
pub fn prepare(
    plan: &Plan,
    plan_file: &Path,
    options: PrepareOptions,
    observer: &dyn PrepareObserver,
) -> Result<Option<Report>, Error> {
    if !manifest::SUPPORTED {
        let what = "`kinegrad data prepare`".to_owned();
        let feature = "manifest";
        return Err(kinegrad_data::Error::Feature { what, feature }.into());
    }
    let takes = takes(plan, plan_file)?;
    let output = Output::open(plan, PHRASES)?;
    // Threads that wait for a network are not bound to the number of cores.
    let uploads = ThreadPoolBuilder::new().num_threads(plan.store.concurrency);
    let uploads = output.store.is_remote().then(|| uploads.build().ok());
    let uploads = uploads.flatten();
    let (total, done) = (takes.len(), AtomicUsize::new(0));
    observer.done(0, total);
    // Takes of one song one after the other, so that it is read once and held by one thread.
    let journals: Vec<Option<Vec<Journal>>> = by_song(&takes)
        .par_iter()
        .map(|takes| {
            let song = OnceCell::new();
            let mut journals = Vec::with_capacity(takes.len());
            for take in takes {
                if observer.stop_requested() {
                    return Ok(None);
                }
                let made = one(plan, take, options, &output, &song, uploads.as_ref())?;
                journals.push(made);
                observer.done(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            }
            Ok(Some(journals))
        })
        .collect::<Result<_, Error>>()?;
    let Some(journals) = journals.into_iter().collect::<Option<Vec<_>>>() else {
        return Ok(None);
    };
    let mut journals: Vec<Journal> = journals.into_iter().flatten().collect();
    journals.sort_by(|a, b| a.report.name.cmp(&b.report.name));
    let kept = journals.iter().filter(|journal| journal.kept).count();
    let any = journals.iter().any(|journal| !journal.rows.is_empty());
    let (mut rows, mut reports) = (Vec::new(), Vec::new());
    for journal in journals {
        if any && !journal.kept && journal.rows.is_empty() && journal.report.failure.is_none() {
            journal.write(&journal.report.name, &output)?;
        }
        rows.extend(journal.rows);
        reports.push(journal.report);
    }
    if rows.is_empty() {
        let problem = format!("no take produced a phrase{}", reasons(&reports));
        return Err(Error::plan(plan_file, problem));
    }
    let divided = plan.split.divide(&mut rows);
    let files = |row: &ManifestRow| [motion_path(&row.id), features_path(&row.id)];
    let stale = output.stale(&rows.iter().flat_map(files).collect());
    let ids: BTreeSet<&str> = stale.iter().filter_map(|path| id(path)).collect();
    let frames: i64 = rows.iter().map(|row| row.frames).sum();
    let report = Report {
        output: output.store.uri(),
        phrases: rows.len(),
        hours: frames as f64 / kinegrad_motion::FPS / 3600.0,
        kept,
        stale: if options.prune { 0 } else { ids.len() },
        idle_entries: idle_entries(plan, &rows),
        held_out_songs: divided.held_out,
        split_note: divided.note,
        takes: reports,
    };
    output.finish(&report, |store| Ok(manifest::write(store, rows)?))?;
    // Not before the manifest has let go of them.
    if options.prune {
        output.prune(&stale)?;
    }
    Ok(Some(report))
}

/// The files of phrases in `store`.
fn phrase_files(store: &Store) -> Result<Vec<Object>, StoreError> {
    let mut files = Vec::new();
    for (folder, file) in [MOTION_FILE, AUDIO_FILE] {
        match store.list(folder, file) {
            Ok(objects) => files.extend(objects),
            Err(StoreError::Missing { .. }) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(files)
}

/// The id of the phrase that a file belongs to.
fn id(path: &str) -> Option<&str> {
    let (folder, _) = path.rsplit_once('/')?;
    folder.rsplit_once('/').map(|(_, id)| id)
}

/// Whether both files of a phrase are there as they were written.
fn is_whole(row: &ManifestRow, output: &Output) -> bool {
    let (motion, audio) = (motion_path(&row.id), features_path(&row.id));
    output.holds(&motion, row.motion_bytes, row.motion_sha256)
        && output.holds(&audio, row.audio_bytes, row.audio_sha256)
}

/// The report of a take of which nothing could be made.
fn failure(take: &Take, problem: String) -> TakeReport {
    TakeReport {
        name: take.name.clone(),
        failure: Some(problem),
        ..TakeReport::default()
    }
}

/// Why the first takes gave nothing.
fn reasons(reports: &[TakeReport]) -> String {
    const SHOWN: usize = 5;
    let reason = |report: &TakeReport| {
        let rejected = report.rejected.first();
        let rejected = rejected.map(|rejection| rejection.reason.clone());
        let reason = report.failure.clone().or(rejected).unwrap_or_default();
        format!("; {}: {reason}", report.name)
    };
    let mut text: String = reports.iter().take(SHOWN).map(reason).collect();
    if reports.len() > SHOWN {
        text += &format!("; and {} more", reports.len() - SHOWN);
    }
    text
}

/// Entries of the plan's split that match no phrase.
fn idle_entries(plan: &Plan, rows: &[ManifestRow]) -> Vec<String> {
    let entries = plan.split.validation.iter();
    let idle = entries.filter(|entry| !rows.iter().any(|row| matches(entry, &row.id)));
    idle.cloned().collect()
}

/// All takes of a plan.
fn takes(plan: &Plan, plan_file: &Path) -> Result<Vec<Take>, Error> {
    let mut wanted = plan.takes.clone();
    for choreonet in &plan.choreonet {
        wanted.extend(choreonet::takes(plan, choreonet)?);
    }
    resolve::resolve(plan, wanted).map_err(|problem| Error::plan(plan_file, problem))
}

/// The takes in groups with the same song; each take without one is a group of its own.
fn by_song(takes: &[Take]) -> Vec<Vec<&Take>> {
    let (mut groups, mut songs) = (Vec::new(), BTreeMap::<&Path, Vec<&Take>>::new());
    for take in takes {
        match take.audio.as_deref() {
            Some(song) => songs.entry(song).or_default().push(take),
            None => groups.push(vec![take]),
        }
    }
    groups.extend(songs.into_values());
    groups
}

/// What has been made of a take before, or is now.
fn one(
    plan: &Plan,
    take: &Take,
    options: PrepareOptions,
    output: &Output,
    song: &OnceCell<Result<Song, String>>,
    uploads: Option<&ThreadPool>,
) -> Result<Journal, Error> {
    let key = match journal::key(plan, take) {
        Ok(key) => key,
        Err(problem) => return Ok(Journal::failed(failure(take, problem))),
    };
    if !options.again
        && let Some(journal) = Journal::read(&output.store, &take.name, key)?
        && journal.rows.iter().all(|row| is_whole(row, output))
    {
        return Ok(journal);
    }
    let ready = match take.ready(plan, song) {
        Ok(ready) => ready,
        Err(problem) => return Ok(Journal::failed(failure(take, problem))),
    };
    // One phrase after the other, so that a long take need not fit into memory.
    let make = |index| {
        let written = ready.phrase(index).map(|made| {
            output.write(&motion_path(&made.row.id), made.motion)?;
            output.write(&features_path(&made.row.id), made.audio)?;
            Ok(made.row)
        });
        // A rejection is an answer; what cannot be written is an error.
        written.map_or_else(|rejection| Ok(Err(rejection)), |row| row.map(Ok))
    };
    let all = 0..ready.phrases();
    let made: Vec<Result<ManifestRow, Rejection>> = match uploads {
        Some(uploads) => uploads.install(|| all.into_par_iter().map(make).collect()),
        None => all.map(make).collect::<Result<_, Error>>(),
    }?;
    let (mut rows, mut unmade) = (Vec::new(), Vec::new());
    for phrase in made {
        match phrase {
            Ok(row) => rows.push(row),
            Err(rejection) => unmade.push(rejection),
        }
    }
    let failing = |row: &&ManifestRow| row.flags.contains(&Flag::FailsDocumentChecks);
    let failing = rows.iter().filter(failing).count();
    let report = ready.report(unmade, failing);
    let journal = Journal {
        key,
        rows,
        report,
        kept: false,
    };
    // If no take produced a phrase, nothing is left behind.
    if !journal.rows.is_empty() {
        journal.write(&journal.report.name, output)?;
    }
    Ok(journal)
}
