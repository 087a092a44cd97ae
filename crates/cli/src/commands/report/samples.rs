//! The samples of a run as moving thumbnails, with their checks.

use std::path::Path;

use kinegrad_motion::{Profile, Report, Representation, Statistics};
use kinegrad_report::page::{Block, Cell, Section, Table, Tone};
use kinegrad_report::scene::Scene;
use kinegrad_report::viewer::Thumbnail;
use kinegrad_train::run::SAMPLES;
use kinegrad_train::{Error, Systems};

use super::own_files;
use crate::io::{BvhReading, MotionArray, file_stem, is_companion};
use crate::runs::Run;
use crate::scene;

/// Largest numbers of checked samples and of moving thumbnails.
const CHECKED: usize = 200;
const MOVING: usize = 12;

/// A sample that was read.
struct Sample {
    name: String,
    seconds: f64,
    /// `None` if a position is not finite.
    scene: Option<Scene>,
    ccmotion: Report,
    strict: Report,
}

/// The samples in the run's folder.
pub fn section(systems: Systems<'_>, run: &Run) -> Section {
    let mut section = Section::new("Samples");
    let mut files = own_files(&run.folder, SAMPLES, &["npy"], &mut section);
    files.retain(|path| !is_companion(path));
    let mut samples = Vec::new();
    for path in files.iter().take(CHECKED) {
        match read(systems, run, path) {
            Ok(sample) => samples.push(sample),
            Err(error) => section.add(Block::Warning(error.to_string())),
        }
    }
    let moving = samples.iter().filter_map(|sample| sample.scene.clone());
    let scenes = moving.take(MOVING).map(Thumbnail::from);
    section.add(Block::Scenes(scenes.collect()));
    section.add(Block::Table(table(&samples)));
    if files.len() > MOVING {
        let checked = files.len().min(CHECKED);
        section.add(Block::Text(format!(
            "{MOVING} of {} samples move here, {checked} were checked.",
            files.len()
        )));
    }
    section
}

fn read(systems: Systems<'_>, run: &Run, path: &Path) -> Result<Sample, Error> {
    let array = MotionArray::read(systems, path, &BvhReading::default())?;
    let representation = &*array.representation;
    let name = file_stem(path);
    let figure = scene::of(representation, &array.values, name.clone());
    let statistics = statistics(run, representation);
    let check = |profile| representation.check(&array.values, profile, statistics);
    Ok(Sample {
        seconds: array.frames as f64 / representation.fps(),
        ccmotion: check(Profile::Ccmotion),
        strict: check(Profile::Strict),
        scene: figure.map(|figure| Scene {
            title: name.clone(),
            objects: vec![figure],
            ..Scene::default()
        }),
        name,
    })
}

/// The statistics of the training motion.
fn statistics<'a>(run: &'a Run, representation: &dyn Representation) -> Option<&'a Statistics> {
    let (_, state) = run.newest.as_ref()?;
    state.statistics_of(representation).ok()
}

/// One row per sample: results of both profiles, and failed checks.
fn table(samples: &[Sample]) -> Table {
    let header = ["sample", "length", "ccmotion", "strict", "fails"];
    let verdict = |report: &Report| match report.passed {
        true => Cell::new("ok", Tone::Good),
        false => Cell::new("fail", Tone::Bad),
    };
    let row = |sample: &Sample| {
        vec![
            Cell::from(sample.name.as_str()),
            Cell::from(format!("{:.1} s", sample.seconds)),
            verdict(&sample.ccmotion),
            verdict(&sample.strict),
            Cell::from(failing([&sample.ccmotion, &sample.strict])),
        ]
    };
    Table {
        header: header.map(String::from).to_vec(),
        rows: samples.iter().map(row).collect(),
    }
}

/// The failed checks, each once, with the value of the last profile.
fn failing(reports: [&Report; 2]) -> String {
    let checks = reports.into_iter().flat_map(|report| &report.checks);
    let mut failing: Vec<(&str, String)> = Vec::new();
    for check in checks.filter(|check| !check.passed) {
        let (value, threshold) = (&check.value, &check.threshold);
        let text = format!("{} {value} (allowed {threshold})", check.name);
        match failing.iter_mut().find(|(name, _)| *name == check.name) {
            Some((_, known)) => *known = text,
            None => failing.push((check.name, text)),
        }
    }
    let texts: Vec<String> = failing.into_iter().map(|(_, text)| text).collect();
    texts.join(", ")
}
