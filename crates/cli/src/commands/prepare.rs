//! `kinegrad data prepare`

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use kinegrad_capture::clips::{self, ClipsReport};
use kinegrad_capture::phrases::{self, PhrasesReport, TakeReport};
use kinegrad_capture::plan::{Grid, Plan};
use kinegrad_capture::prepare::{PrepareObserver, PrepareOptions};
use kinegrad_report::{facts, grouped, table};
use kinegrad_settings::{counted, plural};
use kinegrad_train::Error;
use serde::Serialize;

use crate::args::PrepareArguments;
use crate::output::{self, unusable};
use crate::progress::{Count, stop_on_ctrl_c};

/// Progress bar and stop flag of a preparation.
struct Progress {
    takes: Count,
    stop: Arc<AtomicBool>,
}

impl PrepareObserver for Progress {
    fn done(&self, takes: usize, total: usize) {
        self.takes.show(takes, total);
    }

    fn stop_requested(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }
}

/// Prepares a dataset; the exit code is 1 if a take cannot be used.
pub fn run(arguments: PrepareArguments) -> Result<ExitCode, Error> {
    let mut plan = Plan::read(&arguments.plan).map_err(failed)?;
    if let Some(out) = arguments.out {
        // A path is relative to the working directory, not to the plan.
        let path = std::path::absolute(&out)
            .ok()
            .filter(|_| !out.contains("://"));
        plan.output = match path.map(|path| path.into_os_string().into_string()) {
            None => out,
            Some(Ok(path)) => path,
            Some(Err(path)) => {
                let message = format!("the path {} is not UTF-8", path.display());
                return Err(Error::usage(message, "write to another folder (`--out`)"));
            }
        };
    }
    let progress = Progress {
        takes: Count::new("takes done"),
        stop: stop_on_ctrl_c(
            "stopping after the current takes; run the command again to continue",
            Arc::new(AtomicBool::new(true)),
        ),
    };
    let options = PrepareOptions {
        again: arguments.again,
        prune: arguments.prune,
    };
    if plan.is_of_clips() {
        let report = clips::prepare(&plan, &arguments.plan, options, &progress).map_err(failed)?;
        return Ok(ended(arguments.json, report, print_clips, |report| {
            report.takes.iter().any(|take| take.failure.is_some())
        }));
    }
    let report = phrases::prepare(&plan, &arguments.plan, options, &progress).map_err(failed)?;
    Ok(ended(arguments.json, report, print, |report| {
        report.takes.iter().any(|take| take.failure.is_some())
    }))
}

/// Prints the report of a preparation that was not stopped, and returns the exit code.
fn ended<R: Serialize>(
    json: bool,
    report: Option<R>,
    print: fn(&R),
    failed: fn(&R) -> bool,
) -> ExitCode {
    let Some(report) = report else {
        return ExitCode::from(130);
    };
    match json {
        true => output::json(&report),
        false => print(&report),
    }
    ExitCode::from(u8::from(failed(&report)))
}

fn failed(error: kinegrad_capture::Error) -> Error {
    match error {
        kinegrad_capture::Error::Data(error) => error.into(),
        error => unusable(error),
    }
}

fn print(report: &PhrasesReport) {
    let header = [
        "take",
        "phrases",
        "seconds",
        "left out (s)",
        "stated bars off the beat (ms)",
    ];
    let rows = report.takes.iter().map(|take| {
        let lost: usize = take.rejected.iter().map(|rejection| rejection.frames).sum();
        [
            take.name.clone(),
            match take.failure {
                Some(_) => "failed".to_owned(),
                None => take.phrases.to_string(),
            },
            format!("{:.1}", take.seconds),
            format!("{:.1}", lost as f64 / kinegrad_motion::FPS),
            offsets(take),
        ]
    });
    show!("{}", table(header, rows));
    print_grids(&report.takes);
    for take in &report.takes {
        if let Some(failure) = &take.failure {
            say!("{}: failed: {failure}", take.name);
        }
        for rejection in &take.rejected {
            say!(
                "{}: {} from {} left out: {}",
                take.name,
                counted(rejection.frames, "frame"),
                rejection.first_frame,
                rejection.reason
            );
        }
        for note in &take.notes {
            say!("{}: {note}", take.name);
        }
    }
    if !report.held_out_songs.is_empty() {
        say!("held out: {}", report.held_out_songs.join(", "));
    }
    if let Some(note) = &report.split_note {
        say!("split: {note}");
    }
    for entry in &report.idle_entries {
        say!("split.validation: no phrase matches `{entry}`");
    }
    print_stale(report.stale, "phrase");
    say!(
        "\n{} {} ({:.2} minutes) in {}; {} of {} unchanged",
        grouped(report.phrases),
        plural(report.phrases, "phrase"),
        report.hours * 60.0,
        report.output,
        report.kept,
        counted(report.takes.len(), "take")
    );
}

/// Notes phrases or clips that the dataset does not include.
fn print_stale(count: usize, item: &str) {
    if count > 0 {
        say!(
            "the output folder has {} {} of other takes; the dataset does not include them, and \
             `--prune` removes them",
            grouped(count),
            plural(count, item)
        );
    }
}

/// Largest number of lines below a heading.
const LISTED: usize = 20;

fn print_clips(report: &ClipsReport) {
    let mut maps: BTreeMap<&str, usize> = BTreeMap::new();
    for take in report.takes.iter().filter(|take| take.clips > 0) {
        *maps.entry(&take.map).or_default() += 1;
    }
    let maps = maps.into_iter();
    let maps = maps.map(|(map, takes)| format!("{map} {}", grouped(takes)));
    let (clips, minutes) = (grouped(report.clips), report.hours * 60.0);
    let (unchanged, takes) = (grouped(report.kept), grouped(report.takes.len()));
    let parts = report.parts.iter();
    let parts = parts.map(|(part, clips)| format!("{part} {}", grouped(*clips)));
    let shown = [
        ("dataset", report.output.clone()),
        ("clips", format!("{clips} ({minutes:.2} minutes)")),
        ("lists", parts.collect::<Vec<_>>().join(", ")),
        ("joint maps (takes)", maps.collect::<Vec<_>>().join(", ")),
        ("takes unchanged", format!("{unchanged} of {takes}")),
    ];
    show!("{}", facts(shown));
    let mut lines = [("failed", vec![]), ("skipped", vec![]), ("notes", vec![])];
    for take in &report.takes {
        let line = |text: &String| format!("{}: {text}", take.name);
        lines[0].1.extend(take.failure.iter().map(line));
        lines[1]
            .1
            .extend(take.skipped.iter().map(|rest| line(&rest.reason)));
        lines[2].1.extend(take.notes.iter().map(line));
    }
    for (heading, lines) in lines {
        list(heading, lines);
    }
    for note in &report.split_notes {
        say!("split: {note}");
    }
    for entry in &report.idle_entries {
        say!("split: no take matches `{entry}`");
    }
    print_stale(report.stale, "clip");
    if !report.manifest {
        say!("no manifest.parquet: this build writes none (`--features full` does)");
    }
}

/// Prints lines below a heading, and the number of omitted lines.
fn list(heading: &str, lines: Vec<String>) {
    if lines.is_empty() {
        return;
    }
    say!("\n{heading}: {}", grouped(lines.len()));
    for line in lines.iter().take(LISTED) {
        say!("  {line}");
    }
    if lines.len() > LISTED {
        let more = lines.len() - LISTED;
        say!("  and {more} more, in prepare/report.json");
    }
}

/// Agreement of stated and tracked beats, and the beats to which segments are aligned.
fn print_grids(takes: &[TakeReport]) {
    let header = [
        "take",
        "stated",
        "tracked",
        "tempo",
        "drift (s)",
        "drift (beats)",
        "agreement of phase",
        "aligned with",
    ];
    let rows = takes.iter().filter_map(|take| {
        let grid = take.grid.as_ref()?;
        let (before, after) = (grid.uniform_concentration, grid.concentration);
        let (agreement, beats) = match grid.grid {
            Grid::Tracked => (format!("{before:.2} -> {after:.2}"), "tracked beats"),
            Grid::Uniform => (format!("{before:.2}"), "even beats"),
        };
        Some([
            take.name.clone(),
            format!("{:.1}", grid.stated_beats),
            grid.tracked_beats.to_string(),
            format!("{:.1}", grid.tracked_tempo),
            format!("{:.2}", grid.drift_seconds),
            format!("{:.2}", grid.drift_beats),
            agreement,
            beats.to_owned(),
        ])
    });
    let rows: Vec<_> = rows.collect();
    if !rows.is_empty() {
        show!("{}", table(header, rows));
    }
}

/// Median and range of the offsets from bar starts to tracked beats.
fn offsets(take: &TakeReport) -> String {
    let mut sorted = take.bar_offsets_ms.clone();
    sorted.sort_by(f64::total_cmp);
    match (sorted.first(), sorted.last()) {
        (Some(first), Some(last)) => {
            let median = sorted[sorted.len() / 2];
            format!("{median:+.0} ({first:+.0} to {last:+.0})")
        }
        _ => "-".to_owned(),
    }
}
