//! `kinegrad check`

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_data::{DataConfig, Dataset, Phrase, read_motion};
use kinegrad_motion::sanity::{Profile, Report, check};
use kinegrad_motion::{Phrases, Statistics};
use kinegrad_train::checkpoint::State;
use kinegrad_train::checkpoint::resolve_checkpoint;
use serde_json::json;

use crate::args::{CheckArguments, ProfileName};
use crate::failure::{Failure, UsageError};
use crate::output::table;

/// Checks each file; exit code 1 if any fails.
pub fn run(arguments: CheckArguments) -> Result<ExitCode, Failure> {
    let statistics = statistics(&arguments)?;
    let profile = match arguments.profile {
        ProfileName::Document => Profile::Document,
        ProfileName::Strict => Profile::Strict,
    };
    let mut reports = Vec::new();
    for path in motion_files(&arguments.paths)? {
        let report = check(&read_motion(&path)?, profile, statistics.as_ref())?;
        reports.push((path.display().to_string(), report));
    }
    let passed = reports.iter().filter(|(_, report)| report.passed).count();
    let rate = passed as f64 / reports.len() as f64;
    if arguments.json {
        let files: Vec<_> = reports
            .iter()
            .map(|(path, report)| {
                json!({ "path": path, "passed": report.passed, "checks": report.checks })
            })
            .collect();
        say!(
            "{}",
            json!({ "files": files, "passed": passed, "pass_rate": rate })
        );
    } else {
        for (path, report) in &reports {
            say!("{path}\n{}\n", report_table(report));
        }
        say!("{passed} of {} pass ({:.0} %)", reports.len(), 100.0 * rate);
        if reports.len() > 1 {
            say!("{}", rates_table(reports.iter().map(|(_, report)| report)));
        }
    }
    Ok(if passed == reports.len() {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(1)
    })
}

/// The statistics that `--run` or `--source` names.
fn statistics(arguments: &CheckArguments) -> Result<Option<Statistics>, Failure> {
    if let Some(run) = &arguments.run {
        let path = resolve_checkpoint(run, |damaged| tell!("warning: {damaged}"))?;
        return Ok(Some(State::read(&path)?.statistics_of(&Phrases)?.clone()));
    }
    let Some(source) = &arguments.source else {
        return Ok(None);
    };
    let mut data = DataConfig {
        source: Some(source.clone()),
        ..Default::default()
    };
    // All of the phrases, whatever its manifest holds out.
    data.validation.fraction = Some(0.0);
    Ok(Some(Dataset::<Phrase>::open(&data)?.statistics()?))
}

/// The files meant by `paths`, folders searched through.
fn motion_files(paths: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    for path in paths {
        let before = files.len();
        collect(path, &mut files);
        if files.len() == before {
            let message = format!("there is no motion file at {}", path.display());
            let hint = "give a .npy file of [T, 25] float32, or a folder of them";
            return Err(UsageError::new(message, hint).into());
        }
    }
    Ok(files)
}

fn collect(path: &Path, files: &mut Vec<PathBuf>) {
    if path.is_file() {
        files.push(path.to_path_buf());
        return;
    }
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
    let mut inside: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    inside.sort();
    for path in inside {
        if path.is_dir() || path.extension().is_some_and(|extension| extension == "npy") {
            collect(&path, files);
        }
    }
}

fn verdict(passed: bool) -> String {
    if passed { "ok" } else { "FAIL" }.to_string()
}

fn report_table(report: &Report) -> String {
    let rows = report.checks.iter().map(|check| {
        let (value, threshold) = (check.value.to_string(), check.threshold.to_string());
        vec![
            check.name.to_string(),
            verdict(check.passed),
            value,
            threshold,
        ]
    });
    let header = ["check", "result", "value", "allowed"]
        .map(String::from)
        .to_vec();
    table(std::iter::once(header).chain(rows))
}

/// Share of the reports that pass each check.
fn rates_table<'a>(reports: impl Iterator<Item = &'a Report>) -> String {
    let mut counts: Vec<(&str, usize, usize)> = Vec::new();
    for check in reports.flat_map(|report| &report.checks) {
        let passed = usize::from(check.passed);
        match counts.iter_mut().find(|(name, ..)| *name == check.name) {
            Some((_, all, good)) => (*all, *good) = (*all + 1, *good + passed),
            None => counts.push((check.name, 1, passed)),
        }
    }
    let header = ["check", "pass"].map(String::from).to_vec();
    let rows = counts.into_iter().map(|(name, all, good)| {
        vec![
            name.to_string(),
            format!("{:.0} %", 100.0 * good as f64 / all as f64),
        ]
    });
    table(std::iter::once(header).chain(rows))
}
