//! `kinegrad match`: motion from examples.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_capture::Bvh;
use kinegrad_matching::{
    CommonJoints, Example, Fixed, Heading, Job, JointNames, Keyframe, Looping, PartChoice, Preset,
    Settings, separated,
};
use kinegrad_report::check_ending;
use kinegrad_train::{Error, Systems};

use crate::args::MatchArguments;
use crate::io::{Content, exit_code, file_stem, is_bvh, must_be_new, unusable_path, write_all};
use crate::output::unusable;
use crate::{folder, interrupt, output};

mod motions;
mod picture;
mod record;

use motions::{Motion, is_clip};
use record::Record;

/// Advice about a motion that is not usable.
const ADVICE: &str = "match again with another `--seed` or a higher `--coherence`, and move key frames \
                      apart";

/// Generates a motion from examples.
pub fn run(systems: Systems<'_>, arguments: MatchArguments) -> Result<ExitCode, Error> {
    interrupt::end_between_files();
    let record_path = arguments.out.with_extension("json");
    check_outputs(&arguments, &record_path)?;
    let read = arguments.examples.iter();
    let read = read.map(|path| motions::read(systems, path, arguments.up));
    let read: Vec<Motion> = read.collect::<Result<_, _>>()?;
    let first = &read[0];
    for other in &read {
        other.must_have_figures_of(first)?;
    }
    let clip = match is_clip(&arguments.out) {
        true => Some(first.clip.clone().ok_or_else(|| no_clip(&arguments))?),
        false => None,
    };
    let mut job = job(systems, &arguments, first)?;
    let (metres_per_unit, figures) = (first.unit_and_axis.0, first.figures.clone());
    let mut examples: Vec<Example> = read.into_iter().map(|motion| motion.example).collect();
    let common = unify(&arguments, &mut job, &mut examples, figures.len())?;
    let made = job.make(&examples).map_err(unusable)?;
    let features = clip.map(|clip| clip.features(&made.bvh)).transpose()?;
    let record = Record::new(&arguments, &made, common, metres_per_unit);
    let described = serde_json::to_string_pretty(&record).expect("plain data") + "\n";
    let is_unusable = record.is_far() && !arguments.allow_unusable;
    let named = |path: &PathBuf| match is_unusable {
        true => unusable_path(path),
        false => path.clone(),
    };
    let (out, record_path) = (named(&arguments.out), named(&record_path));
    let svg = arguments.svg.as_ref().map(named);
    let outputs = [Some(&out), Some(&record_path), svg.as_ref()];
    for path in outputs.into_iter().flatten() {
        folder::must_be_writable(path)?;
    }
    let content = match &features {
        Some(features) => Content::features(features),
        None if figures.is_empty() => Content::Text(made.bvh.to_text()),
        None => {
            let figures = separated(&made.bvh, &figures).map_err(unusable)?;
            Content::Text(Bvh::figures_to_text(&figures))
        }
    };
    let written = [
        (out.clone(), content),
        (record_path.clone(), Content::Text(described)),
    ];
    interrupt::not_during(|| {
        if let Some(svg) = &svg {
            let names = arguments.examples.iter().map(|path| file_stem(path));
            picture::draw(&made, &names.collect::<Vec<_>>(), metres_per_unit, svg)?;
        }
        write_all(&written)
    })?;
    match arguments.json {
        true => output::json(&record),
        false => {
            for path in outputs.into_iter().flatten() {
                say!("{}", path.display());
            }
            record.summarize();
        }
    }
    record.warn();
    if !arguments.json {
        output::how_to_view(std::slice::from_ref(&out), None);
    }
    Ok(exit_code(is_unusable.into(), "motion", ADVICE))
}

/// Brings motions of different skeletons onto their common joints. `figures`: the number of figures in
/// the first example, if there are several.
fn unify(
    arguments: &MatchArguments,
    job: &mut Job,
    examples: &mut [Example],
    figures: usize,
) -> Result<Option<CommonJoints>, Error> {
    let names = arguments.joint_map.as_deref();
    if let Some(path) = names.filter(|_| figures > 0) {
        let message = format!(
            "`--joint-map {}` with {figures} figures in {}",
            path.display(),
            examples[0].file
        );
        return Err(Error::usage(
            message,
            "files of several figures have the same joints",
        ));
    }
    if figures > 0 {
        return Ok(None);
    }
    let names = names.map(|path| {
        let (text, file) = (read_text(path)?, path.display().to_string());
        JointNames::read(&text, &file).map_err(unusable)
    });
    let names = names.transpose()?;
    let common = job.unify(examples, names.as_ref()).map_err(unusable)?;
    if common.is_some() && is_clip(&arguments.out) {
        let out = &arguments.out;
        let message = format!(
            "`--out {}` with examples of different skeletons",
            out.display()
        );
        let hint = format!("`--out {}`", out.with_extension("bvh").display());
        return Err(Error::usage(message, hint));
    }
    Ok(common)
}

/// The error for a clip as output of an example that is not a clip.
fn no_clip(arguments: &MatchArguments) -> Error {
    let (out, first) = (&arguments.out, &arguments.examples[0]);
    let message = format!(
        "`--out {}` is a clip of joint features, but the example {} is not",
        out.display(),
        first.display()
    );
    let hint = format!("`--out {}`", out.with_extension("bvh").display());
    Error::usage(message, hint)
}

/// Refuses outputs that exist or are also inputs.
fn check_outputs(arguments: &MatchArguments, record: &PathBuf) -> Result<(), Error> {
    let out = &arguments.out;
    if !is_bvh(out) && !is_clip(out) {
        let message = format!("`--out {}` does not end in .bvh or .npy", out.display());
        let hint = format!("`--out {}`", out.with_extension("bvh").display());
        return Err(Error::usage(message, hint));
    }
    if let Some(svg) = &arguments.svg {
        check_ending(svg).map_err(unusable)?;
    }
    let outputs = [Some(out), Some(record), arguments.svg.as_ref()];
    let outputs = outputs.into_iter().flatten();
    let unusable = outputs.clone().map(|path| unusable_path(path));
    let outputs: Vec<PathBuf> = outputs.cloned().chain(unusable).collect();
    let read = files_read(arguments);
    must_be_new(&outputs, &read, arguments.overwrite, "--out")
}

/// The input files of a motion.
fn files_read(arguments: &MatchArguments) -> Vec<PathBuf> {
    let keyframes = &arguments.keyframes;
    let fixed = arguments.fix.iter().map(|(_, path)| path);
    let maps = &arguments.joint_map;
    let named = [&arguments.content, &arguments.parts, maps, keyframes];
    let read = arguments.examples.iter().chain(fixed);
    let mut read: Vec<PathBuf> = read.chain(named.into_iter().flatten()).cloned().collect();
    // An unreadable file of key frames causes an error later.
    if let Some(path) = keyframes
        && let Ok(text) = kinegrad_data::file::read_text(path)
        && let Ok(keyframes) = Keyframe::read(&text, &path.display().to_string())
    {
        let sources = keyframes.iter().flat_map(|keyframe| &keyframe.file);
        read.extend(sources.map(|file| path.with_file_name(file)));
    }
    read
}

/// Reads a BVH file or a clip, with the axis and the number of figures of the `first` example.
fn read(systems: Systems<'_>, path: &Path, first: &Motion) -> Result<Example, Error> {
    let motion = motions::read(systems, path, Some(first.unit_and_axis.1))?;
    motion.must_have_figures_of(first)?;
    Ok(motion.example)
}

fn read_text(path: &Path) -> Result<String, Error> {
    let file = path.display();
    kinegrad_data::file::read_text(path).map_err(|error| {
        let message = format!("{file} cannot be read: {error}");
        Error::usage(message, "give a TOML file; docs/matching.md describes it")
    })
}

fn job(systems: Systems<'_>, arguments: &MatchArguments, first: &Motion) -> Result<Job, Error> {
    let is_paper = arguments.preset == Some(Preset::Paper);
    let parts = arguments.parts.as_deref();
    let parts = match parts.map(|parts| (parts, parts.to_str())) {
        None if is_paper => PartChoice::Automatic,
        None | Some((_, Some("whole"))) => PartChoice::Whole,
        Some((_, Some("auto"))) => PartChoice::Automatic,
        Some((path, _)) => PartChoice::File {
            file: path.display().to_string(),
            text: read_text(path)?,
        },
    };
    let keyframes = match &arguments.keyframes {
        Some(path) => keyframes(systems, path, first)?,
        None => Vec::new(),
    };
    let fixed = arguments.fix.iter().map(|(part, path)| {
        Ok(Fixed {
            part: part.clone(),
            motion: read(systems, path, first)?,
        })
    });
    let content = arguments.content.as_ref();
    let content = content.map(|path| read(systems, path, first));
    Ok(Job {
        settings: settings(arguments)?,
        length: arguments.length,
        seed: arguments.seed,
        content: content.transpose()?,
        up: first.unit_and_axis.1,
        contacts: is_paper,
        heading: heading(arguments),
        adapts: !sets_mixing(arguments),
        parts,
        keyframes,
        fixed: fixed.collect::<Result<_, Error>>()?,
        lock_feet: arguments.lock_feet,
    })
}

/// Presets match as their sources do, as recorded.
fn heading(arguments: &MatchArguments) -> Heading {
    let default = match arguments.preset {
        Some(_) => Heading::World,
        None => Heading::Auto,
    };
    arguments.heading.unwrap_or(default)
}

/// True if an option decides how much is mixed.
fn sets_mixing(arguments: &MatchArguments) -> bool {
    let numbers = [arguments.coherence, arguments.pyr_factor, arguments.sigma];
    let counts = [arguments.patch_size, arguments.num_steps];
    arguments.preset.is_some()
        || arguments.coarse_ratio.is_some()
        || arguments.alpha.is_some()
        || numbers.iter().any(Option::is_some)
        || counts.iter().any(Option::is_some)
}

fn settings(arguments: &MatchArguments) -> Result<Settings, Error> {
    let mut settings = Settings::of(arguments.preset.unwrap_or_default());
    if let Some(coherence) = arguments.coherence {
        settings = settings.with_coherence(coherence)?;
    }
    if arguments.looping {
        settings.looping = match arguments.preset {
            Some(Preset::Published) => Looping::Halves,
            _ => Looping::Even,
        };
    }
    let set = |value: Option<f64>, of: &mut f64| *of = value.unwrap_or(*of);
    set(arguments.pyr_factor, &mut settings.pyr_factor);
    set(arguments.sigma, &mut settings.sigma);
    settings.patch_size = arguments.patch_size.unwrap_or(settings.patch_size);
    settings.num_steps = arguments.num_steps.unwrap_or(settings.num_steps);
    settings.coarse_ratio = arguments.coarse_ratio.unwrap_or(settings.coarse_ratio);
    settings.alpha = arguments.alpha.map_or(settings.alpha, |alpha| alpha.0);
    settings.validate()?;
    Ok(settings)
}

/// The key frames of a file, and the motions beside the file that provide their poses.
fn keyframes(
    systems: Systems<'_>,
    path: &Path,
    first: &Motion,
) -> Result<Vec<(Keyframe, Option<Example>)>, Error> {
    let text = read_text(path)?;
    let keyframes = Keyframe::read(&text, &path.display().to_string()).map_err(unusable)?;
    let with_source = |keyframe: Keyframe| {
        let source = keyframe.file.as_ref();
        let source = source.map(|file| read(systems, &path.with_file_name(file), first));
        Ok((keyframe, source.transpose()?))
    };
    keyframes.into_iter().map(with_source).collect()
}
