//! `kinegrad data prepare`

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::ProgressBar;
use kinegrad_data::prepare::{Plan, PrepareObserver, Report, TakeReport, prepare};

use crate::args::PrepareArguments;
use crate::failure::Failure;
use crate::output::{grouped, table};
use crate::progress::{counting_bar, stop_on_ctrl_c};

/// Bar and stop flag of a preparation.
struct Progress {
    bar: ProgressBar,
    stop: Arc<AtomicBool>,
}

impl PrepareObserver for Progress {
    fn done(&self, takes: usize, total: usize) {
        self.bar.set_length(total as u64);
        self.bar.set_position(takes as u64);
    }

    fn stop_requested(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }
}

/// Makes a dataset; exit code 1 if nothing could be made of a take.
pub fn run(arguments: PrepareArguments) -> Result<ExitCode, Failure> {
    let mut plan = Plan::read(&arguments.plan)?;
    if let Some(out) = arguments.out {
        plan.output = match out.contains("://") {
            true => out,
            // What is given here is meant from here, not from where the plan stands.
            false => {
                std::path::absolute(&out).map_or(out, |path| path.to_string_lossy().into_owned())
            }
        };
    }
    let progress = Progress {
        bar: counting_bar("takes"),
        stop: stop_on_ctrl_c("stopping after the takes under way; run it again to go on"),
    };
    let report = prepare(&plan, &arguments.plan, &progress)?;
    progress.bar.finish_and_clear();
    let Some(report) = report else {
        return Ok(ExitCode::from(130));
    };
    let failed = report.takes.iter().any(|take| take.failure.is_some());
    if arguments.json {
        println!("{}", serde_json::to_string(&report).expect("plain data"));
    } else {
        print(&report);
    }
    Ok(ExitCode::from(u8::from(failed)))
}

fn print(report: &Report) {
    let header = [
        "take",
        "phrases",
        "seconds",
        "left out (s)",
        "bars off the beat (ms)",
    ];
    let mut rows = vec![header.map(String::from).to_vec()];
    for take in &report.takes {
        let lost: usize = take.rejected.iter().map(|rejection| rejection.frames).sum();
        rows.push(vec![
            take.name.clone(),
            match take.failure {
                Some(_) => "failed".to_owned(),
                None => take.phrases.to_string(),
            },
            format!("{:.1}", take.seconds),
            format!("{:.1}", lost as f64 / kinegrad_motion::FPS),
            offsets(take),
        ]);
    }
    println!("{}", table(rows));
    for take in &report.takes {
        if let Some(failure) = &take.failure {
            println!("{}: failed: {failure}", take.name);
        }
        for rejection in &take.rejected {
            println!(
                "{}: {} frames from {} left out: {}",
                take.name, rejection.frames, rejection.first_frame, rejection.reason
            );
        }
        for note in &take.notes {
            println!("{}: {note}", take.name);
        }
    }
    println!(
        "\n{} phrases ({:.2} minutes) in {}; {} of {} takes had been made before",
        grouped(report.phrases),
        report.hours * 60.0,
        report.output,
        report.kept,
        report.takes.len()
    );
}

/// Median and extremes of the distances from bar starts to tracked beats.
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
