//! `kinegrad sample` of models of clips.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_data::humanml::{read_embedding, write_features};
use kinegrad_data::write_values;
use kinegrad_motion::goal::Goal;
use kinegrad_motion::humanml::Skeleton;
use kinegrad_motion::metrics::{GoalReport, GoalSample};
use kinegrad_train::checkpoint::{State, Weights};
use kinegrad_train::systems::gmd::{ClipGenerator, ClipRequest, ClipSample, read_goal};
use kinegrad_train::Config;
use kinegrad_train::device;
use kinegrad_train::checkpoint::resolve_checkpoint;

use crate::args::SampleArguments;
use crate::failure::{Failure, UsageError};
use crate::progress::{denoising_bar, on_stage};

/// Units of a BVH file in a metre.
const CENTIMETRES: f64 = 100.0;

/// Draws clips and writes each as joints, features and BVH.
pub fn sample(
    arguments: &SampleArguments,
    checkpoint: &Path,
    config: &Config,
) -> Result<ExitCode, Failure> {
    refuse_phrases(arguments)?;
    if arguments.frames == Some(0) {
        return Err(UsageError::new("`--frames` is 0", "ask for at least one frame").into());
    }
    let mut goals: Vec<Goal> = Vec::with_capacity(arguments.goal.len());
    for path in &arguments.goal {
        goals.push(read_goal(path)?);
    }
    if goals.is_empty() && arguments.trajectory_run.is_some() {
        let hint = "the first stage draws the path to a goal: give `--goal GOAL.toml` too";
        return Err(UsageError::new("`--trajectory-run` without `--goal`", hint).into());
    }
    if let (Some(_), Some(goal)) = (arguments.frames, goals.first()) {
        let message = "`--frames` with `--goal`";
        let hint = format!(
            "the goal says how long the clip is: `frames = {}`",
            goal.frames
        );
        return Err(UsageError::new(message, hint).into());
    }
    let text = arguments.text_embedding.as_deref().map(read_embedding);
    let text = text.transpose()?;
    let requests = requests(arguments, &goals, text.as_deref());
    let frames = match goals.iter().map(|goal| goal.frames).max() {
        Some(frames) => frames,
        None => arguments.frames.unwrap_or(config.data.target_frames),
    };
    let trajectory = arguments.trajectory_run.as_deref();
    let trajectory = trajectory.map(trajectory_checkpoint).transpose()?;
    let weights = weights(arguments.no_ema);
    let (device, _) = device::open(arguments.device.as_deref().unwrap_or(&config.run.device))?;
    let generator = ClipGenerator::load(checkpoint, weights, &device)?;
    let trajectory = match &trajectory {
        Some(checkpoint) => Some(ClipGenerator::load(checkpoint, weights, &device)?),
        None => None,
    };
    let bar = denoising_bar();
    let samples = generator.sample(
        trajectory.as_ref(),
        &requests,
        frames,
        &config.sampling,
        arguments.seed,
        &mut on_stage(&bar),
    )?;
    bar.finish_and_clear();
    let skeleton = config.data.humanml3d.skeleton.skeleton();
    let stem = arguments.out.to_string_lossy();
    let stem = stem.strip_suffix(".npy").unwrap_or(&stem);
    for (index, (sample, request)) in samples.iter().zip(&requests).enumerate() {
        let stem = match samples.len() {
            1 => stem.to_string(),
            _ => format!("{stem}-{index:03}"),
        };
        let frames = request.goal.as_ref().map_or(frames, |goal| goal.frames);
        write(&stem, sample, frames, &skeleton)?;
    }
    report(&samples, &requests, &skeleton);
    Ok(ExitCode::SUCCESS)
}

/// The weights that `--no-ema` leaves.
pub fn weights(no_ema: bool) -> Weights {
    match no_ema {
        true => Weights::Model,
        false => Weights::Ema,
    }
}

/// The checkpoint of a trajectory run.
pub fn trajectory_checkpoint(run: &Path) -> Result<PathBuf, Failure> {
    let checkpoint = resolve_checkpoint(run, |damaged| tell!("warning: {damaged}"))?;
    let recipe = State::read(&checkpoint)?.config.train.recipe;
    if recipe != "gmd_trajectory" {
        let message = format!(
            "`--trajectory-run` is {}, a run of recipe `{recipe}`",
            run.display()
        );
        return Err(UsageError::new(message, "give a run of recipe `gmd_trajectory`").into());
    }
    Ok(checkpoint)
}

fn refuse_phrases(arguments: &SampleArguments) -> Result<(), UsageError> {
    let given = [
        ("--source", arguments.source.is_some()),
        ("--phrase", arguments.phrase.is_some()),
        ("--cond", arguments.cond.is_some()),
        ("--audio", arguments.audio.is_some()),
    ];
    if let Some((name, _)) = given.into_iter().find(|(_, given)| *given) {
        return Err(UsageError::new(
            format!("`{name}` with a run on clips of joint features"),
            "its condition is a text: `--text-embedding FILE#KEY`",
        ));
    }
    Ok(())
}

/// `--count` clips for each goal, or for none.
fn requests(arguments: &SampleArguments, goals: &[Goal], text: Option<&[f32]>) -> Vec<ClipRequest> {
    let request = |goal: Option<&Goal>| ClipRequest {
        goal: goal.cloned(),
        text: text.map(<[f32]>::to_vec),
    };
    match goals.is_empty() {
        true => vec![request(None); arguments.count],
        false => goals
            .iter()
            .flat_map(|goal| vec![request(Some(goal)); arguments.count])
            .collect(),
    }
}

/// `STEM.npy` (joints), `STEM.features.npy`, `STEM.bvh`, and `STEM.path.npy` where a first stage
/// drew a path.
fn write(
    stem: &str,
    sample: &ClipSample,
    frames: usize,
    skeleton: &Skeleton,
) -> Result<(), Failure> {
    let path = PathBuf::from(format!("{stem}.npy"));
    match &sample.features {
        Some(features) => {
            let features = features.slice(0..frames);
            let joints = features.joints();
            let shape = [joints.frames(), joints.joints(), 3];
            write_values(&path, &shape, &joints.to_f32())?;
            write_features(&PathBuf::from(format!("{stem}.features.npy")), &features)?;
            let bvh = joints.to_bvh(skeleton, CENTIMETRES)?;
            let path = PathBuf::from(format!("{stem}.bvh"));
            let written = std::fs::write(&path, bvh.to_text());
            written.map_err(kinegrad_train::Error::io("write", &path))?;
            if let Some(drawn) = &sample.path {
                write_path(&PathBuf::from(format!("{stem}.path.npy")), &drawn[..frames])?;
            }
        }
        None => write_path(&path, &sample.ground[..frames])?,
    }
    say!("{}", path.display());
    Ok(())
}

/// `[frames, 2]`, x and z.
fn write_path(path: &Path, ground: &[[f64; 2]]) -> Result<(), Failure> {
    let values: Vec<f32> = ground.iter().flatten().map(|&value| value as f32).collect();
    Ok(write_values(path, &[ground.len(), 2], &values)?)
}

/// How near the goals the clips have come.
fn report(samples: &[ClipSample], requests: &[ClipRequest], skeleton: &Skeleton) {
    let measured: Vec<GoalSample> = samples
        .iter()
        .zip(requests)
        .filter_map(|(sample, request)| {
            Some(GoalSample {
                goal: request.goal.as_ref()?,
                ground: &sample.ground,
                joints: None,
            })
        })
        .collect();
    if !measured.is_empty() {
        say!(
            "{}",
            GoalReport::compute(&measured, &skeleton.contact_joints())
        );
    }
}
