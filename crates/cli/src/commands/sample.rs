//! `kinegrad sample`

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_data::{AudioFeatures, DataKind, Dataset, load_audio, write_motion};
use kinegrad_train::checkpoint::{State, Weights};
use kinegrad_train::config::{Config, override_sampling};
use kinegrad_train::device;
use kinegrad_train::systems::BUILT_IN;
use kinegrad_train::systems::cc_motion::evaluate::phrase_seed;
use kinegrad_train::checkpoint::resolve_checkpoint;
use kinegrad_train::systems::cc_motion::generate::{Generator, Sample};

use crate::args::SampleArguments;
use crate::failure::{Failure, UsageError};
use crate::progress::denoising_bar;

/// Draws samples and writes each in two forms.
pub fn run(arguments: SampleArguments) -> Result<ExitCode, Failure> {
    if arguments.count == 0 {
        return Err(UsageError::new("`--count` is 0", "ask for at least one sample").into());
    }
    let path = resolve_checkpoint(&arguments.run, |damaged| tell!("warning: {damaged}"))?;
    let given = [arguments.steps.map(steps), arguments.guidance_scale.map(scale)];
    let config = sampling_of(&path, &arguments.overrides, given)?;
    if BUILT_IN.of(&config)?.0.name() == "gmd" {
        return super::clips::sample(&arguments, &path, &config);
    }
    refuse_goals(&arguments)?;
    let conditions = conditions(&arguments, &config)?;
    let weights = if arguments.no_ema {
        Weights::Model
    } else {
        Weights::Ema
    };
    let (device, _) = device::open(arguments.device.as_deref().unwrap_or(&config.run.device))?;
    let generator = Generator::load(&path, weights, &device)?;

    let several = conditions.len() > 1;
    for (id, condition) in conditions {
        let stem = stem(&arguments.out, several.then_some(id.as_str()));
        let repeated = vec![condition; arguments.count];
        let bar = denoising_bar();
        let samples = generator.sample(
            &repeated,
            &config.sampling,
            phrase_seed(arguments.seed, &id),
            &mut |step, total| {
                bar.set_length(total as u64);
                bar.set_position(step as u64);
            },
        )?;
        bar.finish_and_clear();
        for (index, sample) in samples.iter().enumerate() {
            let stem = match arguments.count {
                1 => stem.clone(),
                _ => format!("{stem}-{index:03}"),
            };
            write(&stem, sample)?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The override of `--steps`.
pub fn steps(steps: usize) -> String {
    format!("sampling.sampler.num_inference_steps={steps}")
}

/// The override of `--guidance-scale`.
pub fn scale(scale: f64) -> String {
    // A whole number is one with a point in TOML.
    format!("sampling.sampler.guidance_scale={scale:?}")
}

/// The config of a checkpoint, with the settings of `sampling` that the command line has.
///
/// # Errors
/// If one of them is of another table, or no draw can work with them.
pub fn sampling_of(
    checkpoint: &Path,
    overrides: &[String],
    given: [Option<String>; 2],
) -> Result<Config, Failure> {
    let saved = BUILT_IN.completed(&State::read(checkpoint)?.config)?;
    let overrides: Vec<String> = overrides.iter().cloned().chain(given.into_iter().flatten()).collect();
    let config = override_sampling(BUILT_IN, &saved, &overrides).map_err(kinegrad_train::Error::from)?;
    let (system, _) = BUILT_IN.of(&config)?;
    system.validate(&config)?;
    Ok(config)
}

/// Refuses what only models of clips understand.
fn refuse_goals(arguments: &SampleArguments) -> Result<(), UsageError> {
    let given = [
        ("--goal", !arguments.goal.is_empty()),
        ("--trajectory-run", arguments.trajectory_run.is_some()),
        ("--text-embedding", arguments.text_embedding.is_some()),
    ];
    match given.into_iter().find(|(_, given)| *given) {
        Some((name, _)) => Err(UsageError::new(
            format!("`{name}` with a run on phrases"),
            "runs of recipe `gmd_motion` and `gmd_trajectory` can be led to goals",
        )),
        None => Ok(()),
    }
}

/// The conditions to draw for, by name, cut to `--frames`.
fn conditions(
    arguments: &SampleArguments,
    config: &Config,
) -> Result<Vec<(String, AudioFeatures)>, Failure> {
    let found = match &arguments.cond {
        Some(path) => vec![("cond".to_string(), load_audio(path)?)],
        None => match &arguments.audio {
            Some(song) => vec![song_condition(song, arguments, config)?],
            None => phrases(arguments, config)?,
        },
    };
    let Some(frames) = arguments.frames else {
        return Ok(found);
    };
    let cut = |(id, audio): (String, AudioFeatures)| {
        if frames == 0 || frames > audio.frames() {
            let message = format!(
                "`--frames` is {frames}, the condition `{id}` has {} frames",
                audio.frames()
            );
            return Err(UsageError::new(message, "ask for 1 up to that many").into());
        }
        Ok((id, audio.slice(0..frames)))
    };
    found.into_iter().map(cut).collect()
}

/// The features of a whole song, from `--start` on: of a part alone they would be normalised
/// otherwise than what the model was trained on.
fn song_condition(
    song: &Path,
    arguments: &SampleArguments,
    config: &Config,
) -> Result<(String, AudioFeatures), Failure> {
    let waveform = kinegrad_audio::decode(song)?;
    let features = kinegrad_audio::extract(&waveform.samples)
        .map_err(|error| super::audio::unusable(song, &error))?;
    let audio = AudioFeatures::from(&features);
    let start = arguments.start * kinegrad_audio::FPS;
    let left = audio.frames() as f64 - start;
    let name = song.file_stem().unwrap_or_default().to_string_lossy();
    if !(start >= 0.0 && left >= 1.0) {
        let message = format!(
            "`--start` is {}, the song {name} has {:.1} seconds",
            arguments.start,
            audio.frames() as f64 / kinegrad_audio::FPS
        );
        return Err(UsageError::new(message, "give a moment within the song").into());
    }
    let start = start.round() as usize;
    let most = arguments.frames.unwrap_or(config.data.target_frames);
    let end = audio.frames().min(start + most.max(1));
    Ok((name.into_owned(), audio.slice(start..end)))
}

fn phrases(
    arguments: &SampleArguments,
    config: &Config,
) -> Result<Vec<(String, AudioFeatures)>, Failure> {
    let mut data = config.data.clone();
    if let Some(source) = &arguments.source {
        data.kind = DataKind::Phrases;
        data.source = Some(source.clone());
        if arguments.phrase.is_none() {
            let hint = "name one with `--phrase ID`; `kinegrad data inspect URI` lists them";
            return Err(UsageError::new("`--source` without `--phrase`", hint).into());
        }
    }
    let dataset = Dataset::open(&data)?;
    let mut found = Vec::new();
    for side in [&dataset.validation, &dataset.train] {
        match &arguments.phrase {
            None if found.is_empty() && !side.is_empty() => found.push(side.get(0)?),
            None => {}
            Some(pattern) => {
                let chosen = side.filter(|id| kinegrad_data::matches(pattern, id));
                found.extend(chosen.load()?);
            }
        }
    }
    if found.is_empty() {
        let wanted = arguments.phrase.as_deref().unwrap_or_default();
        let message = format!("the dataset has no phrase `{wanted}`");
        return Err(
            UsageError::new(message, "`kinegrad data inspect URI` lists the phrases").into(),
        );
    }
    Ok(found
        .into_iter()
        .map(|phrase| (phrase.id.clone(), phrase.audio.clone()))
        .collect())
}

/// PATH without its ending `.npy`, with the phrase's id where there are several.
fn stem(out: &Path, id: Option<&str>) -> String {
    let text = out.to_string_lossy();
    let text = text.strip_suffix(".npy").unwrap_or(&text);
    match id {
        Some(id) => format!("{text}-{id}"),
        None => text.to_string(),
    }
}

fn write(stem: &str, sample: &Sample) -> Result<(), Failure> {
    write_motion(&PathBuf::from(format!("{stem}.raw.npy")), &sample.raw)?;
    let path = PathBuf::from(format!("{stem}.npy"));
    write_motion(&path, &sample.motion)?;
    say!("{}", path.display());
    Ok(())
}
