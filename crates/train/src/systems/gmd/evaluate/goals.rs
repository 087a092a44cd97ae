//! How well models of clips reach goals taken from held-out clips.

use std::iter::{repeat, repeat_n};
use std::sync::Arc;

use kinegrad_data::humanml::{Clip, ClipLabels};
use kinegrad_motion::goal::Goal;
use kinegrad_motion::humanml::{Features, Joints};
use kinegrad_motion::metrics::text_motion::TextMotionReport;
use kinegrad_motion::metrics::{FeatureMoments, GoalReport, GoalSample, frechet_distance};
use kinegrad_random::{Key, Purpose};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{GoalTask, Replicated, VarietyReport};
use crate::clips::captions::ClipText;
use crate::clips::evaluator::{TextMotionEvaluator, TextMotionReports};
use crate::config::SamplingConfig;
use crate::error::Error;
use crate::evaluation::OnStep;
use crate::sampling::item_seed;
use crate::systems::gmd::generate::keys;
use crate::systems::gmd::{ClipGenerator, ClipRequest, GeneratedClip, SteeringConfig};
use crate::together::Together;

/// Pairs of samples whose distance the diversity is the mean of.
const DIVERSITY_PAIRS: usize = 200;

/// Divisions of the held-out clips into halves, of which the mean distance is taken.
const DIVISIONS: u64 = 20;

/// Settings of an evaluation of goals.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GoalSettings {
    /// How goals are derived.
    pub task: GoalTask,
    /// The sampler.
    #[serde(flatten)]
    pub sampling: SamplingConfig,
    /// Guidance and imputation.
    pub steering: SteeringConfig,
    /// Seed of the noise, and of the frames that are keyframes.
    pub seed: u64,
    /// Clips that are drawn together. Guidance divides by the keyframes of a batch.
    pub batch_size: usize,
    /// Evaluations, each with a seed of its own: this one and those after it.
    pub replications: usize,
    /// Number of clips of which several are drawn, to see how much they differ; 0 for none.
    pub variety_clips: usize,
    /// How many are drawn of each.
    pub variety_repeats: usize,
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
    pub drawn: Replicated<GoalReport>,
    /// The held-out clips, by the same metrics.
    pub real: Replicated<GoalReport>,
    /// How they match their captions, if the evaluator is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub text_motion: Option<ReplicatedTextMotion>,
    /// How much several clips of one condition differ, where that is asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub variety: Option<Replicated<VarietyReport>>,
}

/// How generated and real motion match their captions.
#[derive(Clone, Debug, Serialize)]
pub struct ReplicatedTextMotion {
    /// The generated clips.
    pub drawn: Replicated<TextMotionReport>,
    /// The held-out clips.
    pub real: Replicated<TextMotionReport>,
}

/// What is evaluated, and by what.
#[derive(Clone, Copy)]
pub struct Models<'a> {
    /// Draws the clips.
    pub generator: &'a ClipGenerator,
    /// Draws the ground paths of the first of two stages.
    pub trajectory: Option<&'a ClipGenerator>,
    /// Says how clips match their captions.
    pub evaluator: Option<&'a dyn TextMotionEvaluator>,
    /// What clips are labelled with.
    pub labels: &'a ClipLabels,
}

/// One replication.
struct Replication {
    drawn: GoalReport,
    real: GoalReport,
    text_motion: Option<TextMotionReports>,
    variety: Option<VarietyReport>,
}

/// Generates one clip for each of the `held_out` and computes their metrics, in every replication.
/// The sample of a clip depends on the seed, its id and, with goals, on the batch that it is drawn
/// in. Ranks draw some batches each, and all of them find the same.
///
/// # Errors
/// As [`ClipGenerator::sample`].
pub fn evaluate_goals(
    models: Models<'_>,
    held_out: &[Arc<Clip>],
    settings: &GoalSettings,
    together: &Together,
    on_step: &mut OnStep<'_>,
) -> Result<GoalEvaluation, Error> {
    let count = settings.replications;
    let mut replications = Vec::with_capacity(count);
    for number in 0..count {
        let seed = settings.seed.wrapping_add(number as u64);
        replications.push(replicate(
            models,
            held_out,
            settings,
            seed,
            together,
            &mut |stage, done, all| on_step(stage, number * all + done, count * all),
        )?);
    }
    fn of<'a, T>(each: impl Iterator<Item = &'a T>) -> Replicated<T>
    where
        T: Clone + Serialize + DeserializeOwned + 'a,
    {
        Replicated::of(&each.cloned().collect::<Vec<T>>())
    }
    let text_motion: Option<Vec<&TextMotionReports>> = replications
        .iter()
        .map(|each| each.text_motion.as_ref())
        .collect();
    let variety: Option<Vec<&VarietyReport>> = replications
        .iter()
        .map(|each| each.variety.as_ref())
        .collect();
    Ok(GoalEvaluation {
        variety: variety.map(|each| of(each.into_iter())),
        run: models.generator.config().run.name.clone(),
        step: models.generator.step(),
        trajectory_run: models.trajectory.map(|t| t.config().run.name.clone()),
        drawn: of(replications.iter().map(|each| &each.drawn)),
        real: of(replications.iter().map(|each| &each.real)),
        text_motion: text_motion.map(|each| ReplicatedTextMotion {
            drawn: of(each.iter().map(|reports| &reports.drawn)),
            real: of(each.iter().map(|reports| &reports.real)),
        }),
        settings: settings.clone(),
    })
}

/// One replication, by `seed`.
fn replicate(
    models: Models<'_>,
    held_out: &[Arc<Clip>],
    settings: &GoalSettings,
    seed: u64,
    together: &Together,
    on_step: &mut OnStep<'_>,
) -> Result<Replication, Error> {
    let Models {
        generator,
        trajectory,
        evaluator,
        labels,
    } = models;
    let task = &settings.task;
    let goal = |clip: &Arc<Clip>| task.goal(clip, seed);
    let goals: Vec<Goal> = held_out.iter().map(goal).collect();
    let asks = task.keyframes + task.obstacles > 0;
    let clips: Vec<(&Arc<Clip>, &Goal)> = held_out.iter().zip(&goals).collect();
    let draw = |clips: &[(&Arc<Clip>, &Goal)], repeats: usize, on_step: &mut OnStep<'_>| {
        let all = clips.iter().flat_map(|(clip, goal)| {
            let request = ClipRequest {
                frames: goal.frames,
                goal: asks.then(|| Goal::clone(goal)),
                text: ClipText::of(clip),
            };
            repeat_n(request, repeats).zip(keys(item_seed(seed, &clip.id), repeats))
        });
        let (requests, noise): (Vec<_>, Vec<_>) = all.unzip();
        let batches: Vec<_> = requests
            .chunks(settings.batch_size)
            .zip(noise.chunks(settings.batch_size))
            .collect();
        let samples = together.each(batches.len(), |batch| {
            let [before, count] = together.own_of(batch, batches.len());
            let (requests, noise) = batches[batch];
            generator.sample_keyed(
                trajectory,
                requests,
                &settings.sampling,
                noise,
                &mut |stage, done, all| on_step(stage, before * all + done, count * all),
            )
        })?;
        Ok::<_, Error>(samples.concat())
    };
    let samples = draw(&clips, 1, on_step)?;
    // Evenly from all: clips beside each other are of one kind.
    let taken = settings.variety_clips.min(clips.len());
    let varied = (0..taken).map(|index| clips[index * clips.len() / taken]);
    let varied: Vec<_> = varied.collect();
    let varied = &varied[..];
    let variety = match varied.is_empty() {
        true => None,
        false => {
            let repeats = settings.variety_repeats;
            let goals: Vec<&Goal> = varied.iter().map(|(_, goal)| *goal).collect();
            let samples = draw(varied, repeats, on_step)?;
            Some(VarietyReport::compute(
                &samples, &goals, repeats, evaluator, seed,
            )?)
        }
    };
    let real = clips.iter().map(|(clip, goal)| {
        let features = clip.features.slice(0..goal.frames).to_absolute();
        GeneratedClip::of(features)
    });
    let real: Vec<GeneratedClip> = real.collect();
    let drawn = Measured::new(&samples, &goals);
    let real = Measured::new(&real, &goals);
    let text_motion = match (evaluator, drawn.cut.len() == held_out.len()) {
        (Some(evaluator), true) => {
            let captions: Vec<&Clip> = held_out.iter().map(Arc::as_ref).collect();
            Some(evaluator.reports(&drawn.cut, &real.cut, &captions, labels, seed)?)
        }
        _ => None,
    };
    Ok(Replication {
        drawn: drawn.report(generator, &goals, &real),
        real: GoalReport {
            // From itself it is none: the distance that as many clips of the same kind have.
            frechet_distance: between_halves(&real.features, seed),
            ..real.report(generator, &goals, &real)
        },
        text_motion,
        variety,
    })
}

/// The mean distance between two halves of the feature vectors, over [`DIVISIONS`] divisions at
/// random. Every second one would not do: clips beside each other in a list are often of one take,
/// so that both halves would be the same.
fn between_halves(features: &[Vec<f64>], seed: u64) -> Option<f64> {
    let key = Key::new(seed, Purpose::Halves);
    let distance = |division| {
        let order = key.at(division).permutation(features.len());
        let (one, other) = order.split_at(features.len() / 2);
        let moments = |half: &[usize]| {
            let half: Vec<Vec<f64>> = half.iter().map(|&i| features[i].clone()).collect();
            FeatureMoments::compute(&half)
        };
        let (one, other) = moments(one).zip(moments(other))?;
        Some(frechet_distance(&one, &other))
    };
    let distances: Option<Vec<f64>> = (0..DIVISIONS).map(distance).collect();
    Some(distances?.iter().sum::<f64>() / DIVISIONS as f64)
}

/// Clips in the form that metrics take, generated and real ones alike: cut to their goals' lengths.
struct Measured<'a> {
    samples: &'a [GeneratedClip],
    /// None of a trajectory model.
    cut: Vec<Features>,
    joints: Vec<Joints>,
    /// Mean position of each joint about the root: what diversity and Fréchet distance compare.
    features: Vec<Vec<f64>>,
}

impl<'a> Measured<'a> {
    fn new(samples: &'a [GeneratedClip], goals: &[Goal]) -> Self {
        let cut = samples.iter().zip(goals).filter_map(|(sample, goal)| {
            let features = sample.features.as_ref()?;
            Some(features.slice(0..goal.frames))
        });
        let cut: Vec<Features> = cut.collect();
        Self {
            samples,
            joints: cut.iter().map(Features::joints).collect(),
            features: cut.iter().map(mean_positions).collect(),
            cut,
        }
    }

    fn report(&self, generator: &ClipGenerator, goals: &[Goal], real: &Self) -> GoalReport {
        let skeleton = generator.config().data.humanml3d.skeleton.skeleton();
        let bodies = self.joints.iter().map(Some).chain(repeat(None));
        let samples = self.samples.iter().zip(goals).zip(bodies);
        let samples: Vec<GoalSample> = samples
            .map(|((sample, goal), joints)| GoalSample {
                goal,
                ground: &sample.ground,
                joints,
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

/// The mean over time of each joint's position about the root. Where the root goes is what the goal
/// says.
fn mean_positions(features: &Features) -> Vec<f64> {
    let frames = features.frames();
    let body = features.layout().positions();
    let mean = |channel| {
        let values = (0..frames).map(|t| f64::from(features.frame(t)[channel]));
        values.sum::<f64>() / frames as f64
    };
    body.map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_drawn_at_random() {
        // Every number twice, side by side, as mirrored or neighbouring clips of a take are.
        let normals = Key::new(4, Purpose::Synthetic).normals(60);
        let pairs = normals.iter().flat_map(|&value| [f64::from(value); 2]);
        let features: Vec<Vec<f64>> = pairs.map(|value| vec![value]).collect();
        let distance = between_halves(&features, 1).expect("enough");
        assert!(distance > 1e-3, "every second one would be 0: {distance}");
        assert_eq!(between_halves(&features, 1), Some(distance));
        assert_ne!(between_halves(&features, 2), Some(distance));
        for few in 0..4 {
            assert_eq!(between_halves(&features[..few], 1), None);
        }
        assert!(between_halves(&features[..4], 1).is_some());
    }
}
