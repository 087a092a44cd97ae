//! `kinegrad data prepare`: from captures and songs to a dataset of phrases.
//!
//! A plan names takes; each becomes phrases in the layout of the dataset, and all together a
//! manifest, written last. What has been made of a take is noted in `prepare/TAKE.json` beside the
//! phrases, so that an interrupted preparation goes on with the takes that are left, and a take
//! whose plan and files have not changed is not made again.

mod choreonet;
mod journal;
mod motion;
mod plan;
mod song;
mod take;

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::Serialize;

pub use plan::Plan;
pub use take::{Rejection, TakeReport};

use crate::layout::{AUDIO, MOTION, PREPARATION as REPORT};
use crate::manifest::{self, Manifest, ManifestRow};
use crate::split::matches;
use crate::{
    Digest, Error, MANIFEST, Side, Store, StoreError, features_path, motion_path, npy, npz,
};
use journal::Journal;
use song::LazySong;
use take::{Made, Take};

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
    /// Each take, by name.
    pub takes: Vec<TakeReport>,
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
/// [`Error::Plan`] for files that are not there, [`Error::Exists`] if the output holds a dataset
/// that no preparation wrote, [`Error::Feature`], [`Error::Store`]. A take that cannot be used is
/// no error: its report says why.
pub fn prepare(
    plan: &Plan,
    plan_file: &Path,
    observer: &dyn PrepareObserver,
) -> Result<Option<Report>, Error> {
    if !manifest::SUPPORTED {
        return Err(Error::Feature {
            what: "`kinegrad data prepare`".to_owned(),
            feature: "manifest",
        });
    }
    let output = match plan.output.contains("://") {
        true => plan.output.clone(),
        false => plan.resolve(&plan.output).display().to_string(),
    };
    let store = Store::open(&output, &plan.store)?;
    if !store.is_writable() {
        return Err(StoreError::ReadOnly { uri: store.uri() }.into());
    }
    let takes = takes(plan, plan_file)?;
    refuse_foreign(&store)?;
    let present = Present::of(&store)?;
    // Threads that wait for a network are not bound to the number of cores.
    let uploads = ThreadPoolBuilder::new().num_threads(plan.store.concurrency);
    let uploads = store.is_remote().then(|| uploads.build().ok()).flatten();
    let (total, done) = (takes.len(), AtomicUsize::new(0));
    observer.done(0, total);
    // Takes of one song one after the other, so that it is read once and held by one thread.
    let journals: Vec<Option<Vec<(Journal, bool)>>> = by_song(&takes)
        .par_iter()
        .map(|takes| {
            let song = takes[0].audio.as_deref().map(LazySong::new);
            let mut journals = Vec::with_capacity(takes.len());
            for take in takes {
                if observer.stop_requested() {
                    return Ok(None);
                }
                journals.push(one(
                    plan,
                    take,
                    &store,
                    song.as_ref(),
                    &present,
                    uploads.as_ref(),
                )?);
                observer.done(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            }
            Ok(Some(journals))
        })
        .collect::<Result<_, Error>>()?;
    let Some(journals) = journals.into_iter().collect::<Option<Vec<_>>>() else {
        return Ok(None);
    };
    let mut journals: Vec<(Journal, bool)> = journals.into_iter().flatten().collect();
    journals.sort_by(|(a, _), (b, _)| a.report.name.cmp(&b.report.name));
    let kept = journals.iter().filter(|(_, kept)| *kept).count();
    let mut rows = Vec::new();
    let mut reports = Vec::new();
    for (journal, _) in journals {
        rows.extend(journal.rows);
        reports.push(journal.report);
    }
    if rows.is_empty() {
        let first = reports.iter().find_map(|report| {
            let reason = report.rejected.first().map(|rejection| &rejection.reason);
            report.failure.as_ref().or(reason)
        });
        let first = first.map_or("there is no take", String::as_str);
        return Err(Error::Plan {
            file: plan_file.display().to_string(),
            problem: format!("no phrase could be made of any take; the first: {first}"),
        });
    }
    for row in &mut rows {
        row.split = side(plan, &row.id);
    }
    let frames: i64 = rows.iter().map(|row| row.frames).sum();
    let report = Report {
        output: store.uri(),
        phrases: rows.len(),
        hours: frames as f64 / kinegrad_motion::FPS / 3600.0,
        kept,
        takes: reports,
    };
    Manifest::write(&store, rows)?;
    let text = serde_json::to_vec_pretty(&report).expect("plain data");
    store.write(REPORT, text)?;
    Ok(Some(report))
}

/// All takes of a plan.
fn takes(plan: &Plan, plan_file: &Path) -> Result<Vec<Take>, Error> {
    let mut wanted = plan.takes.clone();
    for choreonet in &plan.choreonet {
        wanted.extend(choreonet::takes(plan, choreonet)?);
    }
    take::resolve(plan, wanted).map_err(|problem| Error::Plan {
        file: plan_file.display().to_string(),
        problem,
    })
}

/// The takes in groups with the same song; each take without one is a group of its own.
fn by_song(takes: &[Take]) -> Vec<Vec<&Take>> {
    let mut groups: Vec<Vec<&Take>> = Vec::new();
    let mut places: HashMap<&Path, usize> = HashMap::new();
    for take in takes {
        match take.audio.as_deref().map(|song| places.entry(song)) {
            Some(Entry::Occupied(place)) => groups[*place.get()].push(take),
            Some(Entry::Vacant(place)) => {
                place.insert(groups.len());
                groups.push(vec![take]);
            }
            None => groups.push(vec![take]),
        }
    }
    groups
}

/// The files of phrases that the output has, with their lengths.
struct Present(HashMap<String, u64>);

impl Present {
    fn of(store: &Store) -> Result<Self, Error> {
        let mut files = HashMap::new();
        for (folder, file) in [MOTION, AUDIO] {
            match store.list(folder, file) {
                Ok(objects) => files.extend(objects.into_iter().map(|o| (o.path, o.bytes))),
                Err(StoreError::Missing { .. }) => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(Self(files))
    }

    /// Whether both files of a phrase are there, as long as they were written.
    fn holds(&self, row: &ManifestRow) -> bool {
        let as_long = |path: String, bytes: i64| {
            self.0
                .get(&path)
                .is_some_and(|&found| found as i64 == bytes)
        };
        as_long(motion_path(&row.id), row.motion_bytes)
            && as_long(features_path(&row.id), row.audio_bytes)
    }
}

/// Refuses to write among the phrases of somebody else, and leaves a mark where it begins.
fn refuse_foreign(store: &Store) -> Result<(), Error> {
    let there = |path: &str| match store.read(path, manifest::MAX_BYTES) {
        Ok(_) => Ok(true),
        Err(StoreError::Missing { .. }) => Ok(false),
        Err(error) => Err(Error::Store(error)),
    };
    if there(REPORT)? {
        return Ok(());
    }
    let holds = |(folder, file): (&str, &str)| match store.list(folder, file) {
        Ok(objects) => Ok(!objects.is_empty()),
        Err(StoreError::Missing { .. }) => Ok(false),
        Err(error) => Err(Error::Store(error)),
    };
    if there(MANIFEST)? || holds(MOTION)? || holds(AUDIO)? {
        return Err(Error::Exists {
            path: store.uri().into(),
        });
    }
    Ok(store.write(REPORT, b"{}\n".to_vec())?)
}

/// What has been made of a take before, or is now; and whether it had been.
fn one(
    plan: &Plan,
    take: &Take,
    store: &Store,
    song: Option<&LazySong>,
    present: &Present,
    uploads: Option<&ThreadPool>,
) -> Result<(Journal, bool), Error> {
    let key = match journal::key(plan, take) {
        Ok(key) => key,
        Err(problem) => return Ok((Journal::failed(take, problem), false)),
    };
    if let Some(journal) = Journal::read(store, &take.name, key)?
        && journal.rows.iter().all(|row| present.holds(row))
    {
        return Ok((journal, true));
    }
    let (phrases, report) = match take.make(plan, song) {
        Ok(made) => made,
        Err(problem) => return Ok((Journal::failed(take, problem), false)),
    };
    let write = |phrase| write(store, take, phrase);
    let rows = match uploads {
        Some(uploads) => uploads.install(|| phrases.into_par_iter().map(write).collect()),
        None => phrases.into_iter().map(write).collect::<Result<_, Error>>(),
    }?;
    let journal = Journal { key, rows, report };
    journal.write(store)?;
    Ok((journal, false))
}

/// Writes the files of a phrase and gives its row.
fn write(store: &Store, take: &Take, made: Made) -> Result<ManifestRow, Error> {
    let motion = npy::motion_bytes(&made.motion);
    let audio = npz::features_bytes(&made.audio);
    let row = ManifestRow {
        motion_source: made.motion_source,
        audio_source: take.audio.as_ref().map(|path| {
            let name = path.file_name().unwrap_or_default();
            name.to_string_lossy().into_owned()
        }),
        first_frame: made.first_frame as i64,
        frames: made.motion.frames() as i64,
        fps: kinegrad_motion::FPS,
        beats: made.beats,
        tempo: made.tempo,
        split: None,
        motion_bytes: motion.len() as i64,
        motion_sha256: Digest::of(&motion),
        audio_bytes: audio.len() as i64,
        audio_sha256: Digest::of(&audio),
        flags: made.flags,
        id: made.id,
    };
    store.write(&motion_path(&row.id), motion)?;
    store.write(&features_path(&row.id), audio)?;
    Ok(row)
}

/// The side that the plan puts a phrase on, if it states a split.
fn side(plan: &Plan, id: &str) -> Option<Side> {
    let patterns = &plan.split.validation;
    let held_out = patterns.iter().any(|pattern| matches(pattern, id));
    match (patterns.is_empty(), held_out) {
        (true, _) => None,
        (false, true) => Some(Side::Validation),
        (false, false) => Some(Side::Train),
    }
}
