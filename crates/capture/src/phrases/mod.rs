//! Datasets of phrases: takes of a root with their music, as a plan lists them.

mod align;
mod choreonet;
mod grid;
mod report;
mod resolve;
mod root_source;
mod song;
mod span;
mod split;
mod take;

use std::cell::OnceCell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use kinegrad_data::manifest::{self, Flag, ManifestRow};
use kinegrad_data::{
    AUDIO_FILE, Digest, MANIFEST, MOTION_FILE, Object, Store, StoreError, features_path, matches,
    motion_path,
};
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

pub use report::{GridReport, PhrasesReport, TakeReport};

use crate::Error;
use crate::plan::Plan;
use crate::prepare::output::{Output, Parts};
use crate::prepare::{Maker, PrepareObserver, PrepareOptions, Rejection, Report, Row, make_takes};
use resolve::{Take, resolve};
use song::Song;

const PHRASES: Parts = Parts {
    list: phrase_files,
    id: phrase_id,
    index: &[MANIFEST],
};

/// Makes the dataset of phrases of `plan`. `None` if the preparation was stopped: finished takes
/// are recorded, and the next preparation continues with the other takes.
///
/// # Errors
/// [`Error::Plan`] for missing files or if no take gave a phrase, [`Error::Busy`] if another
/// preparation is writing to the output, [`Error::Data`] if the output contains a dataset of
/// another origin or cannot be written. The report lists takes that cannot be used.
pub fn prepare(
    plan: &Plan,
    plan_file: &Path,
    options: PrepareOptions,
    observer: &dyn PrepareObserver,
) -> Result<Option<PhrasesReport>, Error> {
    if !manifest::SUPPORTED {
        let what = "`kinegrad data prepare`".to_owned();
        let feature = "manifest";
        return Err(kinegrad_data::Error::Feature { what, feature }.into());
    }
    let mut takes = plan.takes.clone();
    for choreonet in &plan.choreonet {
        takes.extend(choreonet::takes(plan, choreonet)?);
    }
    let takes = resolve(plan, takes).map_err(|problem| Error::plan(plan_file, problem))?;
    let output = Output::open(plan, PHRASES)?;
    // Threads that wait for a network are not limited to the number of cores.
    let uploads = ThreadPoolBuilder::new().num_threads(plan.store.concurrency);
    let uploads = output.store.is_remote().then(|| uploads.build().ok());
    let maker = PhraseMaker {
        plan,
        uploads: uploads.flatten(),
    };
    let groups = by_song(&takes);
    let journals = make_takes(&maker, &groups, plan_file, &output, options, observer)?;
    let Some(journals) = journals else {
        return Ok(None);
    };
    let kept = journals.iter().filter(|journal| journal.reused).count();
    let (mut rows, mut takes) = (Vec::new(), Vec::new());
    for journal in journals {
        rows.extend(journal.rows);
        takes.push(journal.report);
    }
    let divided = plan.split.divide(&mut rows);
    let made = rows.iter().flat_map(Row::files).map(|(path, ..)| path);
    let made: BTreeSet<String> = made.collect();
    let frames: i64 = rows.iter().map(|row| row.frames).sum();
    let entries = plan.split.validation.iter();
    let idle = entries.filter(|entry| !rows.iter().any(|row| matches(entry, &row.id)));
    let report = PhrasesReport {
        output: output.store.uri(),
        phrases: rows.len(),
        hours: frames as f64 / kinegrad_motion::FPS / 3600.0,
        kept,
        stale: 0,
        idle_entries: idle.cloned().collect(),
        held_out_songs: divided.held_out,
        split_note: divided.note,
        takes,
    };
    let report = |stale| PhrasesReport { stale, ..report };
    let write_index = |store: &Store| Ok(manifest::write(store, rows)?);
    let report = output.finish(&made, options.prune, report, write_index)?;
    Ok(Some(report))
}

fn phrase_files(store: &Store) -> Result<Vec<Object>, StoreError> {
    let mut files = Vec::new();
    for (folder, file) in [MOTION_FILE, AUDIO_FILE] {
        match store.list(folder, file) {
            Ok(objects) => files.extend(objects),
            Err(StoreError::Missing(_)) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(files)
}

fn phrase_id(path: &str) -> Option<&str> {
    let (folder, _) = path.rsplit_once('/')?;
    folder.rsplit_once('/').map(|(_, id)| id)
}

/// The takes in groups with the same song, which is read once for all of them.
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

impl Row for ManifestRow {
    fn files(&self) -> [(String, i64, Digest); 2] {
        [
            (motion_path(&self.id), self.motion_bytes, self.motion_sha256),
            (features_path(&self.id), self.audio_bytes, self.audio_sha256),
        ]
    }
}

struct PhraseMaker<'a> {
    plan: &'a Plan,
    /// Threads that upload phrases to a bucket.
    uploads: Option<ThreadPool>,
}

impl Maker for PhraseMaker<'_> {
    const ITEM: &'static str = "phrase";
    type Take = Take;
    type Input = ();
    type Shared = OnceCell<Result<Song, String>>;
    type Row = ManifestRow;
    type Report = TakeReport;

    fn name<'a>(&self, take: &'a Take) -> &'a str {
        &take.name
    }

    fn read(&self, take: &Take) -> Result<(Digest, ()), String> {
        Ok((take.key(self.plan)?, ()))
    }

    fn make(
        &self,
        take: &Take,
        (): (),
        song: &Self::Shared,
        output: &Output,
    ) -> Result<(Vec<ManifestRow>, TakeReport), Error> {
        let aligned = match take.align(self.plan, song) {
            Ok(aligned) => aligned,
            Err(problem) => return Ok((Vec::new(), TakeReport::failed(&take.name, problem))),
        };
        // Each phrase is written at once: a long take need not fit into memory.
        let make = |index| {
            let written = aligned.phrase(index).map(|made| {
                output.write(&motion_path(&made.row.id), made.motion)?;
                output.write(&features_path(&made.row.id), made.audio)?;
                Ok(made.row)
            });
            // A rejection is a result; a file that cannot be written is an error.
            written.map_or_else(|rejection| Ok(Err(rejection)), |row| row.map(Ok))
        };
        let all = aligned.phrases();
        let made: Vec<Result<ManifestRow, Rejection>> = match &self.uploads {
            Some(uploads) => uploads.install(|| all.into_par_iter().map(make).collect()),
            None => all.map(make).collect::<Result<_, Error>>(),
        }?;
        let unmade = made
            .iter()
            .filter_map(|phrase| phrase.as_ref().err().cloned());
        let unmade: Vec<Rejection> = unmade.collect();
        let rows: Vec<ManifestRow> = made.into_iter().flatten().collect();
        let failing = |row: &&ManifestRow| row.flags.contains(&Flag::FailsCcmotionChecks);
        let failing = rows.iter().filter(failing).count();
        Ok((rows, aligned.report(unmade, failing)))
    }
}
