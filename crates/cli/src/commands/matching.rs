//! `kinegrad match`

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_capture::{Bvh, UpAxis};
use kinegrad_data::file::read_file;
use kinegrad_data::write_whole;
use kinegrad_matching::{
    Example, Fixed, Job, Keyframe, Looping, Made, Measures, Novelty, PartChoice, Preset, Settings,
    Sliding,
};
use kinegrad_report::check_ending;
use kinegrad_train::Error;
use serde::Serialize;

use crate::args::MatchArguments;
use crate::output::unusable;
use crate::scene::{guess_units, guess_up};
use crate::{folder, interrupt, output};

mod picture;

/// Largest file that is read, bytes.
const LARGEST: u64 = 1 << 30;

/// How a motion was made, and what it has of its examples.
#[derive(Serialize)]
struct Record {
    kinegrad: &'static str,
    examples: Vec<PathBuf>,
    seed: u64,
    preset: Preset,
    settings: Settings,
    #[serde(skip_serializing_if = "Option::is_none")]
    coherence: Option<f64>,
    frames: usize,
    fps: f64,
    heading: bool,
    parts: Vec<PartRecord>,
    #[serde(skip_serializing_if = "Option::is_none")]
    keyframes: Option<PathBuf>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    fixed: Vec<String>,
    /// None where feet are not held.
    #[serde(skip_serializing_if = "Option::is_none")]
    sliding: Option<Sliding>,
    /// None where the motions are too short, or too long to be compared.
    measures: Option<Measures>,
}

/// A part of the body, and what its motion copies.
#[derive(Serialize)]
struct PartRecord {
    name: String,
    joints: Vec<String>,
    #[serde(flatten)]
    novelty: Novelty,
}

/// Makes a motion of examples.
pub fn run(arguments: MatchArguments) -> Result<ExitCode, Error> {
    interrupt::end_between_files();
    let record_path = arguments.out.with_extension("json");
    must_be_writable(&arguments, &record_path)?;
    let examples = arguments.examples.iter().map(|path| read(path));
    let examples: Vec<Example> = examples.collect::<Result<_, _>>()?;
    let job = job(&arguments, &examples)?;
    let made = job.make(&examples).map_err(unusable)?;
    let text = made.bvh.to_text();
    let record = record(&arguments, &job, &made);
    let described = serde_json::to_string_pretty(&record).expect("plain data") + "\n";
    let outputs = [
        Some(&arguments.out),
        Some(&record_path),
        arguments.svg.as_ref(),
    ];
    for path in outputs.into_iter().flatten() {
        folder::must_take(path)?;
    }
    interrupt::not_during(|| {
        if let Some(svg) = &arguments.svg {
            let names = arguments.examples.iter().map(|path| name(path));
            let metres = metres(&examples[0], job.up);
            picture::draw(&made, &names.collect::<Vec<_>>(), metres, svg)?;
        }
        write_whole(&arguments.out, text.as_bytes())?;
        write_whole(&record_path, described.as_bytes())?;
        Ok::<(), Error>(())
    })?;
    match arguments.json {
        true => output::json(&record),
        false => {
            for path in outputs.into_iter().flatten() {
                say!("{}", path.display());
            }
            summarize(&record);
            note_short(&job, &made);
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Refuses outputs that are there, or are read.
fn must_be_writable(arguments: &MatchArguments, record: &Path) -> Result<(), Error> {
    let out = &arguments.out;
    if !is_bvh(out) {
        let message = format!("`--out {}` does not end in .bvh", out.display());
        let hint = format!("`--out {}`", out.with_extension("bvh").display());
        return Err(Error::usage(message, hint));
    }
    if let Some(svg) = &arguments.svg {
        check_ending(svg).map_err(unusable)?;
    }
    let fixed = arguments.fix.iter().map(|(_, path)| path);
    if arguments
        .examples
        .iter()
        .chain(fixed)
        .any(|path| path == out)
    {
        let message = format!("{} is an example itself", out.display());
        return Err(Error::usage(message, "name another file with `--out`"));
    }
    let outputs = [Some(out.as_path()), Some(record), arguments.svg.as_deref()];
    for path in outputs.into_iter().flatten() {
        if path.exists() && !arguments.overwrite {
            let message = format!("{} exists already", path.display());
            let hint = "replace it with `--overwrite`, or name another file with `--out`";
            return Err(Error::usage(message, hint));
        }
    }
    Ok(())
}

fn is_bvh(path: &Path) -> bool {
    path.extension()
        .is_some_and(|found| found.eq_ignore_ascii_case("bvh"))
}

fn read(path: &Path) -> Result<Example, Error> {
    let file = path.display().to_string();
    if !is_bvh(path) {
        let message = format!("{file} is no .bvh file");
        return Err(Error::usage(message, "examples are motions as BVH"));
    }
    let bytes = read_file(path, LARGEST).map_err(|error| {
        let message = format!("{file} cannot be read: {error}");
        Error::usage(message, "give a BVH file that is there")
    })?;
    let bvh = Bvh::parse(&bytes, &file).map_err(unusable)?;
    Ok(Example { file, bvh })
}

fn read_text(path: &Path) -> Result<String, Error> {
    let file = path.display();
    std::fs::read_to_string(path).map_err(|error| {
        let message = format!("{file} cannot be read: {error}");
        Error::usage(message, "give a TOML file; docs/matching.md describes it")
    })
}

fn job(arguments: &MatchArguments, examples: &[Example]) -> Result<Job, Error> {
    let is_paper = arguments.preset == Preset::Paper;
    let parts = match arguments
        .parts
        .as_deref()
        .map(|parts| (parts, parts.to_str()))
    {
        None if is_paper => PartChoice::Automatic,
        None | Some((_, Some("whole"))) => PartChoice::Whole,
        Some((_, Some("auto"))) => PartChoice::Automatic,
        Some((path, _)) => PartChoice::File {
            file: path.display().to_string(),
            text: read_text(path)?,
        },
    };
    let keyframes = match &arguments.keyframes {
        Some(path) => keyframes(path)?,
        None => Vec::new(),
    };
    let fixed = arguments.fix.iter().map(|(part, path)| {
        let motion = read(path)?;
        let part = part.clone();
        Ok(Fixed { part, motion })
    });
    Ok(Job {
        settings: settings(arguments)?,
        length: arguments.length,
        seed: arguments.seed,
        up: up(arguments, &examples[0]),
        contacts: is_paper,
        heading: arguments.heading,
        parts,
        keyframes,
        fixed: fixed.collect::<Result<_, Error>>()?,
        feet: arguments.feet,
    })
}

fn settings(arguments: &MatchArguments) -> Result<Settings, Error> {
    let mut settings = Settings::of(arguments.preset);
    if let Some(coherence) = arguments.coherence {
        settings = settings.with_coherence(coherence)?;
    }
    if arguments.looping {
        settings.looping = Looping::Even;
    }
    let set = |value: Option<f64>, of: &mut f64| *of = value.unwrap_or(*of);
    set(arguments.pyr_factor, &mut settings.pyr_factor);
    set(arguments.sigma, &mut settings.sigma);
    settings.patch_size = arguments.patch_size.unwrap_or(settings.patch_size);
    settings.num_steps = arguments.steps.unwrap_or(settings.num_steps);
    settings.coarse_ratio = arguments.coarse_ratio.unwrap_or(settings.coarse_ratio);
    settings.alpha = arguments.alpha.map_or(settings.alpha, |alpha| alpha.0);
    settings.validate()?;
    Ok(settings)
}

/// The key frames of a file, with the motions they are from, which are looked for beside it.
fn keyframes(path: &Path) -> Result<Vec<(Keyframe, Option<Example>)>, Error> {
    let text = read_text(path)?;
    let keyframes = Keyframe::read(&text, &path.display().to_string()).map_err(unusable)?;
    let with_source = |keyframe: Keyframe| {
        let source = keyframe
            .file
            .as_ref()
            .map(|file| read(&path.with_file_name(file)));
        Ok((keyframe, source.transpose()?))
    };
    keyframes.into_iter().map(with_source).collect()
}

/// The axis that points up: as given, or by the feet.
fn up(arguments: &MatchArguments, first: &Example) -> UpAxis {
    arguments.up.unwrap_or_else(|| {
        let joints = first.bvh.joints().iter();
        let names: Vec<String> = joints.map(|joint| joint.name.clone()).collect();
        guess_up(&names, &places(first))
    })
}

/// Metres of a unit of the file, if the body is as tall as a person.
fn metres(first: &Example, up: UpAxis) -> f64 {
    guess_units(&places(first), up).metres()
}

/// Where the joints are in the first frame.
fn places(example: &Example) -> Vec<[f64; 3]> {
    let world = example.bvh.world(0).into_iter();
    world.map(|pose| pose.position).collect()
}

/// A file's name without its folder and extension.
fn name(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default();
    stem.to_string_lossy().into_owned()
}

fn record(arguments: &MatchArguments, job: &Job, made: &Made) -> Record {
    let joints = made.figure.joints();
    let parts = made
        .parts
        .iter()
        .zip(made.novelty())
        .map(|(part, novelty)| PartRecord {
            name: part.name.clone(),
            joints: part
                .joints
                .iter()
                .map(|&joint| joints[joint].name.clone())
                .collect(),
            novelty,
        });
    let fixed = arguments.fix.iter();
    Record {
        kinegrad: env!("CARGO_PKG_VERSION"),
        examples: arguments.examples.clone(),
        seed: arguments.seed,
        preset: arguments.preset,
        settings: job.settings.clone(),
        coherence: arguments.coherence,
        frames: made.bvh.frames(),
        fps: 1.0 / made.figure.frame_time(),
        heading: arguments.heading,
        parts: parts.collect(),
        keyframes: arguments.keyframes.clone(),
        fixed: fixed
            .map(|(part, path)| format!("{part}={}", path.display()))
            .collect(),
        sliding: made.sliding,
        measures: made.measures(&[]),
    }
}

/// Says that the examples are short, where the coarsest level is hardly coarser than they are: noise is
/// then not sorted into longer stretches.
fn note_short(job: &Job, made: &Made) {
    let longest = made.examples.iter().map(|example| example.frames()).max();
    let (settings, longest) = (&job.settings, longest.unwrap_or(1));
    let ratio = settings.coarse_ratio.ratio(settings.patch_size, longest);
    if ratio > 0.5 && settings.sigma > 0.0 {
        tell!(
            "note: the coarsest level has {:.0} % of the longest example's {longest} frames, which \
             leaves many splices; `--coarse-ratio 2x` or `--coherence 1` makes fewer",
            100.0 * ratio.min(1.0)
        );
    }
}

/// Says in words what was made.
fn summarize(record: &Record) {
    tell!("{} frames at {:.2} a second", record.frames, record.fps);
    if let Some(measures) = &record.measures {
        tell!(
            "coverage {:.3} (window cost {:.3}), diversity {:.3} local, {:.3} global",
            measures.coverage,
            measures.window_cost,
            measures.local_diversity,
            measures.global_diversity
        );
    }
    if let Some(sliding) = &record.sliding {
        tell!(
            "feet in contact: {:.2} units a second before, {:.2} after",
            sliding.before,
            sliding.after
        );
    }
    for part in &record.parts {
        tell!(
            "{}: {:.0} % in runs of a second or more, the longest {:.1} s; {:.2} splices a second",
            part.name,
            100.0 * part.novelty.copied,
            part.novelty.longest_copied_seconds,
            part.novelty.splices_per_second
        );
    }
}
