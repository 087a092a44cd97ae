//! Captures to clips: full-body captures become a dataset in the layout of HumanML3D.
//!
//! A [joint map](JointMap) says which joints of a BVH capture are the 22 of the dataset's skeleton;
//! those of a C3D capture are estimated from its markers. The [body](Body) is brought to 20 frames per second, given the bones of one skeleton, put on the floor
//! and [cut](cut()) into clips. Labels come from file names, JSON, a table or the plan, and captions
//! are made of them; a mirrored copy of each clip has left and right exchanged in both. Whole takes
//! are held out by their numbers.

mod body;
mod captions;
mod centres;
mod clip;
mod cut;
mod dataset;
mod labels;
mod map;
#[cfg(test)]
mod map_tests;
mod plan;
mod report;
mod split;
mod take;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use kinegrad_data::{check_id, manifest, matches};
use kinegrad_motion::humanml::Skeleton;
use rayon::prelude::*;

pub use body::Body;
pub use captions::{Labels, mirrored};
pub use clip::Grounded;
pub use cut::cut;
pub use map::{FoundJoints, JointMap};
pub use plan::{CaptionsPlan, CapturePlan, ClipsPlan, LabelsPlan, Names, Phrases};
pub use report::{ClipTakeReport, ClipsReport};
pub use split::Part;

use crate::Error;
use crate::prepare::journal;
use crate::prepare::output::Output;
use crate::prepare::resolve::{matching, named};
use crate::prepare::{Plan, PrepareObserver, PrepareOptions};
use dataset::{CLIPS, ClipRow, write_index};
use labels::CaptionTable;
use split::SplitTake;
use take::Take;

/// What was made of a take.
type Journal = journal::Journal<ClipRow, ClipTakeReport>;

/// The tables of captions of a plan, by their names there.
type Tables = HashMap<String, CaptionTable>;

/// Makes the dataset of clips of `plan`. `None` if it was stopped: the takes done are kept, and the
/// next preparation goes on from there.
///
/// # Errors
/// [`Error::Plan`] for files that are not there or wrong, or if there is no clip to train on;
/// [`Error::Busy`] if another preparation is writing to the output, [`Error::Data`] if that holds a
/// dataset that no preparation wrote or cannot be written. A take that cannot be used is no error:
/// its report says why.
pub fn prepare_clips(
    plan: &Plan,
    plan_file: &Path,
    options: PrepareOptions,
    observer: &dyn PrepareObserver,
) -> Result<Option<ClipsReport>, Error> {
    let wrong = |problem: String| Error::plan(plan_file, problem);
    let takes = takes(plan).map_err(wrong)?;
    let tables = tables(plan).map_err(wrong)?;
    if takes.iter().all(|take| plan.split.names(&take.name)) {
        let problem = "split names every take: at least one to train on is needed";
        return Err(wrong(problem.to_owned()));
    }
    let output = Output::open(plan, CLIPS)?;
    let (total, done) = (takes.len(), AtomicUsize::new(0));
    observer.done(0, total);
    let journals: Vec<Option<Journal>> = takes
        .par_iter()
        .map(|take| {
            if observer.stop_requested() {
                return Ok(None);
            }
            let made = one(plan, take, options, &output, &tables)?;
            observer.done(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            Ok(Some(made))
        })
        .collect::<Result<_, Error>>()?;
    let Some(mut journals) = journals.into_iter().collect::<Option<Vec<_>>>() else {
        return Ok(None);
    };
    journals.sort_by(|a, b| a.report.name.cmp(&b.report.name));
    if journals.iter().all(|journal| journal.rows.is_empty()) {
        let reports = journals.iter().map(|journal| &journal.report);
        return Err(wrong(format!("no take gave a clip{}", reasons(reports))));
    }
    for journal in &journals {
        if !journal.kept && journal.rows.is_empty() && journal.report.failure.is_none() {
            journal.write(&journal.report.name, &output)?;
        }
    }
    finish(plan, plan_file, &output, options, journals).map(Some)
}

/// A motion file, by whatever path the plan names it.
fn one_file(plan: &Plan, file: &str) -> String {
    let path = plan.resolve(file).canonicalize();
    path.map_or_else(|_| file.to_owned(), |path| path.display().to_string())
}

/// Divides the clips and writes what ends the preparation.
fn finish(
    plan: &Plan,
    plan_file: &Path,
    output: &Output,
    options: PrepareOptions,
    journals: Vec<Journal>,
) -> Result<ClipsReport, Error> {
    let usable = journals.iter().filter(|journal| !journal.rows.is_empty());
    let takes: Vec<SplitTake<'_>> = usable
        .map(|journal| SplitTake {
            name: &journal.report.name,
            labels: &journal.report.labels,
            number: journal.report.number,
            // A take that gave clips has rows, each with the file.
            file: one_file(plan, &journal.rows[0].file),
        })
        .collect();
    let parts = plan.split.parts(&takes);
    let part_of: HashMap<String, Part> = takes
        .iter()
        .zip(parts.lists)
        .map(|(take, part)| (take.name.to_owned(), part))
        .collect();
    if !part_of.values().any(|part| *part == Part::Train) {
        let problem = "split names every take that gave a clip: at least one to train on is needed";
        return Err(Error::plan(plan_file, problem));
    }
    let entries = plan.split.validation.iter().chain(&plan.split.test);
    let idle = entries.filter(|entry| !takes.iter().any(|take| matches(entry, take.name)));
    let idle_entries = idle.cloned().collect();
    let kept = journals.iter().filter(|journal| journal.kept).count();
    let (mut rows, mut reports) = (Vec::new(), Vec::new());
    for journal in journals {
        rows.extend(journal.rows.into_iter().map(|row| {
            let part = part_of[&row.take];
            (row, part)
        }));
        reports.push(journal.report);
    }
    rows.sort_by(|(a, _), (b, _)| a.id.cmp(&b.id));
    let stale = output.stale(&rows.iter().flat_map(|(row, _)| row.paths()).collect());
    let stale_ids: BTreeSet<&str> = stale.iter().filter_map(|path| id(path)).collect();
    let mut counts = BTreeMap::new();
    for (_, part) in &rows {
        *counts.entry(part.to_string()).or_default() += 1;
    }
    let seconds = rows.iter().map(|(row, _)| row.frames as f64 / row.fps);
    let report = ClipsReport {
        output: output.store.uri(),
        clips: rows.len(),
        hours: seconds.sum::<f64>() / 3600.0,
        parts: counts,
        kept,
        stale: if options.prune { 0 } else { stale_ids.len() },
        idle_entries,
        split_notes: parts.notes,
        manifest: manifest::SUPPORTED,
        takes: reports,
    };
    output.finish(&report, |store| write_index(store, &rows))?;
    // Not before the lists have let go of them.
    if options.prune {
        output.prune(&stale)?;
    }
    Ok(report)
}

/// The id of the clip that a file belongs to.
fn id(path: &str) -> Option<&str> {
    let (_, name) = path.rsplit_once('/')?;
    name.rsplit_once('.').map(|(id, _)| id)
}

/// Why the first takes gave nothing.
fn reasons<'a>(reports: impl Iterator<Item = &'a ClipTakeReport>) -> String {
    const SHOWN: usize = 5;
    let reasons: Vec<String> = reports
        .map(|report| {
            let skipped = report.skipped.first().map(|skipped| skipped.reason.clone());
            let reason = report.failure.clone().or(skipped).unwrap_or_default();
            format!("; {}: {reason}", report.name)
        })
        .collect();
    let mut text: String = reasons.iter().take(SHOWN).map(String::as_str).collect();
    if reasons.len() > SHOWN {
        text += &format!("; and {} more", reasons.len() - SHOWN);
    }
    text
}

/// The takes of a plan: patterns resolved, joint maps read.
fn takes(plan: &Plan) -> Result<Vec<Take>, String> {
    let mut names = BTreeSet::new();
    let mut takes = Vec::new();
    for capture in &plan.captures {
        let map = capture.map.as_deref().map(|map| read_map(plan, map));
        let map = map.transpose()?;
        for motion in matching(&plan.resolve(&capture.motion), &["bvh", "c3d"])? {
            let ending = motion.extension().unwrap_or_default();
            let is = |known: &str| ending.eq_ignore_ascii_case(known);
            if !is("bvh") && !is("c3d") {
                return Err(format!("{}: .bvh and .c3d files allowed", motion.display()));
            }
            let bvh_keys = [
                ("map", capture.map.is_some()),
                ("units", capture.units.is_some()),
            ];
            if let Some((key, _)) = bvh_keys.iter().find(|(_, given)| *given && is("c3d")) {
                return Err(format!(
                    "capture `{}`: `{key}` is for .bvh files, and {} is none",
                    capture.motion,
                    motion.display()
                ));
            }
            let stem = motion.file_stem().unwrap_or_default().to_string_lossy();
            let name = capture.name.as_deref().unwrap_or("{name}");
            let name = name.replace("{name}", &stem);
            check_id(&format!("M{name}_00000")).map_err(|error| error.to_string())?;
            if !names.insert(name.clone()) {
                return Err(format!(
                    "two takes have the name `{name}`: give one another `name`"
                ));
            }
            takes.push(Take {
                name,
                capture: CapturePlan {
                    motion: named(&capture.motion, &motion),
                    ..capture.clone()
                },
                motion,
                map: map.clone(),
            });
        }
    }
    let image = |name: &&String| names.contains(&format!("M{name}"));
    if plan.clips().mirror
        && let Some(name) = names.iter().find(image)
    {
        return Err(format!(
            "a take `M{name}` beside `{name}`: M begins the ids of mirrored clips; give one another \
             `name`, or set clips.mirror = false"
        ));
    }
    Ok(takes)
}

/// The joint map that a plan names.
fn read_map(plan: &Plan, map: &str) -> Result<JointMap, String> {
    if Path::new(map)
        .extension()
        .is_none_or(|ending| ending != "toml")
    {
        return JointMap::built_in(map);
    }
    let path = plan.resolve(map);
    let file = path.display().to_string();
    let text = kinegrad_data::file::read_text(&path).map_err(|e| format!("{file}: {e}"))?;
    JointMap::parse(&file, &text, &Skeleton::humanml3d())
}

fn tables(plan: &Plan) -> Result<Tables, String> {
    let mut tables = Tables::new();
    for file in plan
        .captures
        .iter()
        .filter_map(|capture| capture.captions.as_ref())
    {
        if !tables.contains_key(file) {
            tables.insert(file.clone(), CaptionTable::read(&plan.resolve(file))?);
        }
    }
    Ok(tables)
}

/// What has been made of a take before, or is now.
fn one(
    plan: &Plan,
    take: &Take,
    options: PrepareOptions,
    output: &Output,
    tables: &Tables,
) -> Result<Journal, Error> {
    let table = take.capture.captions.as_ref().map(|file| &tables[file]);
    let known = match take.known(plan, table) {
        Ok(known) => known,
        Err(problem) => {
            return Ok(Journal::failed(ClipTakeReport {
                name: take.name.clone(),
                failure: Some(problem),
                ..ClipTakeReport::default()
            }));
        }
    };
    if !options.again
        && let Some(journal) = Journal::read(&output.store, &take.name, known.key)?
        && journal.rows.iter().all(|row| row.is_whole(output))
    {
        return Ok(journal);
    }
    let (rows, report) = take.make(plan, &known, output)?;
    let journal = Journal {
        key: known.key,
        rows,
        report,
        kept: false,
    };
    // If no take gives a clip, nothing is left behind; what failed is tried again.
    if !journal.rows.is_empty() {
        journal.write(&journal.report.name, output)?;
    }
    Ok(journal)
}
