//! `kinegrad check`

mod motion;

use std::path::Path;
use std::process::ExitCode;

use kinegrad_data::file::read_text;
use kinegrad_data::humanml::SkeletonName;
use kinegrad_data::{DataConfig, DataKind};
use kinegrad_motion::{Profile, Report, Representation, SanityThresholds, Statistics};
use kinegrad_report::table;
use kinegrad_settings::Document;
use kinegrad_train::checkpoint::State;
use kinegrad_train::{Error, Systems};
use serde_json::json;

use self::motion::Motion;
use super::sample::checkpoint;
use crate::args::CheckArguments;
use crate::io::{BvhReading, motion_files, with_raw};
use crate::output;

/// Checks each file; exit code 1 if any fails.
pub fn run(systems: Systems<'_>, arguments: CheckArguments) -> Result<ExitCode, Error> {
    let mut reports = Vec::new();
    let mut of_people = false;
    // The statistics of files with so many channels.
    let mut measured: Option<(usize, Option<Statistics>)> = None;
    let mut files = motion_files(&arguments.paths, &["npy", "bvh"])?;
    if arguments.raw {
        files = with_raw(files);
    }
    let strict = arguments.profile != Profile::Ccmotion;
    let run = arguments.run.as_deref().filter(|_| strict);
    let state = run.map(checkpoint).transpose()?.map(|saved| saved.state);
    let reading = BvhReading::of(&arguments.bvh);
    let thresholds = arguments
        .thresholds
        .as_deref()
        .map(thresholds)
        .transpose()?;
    if thresholds.is_some() && strict {
        return Err(Error::usage(
            "option `thresholds` without option `profile = \"ccmotion\"`",
            "the bounds of `strict` come from training motion or captured people",
        ));
    }
    for path in files {
        let motion = Motion::read(systems, &path, &reading)?;
        if let (Motion::Capture(_), Profile::Ccmotion) = (&motion, arguments.profile) {
            return Err(Error::usage(
                format!("{}: the profile `ccmotion` checks arrays", path.display()),
                "BVH files are checked by the profile `strict`",
            ));
        }
        if let Some(representation) = motion.representation() {
            let channels = representation.stored_channels();
            if measured.as_ref().is_none_or(|(of, _)| *of != channels) {
                let found = statistics(&arguments, state.as_ref(), representation)?;
                measured = Some((channels, found));
            }
        }
        let known = measured.as_ref().and_then(|(_, found)| found.as_ref());
        let known = known.filter(|_| motion.representation().is_some());
        let report = match &thresholds {
            Some(thresholds) => motion.check_thresholds(&path, thresholds)?,
            None => motion.check(arguments.profile, known),
        };
        of_people |= strict && known.is_none_or(|known| known.movement.is_empty());
        reports.push((path.display().to_string(), report));
    }
    let passed = reports.iter().filter(|(_, report)| report.passed).count();
    let rate = passed as f64 / reports.len() as f64;
    if arguments.json {
        let file = |(path, report): &(String, Report)| json!({ "path": path, "passed": report.passed, "checks": report.checks });
        let files: Vec<_> = reports.iter().map(file).collect();
        output::json(&json!({ "files": files, "passed": passed, "pass_rate": rate }));
    } else {
        for (path, report) in &reports {
            say!("{path}");
            show!("{}\n", report_table(report));
            for check in report.checks.iter().filter(|check| !check.passed) {
                say!("FAIL {}: {}\n", check.name, check.message);
            }
        }
        if of_people {
            say!(
                "The bounds are those of captured people; --run or --source sets those of your data.\n"
            );
        }
        say!("{passed} of {} pass ({:.0} %)", reports.len(), 100.0 * rate);
        if reports.len() > 1 {
            show!("{}", rates_table(reports.iter().map(|(_, report)| report)));
        }
    }
    Ok(ExitCode::from(u8::from(passed < reports.len())))
}

/// The statistics of `--run` or `--source`, in this `representation`.
fn statistics(
    arguments: &CheckArguments,
    state: Option<&State>,
    representation: &dyn Representation,
) -> Result<Option<Statistics>, Error> {
    if arguments.profile == Profile::Ccmotion {
        return Ok(None);
    }
    // Joints have the measures of clips.
    let skeleton = representation.skeleton().and_then(SkeletonName::of);
    if let Some(state) = state {
        let is_of_clips = skeleton == Some(state.config.data.humanml3d.skeleton);
        let found = match is_of_clips {
            true => state.clip_statistics(),
            false => state.statistics_of(representation),
        };
        return Ok(Some(found?.clone()));
    }
    let Some(source) = &arguments.source else {
        return Ok(None);
    };
    let mut data = DataConfig {
        source: Some(source.clone()),
        ..Default::default()
    };
    match skeleton {
        Some(skeleton) => {
            data.kind = DataKind::Humanml3d;
            data.humanml3d.skeleton = skeleton;
        }
        // Includes the held-out phrases.
        None => data.validation.fraction = Some(0.0),
    }
    Ok(Some(kinegrad_data::statistics(&data)?))
}

/// The bounds in a file.
pub fn thresholds(path: &Path) -> Result<SanityThresholds, Error> {
    let (name, help) = (
        path.display().to_string(),
        "docs/config.md lists the keys of `evaluation.thresholds`",
    );
    let text = read_text(path)
        .map_err(|error| Error::usage(format!("{name} cannot be read: {error}"), help))?;
    let document = Document::parse(&text, &name)?;
    let thresholds: SanityThresholds = document.read(help)?;
    let valid = thresholds.validate();
    valid.map_err(|setting| document.refuse(setting))?;
    Ok(thresholds)
}

fn report_table(report: &Report) -> String {
    let rows = report.checks.iter().map(|check| {
        let result = if check.passed { "ok" } else { "FAIL" };
        let (value, threshold) = (check.value.to_string(), check.threshold.to_string());
        [check.name.to_string(), result.into(), value, threshold]
    });
    table(["check", "result", "value", "allowed"], rows)
}

/// The share of passed reports by check.
fn rates_table<'a>(reports: impl Iterator<Item = &'a Report>) -> String {
    let mut counts: Vec<(&str, usize, usize)> = Vec::new();
    for check in reports.flat_map(|report| &report.checks) {
        let passed = usize::from(check.passed);
        match counts.iter_mut().find(|(name, ..)| *name == check.name) {
            Some((_, all, good)) => (*all, *good) = (*all + 1, *good + passed),
            None => counts.push((check.name, 1, passed)),
        }
    }
    let rate = |all: usize, good: usize| format!("{:.0} %", 100.0 * good as f64 / all as f64);
    let rows = counts.into_iter();
    let rows = rows.map(|(name, all, good)| [name.to_string(), rate(all, good)]);
    table(["check", "pass"], rows)
}
