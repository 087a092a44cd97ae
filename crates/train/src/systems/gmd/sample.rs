//! Sampling clips conditioned on text, with or without goals.

mod along;
mod items;

use std::path::PathBuf;

use kinegrad_motion::goal::Goal;
use kinegrad_motion::humanml::Skeleton;
use kinegrad_motion::metrics::{GoalReport, GoalSample};

use self::along::Along;
use super::Gmd;
use super::generate::{
    ClipGenerator, ClipRequest, GeneratedClip, drawn_frames, read_goal_and_digest,
};
use super::networks::{footprint, text_input};
use super::recipe_name::RecipeName;
use crate::TrainedModel;
use crate::captions::{ClipText, text_of};
use crate::checkpoint::SavedCheckpoint;
use crate::error::Error;
use crate::memory::must_fit;
use crate::sampling::{
    BVH, BatchRecord, Condition, Contents, Drawn, FEATURES, GoalRecord, MOTION, Names, Receiver,
    Record, Remark, Request, SamplerRecord, clip_files,
};
use crate::system::System as _;

/// Extension of the ground path of the first stage.
const PATH: &str = ".path.npy";

/// Generates the requested clips as one batch: joints, features and BVH of a motion model, the path
/// of a trajectory model. Returns how near the goals the clips have come.
///
/// # Errors
/// If a condition cannot be used, or a checkpoint cannot be read.
pub(super) fn sample(
    trained: &TrainedModel,
    request: &Request,
    receiver: &mut dyn Receiver,
) -> Result<Option<Remark>, Error> {
    let conditions = &request.conditions;
    conditions.refuse(
        &[
            "--audio-features",
            "--audio",
            "--continue-from",
            "--keep",
            "--style",
            "--history",
            "--prompts",
        ],
        "a run on clips of joint features",
        "its condition is a text: `--text`, `--text-embedding FILE#KEY`, or `--item ID` for a clip's \
         caption",
    )?;
    if request.post_processing.is_some() {
        return Err(Error::usage(
            "`--postprocess` with a run on clips of joint features",
            "their samples are not post-processed: leave it out",
        ));
    }
    if let Some(count) = conditions.held_out {
        return items::for_held_out(trained, count, request.seed, receiver);
    }
    if conditions.item.is_some() || conditions.source.is_some() {
        return items::for_items(trained, request, receiver);
    }
    let mut goals = Vec::with_capacity(conditions.goals.len());
    let mut files = Vec::with_capacity(conditions.goals.len());
    for path in &conditions.goals {
        let (goal, digest) = read_goal_and_digest(path)?;
        goals.push(goal);
        files.push(GoalRecord {
            file: path.clone(),
            sha256: digest.to_string(),
        });
    }
    let along = match &conditions.path {
        Some(file) => {
            let frames = request
                .frames
                .unwrap_or(trained.config().data.target_frames);
            Some(Along::read(file, trained, frames)?)
        }
        None => None,
    };
    if goals.is_empty() && along.is_none() && conditions.trajectory.is_some() {
        let hint = "the first stage generates a path for a goal: pass `--goal GOAL.toml` too";
        return Err(Error::usage("`--trajectory-run` without `--goal`", hint));
    }
    if let (Some(_), Some(goal)) = (request.frames, goals.first()) {
        let hint = format!(
            "the goal says how long the clip is: `frames = {}`",
            goal.frames
        );
        return Err(Error::usage(
            "`--frames` or `--seconds` with `--goal`",
            hint,
        ));
    }
    let sources = conditions
        .goals
        .iter()
        .chain(along.as_ref().map(Along::file));
    let sources: Vec<PathBuf> = sources.cloned().collect();
    goals.extend(along.as_ref().map(Along::goal));
    if conditions.is_empty() {
        receiver.note("no condition given: drawing without a text and without a goal");
    }
    let skeleton = trained.config().data.humanml3d.skeleton.skeleton();
    let trajectory = conditions.trajectory.clone();
    let trajectory = trajectory
        .map(|saved| trajectory_model(trained, saved))
        .transpose()?;
    let mut inputs = vec![text_input(trained.config())];
    inputs.extend(trajectory.iter().map(|model| text_input(model.config())));
    let text = text_of(conditions, &inputs, &trained.device)?;
    let frames = match goals.iter().map(|goal| goal.frames).max() {
        Some(frames) => frames,
        None => request
            .frames
            .unwrap_or(trained.config().data.target_frames),
    };
    let clips = request.count.saturating_mul(goals.len().max(1));
    for (path, goal) in sources.iter().zip(&goals) {
        for doubt in goal.doubts(skeleton.description().fps) {
            receiver.warning(&format!("{}: {doubt}", path.display()));
        }
    }
    if let Some(along) = &along
        && let Some(warning) = along.too_fast(trained)
    {
        receiver.warning(&warning);
    }
    let hint = "all clips are drawn as one batch: ask for fewer (`--count`, `--goal`), or shorter";
    must_fit_as_batch(trained, clips, frames, !goals.is_empty(), hint)?;
    let names = Names {
        stems: vec![String::new()],
        count: clips,
    };
    let extensions: &[&str] = match RecipeName::of(trained.config()) {
        RecipeName::Trajectory => &[MOTION],
        RecipeName::Motion => &[MOTION, FEATURES, BVH, PATH],
    };
    receiver.announced(&names, extensions)?;
    let requests = requests(request.count, frames, &goals, text.as_ref());
    let trajectory = trajectory.as_ref().map(ClipGenerator::load).transpose()?;
    let samples = ClipGenerator::load(trained)?.sample(
        trajectory.as_ref(),
        &requests,
        &trained.config().sampling,
        request.seed,
        &mut |stage, done, all| receiver.advance(stage, done, all),
    )?;
    let mut remarks = Vec::new();
    for (index, (sample, clip)) in samples.iter().zip(&requests).enumerate() {
        let name = names.of("", index);
        let frames = clip.goal.as_ref().map_or(frames, |goal| goal.frames);
        let steered = clip.goal.is_some();
        let goal = files.get(index / request.count);
        let record = record(trained, request.seed, index, frames, &skeleton);
        let record = Record {
            sampler: SamplerRecord {
                steering: steered.then(|| trained.config().sampling.steering.clone()),
                ..record.sampler
            },
            condition: Condition {
                goal: goal.map(|goal| goal.file.clone()),
                goal_content: clip.goal.clone(),
                goal_sha256: goal.map(|goal| goal.sha256.clone()),
                trajectory: conditions
                    .trajectory
                    .as_ref()
                    .map(|saved| saved.path.clone()),
                text: conditions.text.clone(),
                clip: conditions.clip.clone(),
                text_embedding: conditions.text_embedding.clone(),
                ..Condition::default()
            },
            batch: steered.then(|| BatchRecord {
                count: request.count,
                goals: files.clone(),
            }),
            ..record
        };
        let mut drawn = drawn(name, sample, &skeleton, record);
        if let Some(along) = &along {
            remarks.push(along.place(&mut drawn, sample, &skeleton)?);
        }
        receiver.drawn(drawn)?;
    }
    Ok(match along {
        Some(_) => Some(Remark::Text(remarks.join("\n"))),
        None => report(&samples, &requests, &skeleton).map(Remark::Text),
    })
}

/// Rejects clips that take more memory than is free as one batch.
fn must_fit_as_batch(
    trained: &TrainedModel,
    clips: usize,
    frames: usize,
    guided: bool,
    hint: &str,
) -> Result<(), Error> {
    let networks = footprint(trained.config(), drawn_frames(trained.config(), frames))?;
    must_fit(
        &format!("drawing {clips} clips of {frames} frames"),
        networks.of_sampling(clips, guided, trained.on_host),
        hint,
    )
}

/// The trajectory model of a checkpoint, beside the motion model `trained`.
///
/// # Errors
/// [`Error::Usage`] for a checkpoint of another recipe.
pub(super) fn trajectory_model(
    trained: &TrainedModel,
    saved: SavedCheckpoint,
) -> Result<TrainedModel, Error> {
    let recipe = &saved.state.config.train.recipe;
    if recipe == RecipeName::Trajectory.name() {
        return Ok(trained.beside(saved.of(&Gmd)?));
    }
    let message = format!(
        "`--trajectory-run` is {}, a run of recipe `{recipe}`",
        saved.path.display()
    );
    Err(Error::usage(
        message,
        "give a run of recipe `gmd_trajectory`",
    ))
}

/// `count` clips for each goal, or of `frames` frames for none.
fn requests(
    count: usize,
    frames: usize,
    goals: &[Goal],
    text: Option<&ClipText>,
) -> Vec<ClipRequest> {
    let request = |goal: Option<&Goal>| ClipRequest {
        frames: goal.map_or(frames, |goal| goal.frames),
        goal: goal.cloned(),
        text: text.cloned(),
    };
    match goals.is_empty() {
        true => vec![request(None); count],
        false => goals
            .iter()
            .flat_map(|goal| vec![request(Some(goal)); count])
            .collect(),
    }
}

/// What every clip's record says.
fn record(
    trained: &TrainedModel,
    seed: u64,
    index: usize,
    frames: usize,
    skeleton: &Skeleton,
) -> Record {
    let record = Record::new(Gmd.name(), trained, seed);
    Record {
        index,
        frames,
        fps: skeleton.description().fps,
        sampler: SamplerRecord {
            padding: Some(trained.config().sampling.padding),
            ..record.sampler
        },
        ..record
    }
}

/// The files of a clip, cut to the record's length.
fn drawn(name: String, sample: &GeneratedClip, skeleton: &Skeleton, record: Record) -> Drawn {
    let frames = record.frames;
    let mut files = match &sample.features {
        None => vec![(MOTION, path(&sample.ground[..frames]))],
        Some(features) => {
            let features = features.slice(0..frames);
            let joints = features.joints();
            clip_files(features, joints, skeleton)
        }
    };
    if let Some(drawn) = &sample.path {
        files.push((PATH, path(&drawn[..frames])));
    }
    Drawn {
        name,
        files,
        record,
    }
}

/// `[frames, 2]`, x and z.
fn path(ground: &[[f64; 2]]) -> Contents {
    Contents::Array {
        shape: vec![ground.len(), 2],
        values: ground.iter().flatten().map(|&value| value as f32).collect(),
    }
}

/// How near the goals the clips have come.
fn report(
    samples: &[GeneratedClip],
    requests: &[ClipRequest],
    skeleton: &Skeleton,
) -> Option<String> {
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
    let (fps, feet) = (skeleton.description().fps, skeleton.contact_joints());
    (!measured.is_empty()).then(|| GoalReport::compute(&measured, fps, &feet).to_string())
}
