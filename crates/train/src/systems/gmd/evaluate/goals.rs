//! How well models of clips reach goals taken from held-out clips.

use std::sync::Arc;

use kinegrad_data::humanml::Clip;
use kinegrad_motion::goal::{Goal, Keyframe, Obstacle};
use kinegrad_motion::humanml::{Joints, TEXT_CHANNELS};
use kinegrad_motion::metrics::{GoalReport, GoalSample};
use serde::Serialize;

use super::text_motion::{TextMotion, TextMotionReports};
use crate::config::SamplingConfig;
use crate::error::Error;
use crate::evaluation::OnStep;
use crate::systems::gmd::{ClipGenerator, ClipRequest, GeneratedClip};

/// Radius of the obstacles, metres: a person with some room.
const OBSTACLE_RADIUS: f64 = 0.35;

/// Distance of an obstacle's edge from where the way begins and ends, metres.
const CLEARANCE: f64 = 0.1;

/// Pairs of samples whose distance the diversity is the mean of.
const DIVERSITY_PAIRS: usize = 200;

/// How a goal is derived from a held-out clip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GoalTask {
    /// Number of keyframes, evenly spaced, the last one in the last frame.
    pub keyframes: usize,
    /// Number of discs of 35 cm on the path, evenly spaced in time; those that would cover its
    /// start or end are left out. With obstacles, only the last frame is a keyframe.
    pub obstacles: usize,
    /// Maximum number of frames.
    pub frames: usize,
}

impl GoalTask {
    /// The goal derived from `clip`.
    pub fn goal(&self, clip: &Clip) -> Goal {
        let frames = clip.features.frames().min(self.frames);
        let features = clip.features.slice(0..frames).to_absolute();
        let path = features.root_positions();
        let last = frames - 1;
        let mut goal = Goal::new(frames);
        let keyframe = |frame: usize| {
            let [x, _, z] = path[frame];
            Keyframe { frame, x, z }
        };
        if self.obstacles == 0 {
            let parts = self.keyframes.max(1);
            goal.keyframes = (1..=self.keyframes)
                .map(|k| keyframe(k * last / parts))
                .collect();
            goal.keyframes.dedup_by_key(|keyframe| keyframe.frame);
            return goal;
        }
        goal.keyframes = vec![keyframe(last)];
        let ends = [path[0], path[last]];
        let clear = |[x, _, z]: &[f64; 3]| {
            let far = |[ex, _, ez]: &[f64; 3]| (x - ex).hypot(z - ez) > OBSTACLE_RADIUS + CLEARANCE;
            ends.iter().all(far)
        };
        goal.obstacles = (1..=self.obstacles)
            .map(|k| path[k * last / (self.obstacles + 1)])
            .filter(clear)
            .map(|[x, _, z]| Obstacle::Disc {
                x,
                z,
                radius: OBSTACLE_RADIUS,
            })
            .collect();
        goal
    }
}

/// Settings of an evaluation of goals.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GoalSettings {
    /// How goals are derived.
    pub task: GoalTask,
    /// The sampler, guidance and imputation.
    #[serde(flatten)]
    pub sampling: SamplingConfig,
    /// Seed of the noise.
    pub seed: u64,
}

/// Results of an evaluation of goals.
#[derive(Clone, Debug, Serialize)]
pub struct GoalEvaluation {
    /// Name of the run.
    pub run: String,
    /// Step of its checkpoint.
    pub step: u64,
    /// Name of the run of the trajectory model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trajectory_run: Option<String>,
    /// The settings.
    #[serde(flatten)]
    pub settings: GoalSettings,
    /// The generated clips.
    pub drawn: GoalReport,
    /// The held-out clips, by the same metrics.
    pub real: GoalReport,
    /// How they match their captions, if the evaluator is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub text_motion: Option<TextMotionReports>,
}

/// Generates one clip for each of the `held_out`, all as one batch, and computes their metrics.
///
/// # Errors
/// As [`ClipGenerator::sample`].
pub fn evaluate_goals(
    generator: &ClipGenerator,
    trajectory: Option<&ClipGenerator>,
    held_out: &[Arc<Clip>],
    settings: &GoalSettings,
    evaluator: Option<&TextMotion>,
    on_step: &mut OnStep<'_>,
) -> Result<GoalEvaluation, Error> {
    let task = &settings.task;
    let goals: Vec<Goal> = held_out.iter().map(|clip| task.goal(clip)).collect();
    let asks = task.keyframes + task.obstacles > 0;
    let requests: Vec<ClipRequest> = held_out
        .iter()
        .zip(&goals)
        .map(|(clip, goal)| ClipRequest {
            goal: asks.then(|| goal.clone()),
            text: embedding(clip),
        })
        .collect();
    let frames = goals.iter().map(|goal| goal.frames).max().unwrap_or(0);
    let samples = generator.sample(
        trajectory,
        &requests,
        frames,
        &settings.sampling,
        settings.seed,
        on_step,
    )?;
    let drawn: Option<Vec<_>> = samples
        .iter()
        .map(|sample| sample.features.as_ref())
        .collect();
    let text_motion = match (evaluator, drawn) {
        (Some(evaluator), Some(drawn)) => {
            let real: Vec<&Clip> = held_out.iter().map(Arc::as_ref).collect();
            Some(evaluator.reports(&drawn, &real, settings.seed)?)
        }
        _ => None,
    };
    let real: Vec<GeneratedClip> = held_out
        .iter()
        .zip(&goals)
        .map(|(clip, goal)| {
            let features = clip.features.slice(0..goal.frames).to_absolute();
            GeneratedClip::of(features)
        })
        .collect();
    let drawn = Measured::new(&samples, &goals);
    let real = Measured::new(&real, &goals);
    Ok(GoalEvaluation {
        run: generator.config().run.name.clone(),
        step: generator.step(),
        trajectory_run: trajectory.map(|t| t.config().run.name.clone()),
        drawn: drawn.report(generator, &goals, &real),
        real: real.report(generator, &goals, &real),
        text_motion,
        settings: settings.clone(),
    })
}

/// The embedding of a clip's first caption.
pub fn embedding(clip: &Clip) -> Option<Vec<f32>> {
    let embedding = clip.captions.first()?.embedding.as_deref()?;
    debug_assert_eq!(embedding.len(), TEXT_CHANNELS);
    Some(embedding.to_vec())
}

/// Clips in the form that metrics take.
struct Measured<'a> {
    samples: &'a [GeneratedClip],
    joints: Vec<Option<Joints>>,
    /// Mean position of each joint about the root: what diversity and Fréchet distance compare.
    features: Vec<Vec<f64>>,
}

impl<'a> Measured<'a> {
    fn new(samples: &'a [GeneratedClip], goals: &[Goal]) -> Self {
        let cut = samples.iter().zip(goals).map(|(sample, goal)| {
            let features = sample.features.as_ref()?;
            Some(features.slice(0..goal.frames))
        });
        let cut: Vec<_> = cut.collect();
        Self {
            samples,
            joints: cut.iter().map(|f| f.as_ref().map(|f| f.joints())).collect(),
            features: cut
                .iter()
                .flatten()
                .map(|features| {
                    // Of the body alone: where the root goes is what the goal says.
                    let body = features.layout().positions();
                    let frames = features.frames() as f64;
                    body.map(|channel| {
                        let sum: f64 = (0..features.frames())
                            .map(|t| f64::from(features.frame(t)[channel]))
                            .sum();
                        sum / frames
                    })
                    .collect()
                })
                .collect(),
        }
    }

    fn report(&self, generator: &ClipGenerator, goals: &[Goal], real: &Self) -> GoalReport {
        let skeleton = generator.config().data.humanml3d.skeleton.skeleton();
        let samples = self.samples.iter().zip(goals).zip(&self.joints);
        let samples: Vec<GoalSample> = samples
            .map(|((sample, goal), joints)| GoalSample {
                goal,
                ground: &sample.ground,
                joints: joints.as_ref(),
            })
            .collect();
        let feet = skeleton.contact_joints();
        // Left and right toe: the second of each pair of contacts.
        let fps = skeleton.description().fps;
        let report = GoalReport::compute(&samples, fps, &[feet[1], feet[3]]);
        let seed = generator.config().run.seed;
        report.with_features(&self.features, &real.features, DIVERSITY_PAIRS, seed)
    }
}
