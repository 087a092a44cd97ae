//! Datasets of clips: full-body captures become a dataset in the layout of HumanML3D.
//!
//! A [joint map](JointMap) names the joints of a BVH capture for the 22 joints of the
//! dataset's skeleton. The joints of a C3D capture are estimated from its markers. The
//! [body](body::Body) is resampled to 20 frames per second, retargeted to one skeleton, put on the
//! floor and cut into clips. Labels come from file names, JSON, a table or the plan; captions are
//! made from labels. A mirrored copy of each clip exchanges left and right.

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
mod reading;
mod report;
mod split;
mod take;
mod takes;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

use kinegrad_data::{Digest, Store, manifest, matches};

pub use body::Body;
pub use captions::Labels;
pub use map::JointMap;
pub use reading::read_body;
pub use report::{ClipTakeReport, ClipsReport};

use crate::Error;
use crate::plan::Plan;
use crate::prepare::output::Output;
use crate::prepare::{Journals, Maker, PrepareObserver, PrepareOptions, Row, make_takes};
use dataset::{CLIPS, ClipRow, write_index};
use split::{Part, SplitTake};
use take::{Take, TakeInput};
use takes::{Tables, tables, takes};

/// Like [`phrases::prepare`](crate::phrases::prepare), for the clips of `plan`.
///
/// # Errors
/// As `phrases::prepare`; [`Error::Plan`] also without a training clip.
pub fn prepare(
    plan: &Plan,
    plan_file: &Path,
    options: PrepareOptions,
    observer: &dyn PrepareObserver,
) -> Result<Option<ClipsReport>, Error> {
    let wrong = |problem: String| Error::plan(plan_file, problem);
    let takes = takes(plan).map_err(wrong)?;
    let tables = tables(plan).map_err(wrong)?;
    let trains = |take: &Take| plan.split.named(&take.name) == Part::Train;
    if !takes.iter().any(trains) {
        let problem = "split names every take: at least one to train on is needed";
        return Err(wrong(problem.to_owned()));
    }
    let output = Output::open(plan, CLIPS)?;
    let maker = ClipMaker { plan, tables };
    let groups: Vec<Vec<&Take>> = takes.iter().map(|take| vec![take]).collect();
    let journals = make_takes(&maker, &groups, plan_file, &output, options, observer)?;
    let finish = |journals| finish(plan, plan_file, &output, options, journals);
    journals.map(finish).transpose()
}

struct ClipMaker<'a> {
    plan: &'a Plan,
    tables: Tables,
}

impl Maker for ClipMaker<'_> {
    const ITEM: &'static str = "clip";
    type Take = Take;
    type Input = TakeInput;
    type Shared = ();
    type Row = ClipRow;
    type Report = ClipTakeReport;

    fn name<'a>(&self, take: &'a Take) -> &'a str {
        &take.name
    }

    fn read(&self, take: &Take) -> Result<(Digest, TakeInput), String> {
        let table = take.capture.captions.as_ref();
        let input = take.input(self.plan, table.map(|file| &self.tables[file]))?;
        Ok((input.key, input))
    }

    fn make(
        &self,
        take: &Take,
        input: TakeInput,
        (): &(),
        output: &Output,
    ) -> Result<(Vec<ClipRow>, ClipTakeReport), Error> {
        take.make(self.plan, &input, output)
    }
}

/// Divides the clips into sets and writes index and report.
fn finish(
    plan: &Plan,
    plan_file: &Path,
    output: &Output,
    options: PrepareOptions,
    journals: Journals<ClipMaker<'_>>,
) -> Result<ClipsReport, Error> {
    let takes = journals.iter().filter_map(|journal| {
        // Every row has the file.
        let file = &journal.rows.first()?.file;
        let path = plan.resolve(file).canonicalize();
        Some(SplitTake {
            name: &journal.report.name,
            labels: &journal.report.labels,
            number: journal.report.number,
            file: path.map_or_else(|_| file.clone(), |path| path.display().to_string()),
        })
    });
    let takes: Vec<SplitTake<'_>> = takes.collect();
    let parts = plan.split.parts(&takes);
    let names = takes.iter().map(|take| take.name.to_owned());
    let part_of: HashMap<String, Part> = names.zip(parts.lists).collect();
    if !part_of.values().any(|part| *part == Part::Train) {
        let problem = "split names every take that gave a clip: at least one to train on is needed";
        return Err(Error::plan(plan_file, problem));
    }
    let entries = plan.split.validation.iter().chain(&plan.split.test);
    let idle = entries.filter(|entry| !takes.iter().any(|take| matches(entry, take.name)));
    let idle_entries = idle.cloned().collect();
    let kept = journals.iter().filter(|journal| journal.reused).count();
    let (mut rows, mut reports) = (Vec::new(), Vec::new());
    for journal in journals {
        rows.extend(journal.rows.into_iter().map(|row| {
            let part = part_of[&row.take];
            (row, part)
        }));
        reports.push(journal.report);
    }
    rows.sort_by(|(a, _), (b, _)| a.id.cmp(&b.id));
    let made = rows.iter().flat_map(|(row, _)| row.files());
    let made: BTreeSet<String> = made.map(|(path, ..)| path).collect();
    let mut counts = BTreeMap::new();
    for (_, part) in &rows {
        *counts.entry(part.name().to_owned()).or_default() += 1;
    }
    let seconds = rows.iter().map(|(row, _)| row.frames as f64 / row.fps);
    let report = |stale| ClipsReport {
        output: output.store.uri(),
        clips: rows.len(),
        hours: seconds.sum::<f64>() / 3600.0,
        parts: counts,
        kept,
        stale,
        idle_entries,
        split_notes: parts.notes,
        manifest: manifest::SUPPORTED,
        takes: reports,
    };
    let write_index = |store: &Store| write_index(store, &rows);
    output.finish(&made, options.prune, report, write_index)
}
