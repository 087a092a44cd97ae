//! Metrics of samples for goals that are derived from held-out clips.

use std::iter::{repeat, repeat_n};
use std::sync::Arc;

use kinegrad_data::humanml::{Clip, ClipLabels};
use kinegrad_motion::goal::Goal;
use kinegrad_motion::humanml::{Features, Joints};
use kinegrad_motion::metrics::text_motion::TextMotionReport;
use kinegrad_motion::metrics::{FeatureMoments, GoalReport, GoalSample, frechet_distance};
use kinegrad_random::{Key, Purpose};
use kinegrad_train::Error;
use kinegrad_train::clips::captions::ClipText;
use kinegrad_train::clips::evaluator::TextMotionReports;
use kinegrad_train::evaluation::{
    EvaluationRequest, Group, Metrics, OnStep, Replicated, Results, for_each_item, replicate,
    with_sampling,
};
use kinegrad_train::sampling::{GroundRecord, item_seed};
use serde_json::json;

use super::{GoalTask, VarietyReport};
use crate::generate::{GroundBounds, keys};
use crate::{ClipGenerator, ClipRequest, GeneratedClip, GmdConfig};

const DIVERSITY_PAIRS: usize = 200;

/// Number of divisions of the held-out clips into halves; the distance is the mean over divisions.
const DIVISIONS: u64 = 20;

pub(super) struct GoalEvaluation<'a> {
    pub request: &'a EvaluationRequest,
    pub task: GoalTask,
    pub held_out: &'a [Arc<Clip>],
    pub labels: &'a ClipLabels,
    pub generator: &'a ClipGenerator,
    /// Generates the ground paths of the first stage.
    pub trajectory: Option<&'a ClipGenerator>,
}

struct Replication {
    samples: GoalReport,
    real: GoalReport,
    /// The root paths of samples and of real clips.
    grounds: [Vec<GroundRecord>; 2],
    text_motion: Option<TextMotionReports>,
    variety: Option<VarietyReport>,
}

impl GoalEvaluation<'_> {
    fn own(&self) -> &GmdConfig {
        self.generator.config().own()
    }

    /// Generates a clip for each held-out clip and computes the metrics, in every replication. A
    /// sample depends on the seed and the held-out clip's id; with goals, also on the sample's
    /// batch.
    pub fn run(&self, on_step: &mut OnStep<'_>) -> Result<Results, Error> {
        let settings = &self.own().evaluation;
        let count = settings.replications;
        let replications = replicate(count, self.request.seed, on_step, |seed, on_step| {
            self.replicate(seed, on_step)
        })?;
        let all = || replications.iter();
        let samples = Replicated::of_all(all().map(|each| Some(each.samples.clone())));
        let real = Replicated::of_all(all().map(|each| Some(each.real.clone())));
        let (samples, real) = samples.zip(real).expect("one or more");
        let text_motion = |of: fn(&TextMotionReports) -> &TextMotionReport| {
            Replicated::of_all(all().map(|each| each.text_motion.as_ref().map(of).cloned()))
        };
        let text_motion = text_motion(|both| &both.sampled).zip(text_motion(|both| &both.real));
        let variety = Replicated::of_all(all().map(|each| each.variety.clone()));
        let mut remarks = Vec::new();
        if let Some((samples, real)) = &text_motion {
            let run = &self.generator.config().run.name;
            remarks.push(format!("{run}: {}", samples.mean));
            remarks.push(format!("held out: {}", real.mean));
        }
        let groups = |goals: &Replicated<GoalReport>, variety: Option<&dyn Metrics>| {
            let variety = variety.map(|variety| Group::new("variety", "", variety));
            [Group::new("goals", "", goals)]
                .into_iter()
                .chain(variety)
                .collect()
        };
        // Real motion has one clip of each condition.
        let no_variety = variety.as_ref().map(|variety| VarietyReport {
            trajectory_diversity: None,
            multimodality: None,
            ..variety.mean
        });
        let of_samples = groups(&samples, variety.as_ref().map(|each| each as &dyn Metrics));
        let of_real = groups(&real, no_variety.as_ref().map(|each| each as &dyn Metrics));
        let mut json = json!({
            "task": self.task,
            "batch_size": settings.batch_size,
            "replications": count,
            "variety_clips": settings.variety_clips,
            "variety_repeats": settings.variety_repeats,
            "sampled": samples,
            "real": real,
        });
        json["steering"] = json!(self.own().steering);
        if let Some(trajectory) = self.trajectory {
            json["trajectory_run"] = json!(trajectory.config().run.name);
        }
        if let Some((samples, real)) = &text_motion {
            json["text_motion"] = json!({ "sampled": samples, "real": real });
        }
        if let Some(variety) = &variety {
            json["variety"] = json!(variety);
        }
        Ok(Results {
            json: with_sampling(json, &self.generator.config().sampling),
            facts: Vec::new(),
            samples: Some(of_samples),
            real: of_real,
            verdict: vec![verdict(&replications)],
            remarks,
        })
    }

    /// `repeats` samples for each clip and its goal, in batches.
    fn sample(
        &self,
        clips: &[(&Arc<Clip>, &Goal)],
        repeats: usize,
        seed: u64,
        on_step: &mut OnStep<'_>,
    ) -> Result<Vec<GeneratedClip>, Error> {
        let with_goals = self.task.keyframes + self.task.obstacles > 0;
        let all = clips.iter().flat_map(|(clip, goal)| {
            let request = ClipRequest {
                frames: goal.frames,
                goal: with_goals.then(|| Goal::clone(goal)),
                text: ClipText::of(clip),
            };
            repeat_n(request, repeats).zip(keys(item_seed(seed, &clip.id), repeats))
        });
        let (requests, noise): (Vec<_>, Vec<_>) = all.unzip();
        let size = self.own().evaluation.batch_size;
        let batches: Vec<_> = requests.chunks(size).zip(noise.chunks(size)).collect();
        let (group, sampling) = (&self.request.group, &self.generator.config().sampling);
        let samples = for_each_item(group, batches.len(), on_step, |batch, on_step| {
            let (requests, noise) = batches[batch];
            self.generator
                .sample(self.trajectory, requests, sampling, noise, on_step)
        })?;
        Ok(samples.concat())
    }

    fn replicate(&self, seed: u64, on_step: &mut OnStep<'_>) -> Result<Replication, Error> {
        let (held_out, evaluator) = (self.held_out, self.request.evaluator.as_deref());
        let settings = &self.own().evaluation;
        let goals = held_out.iter().map(|clip| self.task.goal(clip, seed));
        let goals: Vec<Goal> = goals.collect();
        let clips: Vec<(&Arc<Clip>, &Goal)> = held_out.iter().zip(&goals).collect();
        let samples = self.sample(&clips, 1, seed, on_step)?;
        // Evenly spaced clips, because neighboring clips are similar.
        let count = settings.variety_clips.min(clips.len());
        let varied = (0..count).map(|index| clips[index * clips.len() / count]);
        let varied: Vec<_> = varied.collect();
        let mut variety = None;
        if !varied.is_empty() {
            let repeats = settings.variety_repeats;
            let samples = self.sample(&varied, repeats, seed, on_step)?;
            variety = Some(VarietyReport::compute(&samples, repeats, evaluator, seed)?);
        }
        let real = clips.iter().map(|(clip, goal)| {
            GeneratedClip::of(clip.features.slice(0..goal.frames).to_absolute())
        });
        let real: Vec<GeneratedClip> = real.collect();
        let bounds = GroundBounds::of_generator(self.generator);
        let grounds = |clips: &[GeneratedClip]| {
            let each = clips.iter().zip(&goals);
            each.map(|(clip, goal)| bounds.measured(clip, Some(goal)))
                .collect()
        };
        let grounds = [grounds(&samples), grounds(&real)];
        let (samples, real) = (Measured::new(&samples), Measured::new(&real));
        let text_motion = match (evaluator, samples.clips.len() == held_out.len()) {
            (Some(evaluator), true) => {
                let captions: Vec<&Clip> = held_out.iter().map(Arc::as_ref).collect();
                Some(evaluator.reports(
                    &samples.clips,
                    &real.clips,
                    &captions,
                    self.labels,
                    seed,
                )?)
            }
            _ => None,
        };
        Ok(Replication {
            samples: samples.report(self.generator, &goals, &real),
            real: GoalReport {
                // Replaces the real motion's distance from itself, which is 0.
                frechet_distance: between_halves(&real.features, seed),
                ..real.report(self.generator, &goals, &real)
            },
            grounds,
            text_motion,
            variety,
        })
    }
}

/// How many root paths of samples and of real clips are out of bounds, over all replications.
fn verdict(replications: &[Replication]) -> String {
    let count = |which: usize, is: fn(&GroundRecord) -> bool| {
        let all = replications.iter().flat_map(|each| &each.grounds[which]);
        all.filter(|ground| is(ground)).count()
    };
    let [out, real] = [0, 1].map(|which| count(which, |ground| ground.excess() > 0.0));
    let (all, fast) = (count(0, |_| true), count(0, GroundRecord::is_fast));
    let inside = count(0, GroundRecord::is_inside);
    let reasons = match out {
        0 => String::new(),
        _ => format!(": too fast {fast}, inside an obstacle {inside}"),
    };
    format!("{out} of {all} root paths of the samples are out of bounds{reasons} (real: {real})")
}

/// The mean distance between two halves of the feature vectors, over [`DIVISIONS`] random
/// divisions, because neighbors in a list are often from one take.
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

/// Generated or real clips, as long as their goals.
struct Measured<'a> {
    samples: &'a [GeneratedClip],
    /// Empty for a trajectory model.
    clips: Vec<Features>,
    joints: Vec<Joints>,
    /// [`mean_positions`] of each clip, for diversity and Fréchet distance.
    features: Vec<Vec<f64>>,
}

impl<'a> Measured<'a> {
    fn new(samples: &'a [GeneratedClip]) -> Self {
        let clips = samples.iter().filter_map(|sample| sample.features.clone());
        let clips: Vec<Features> = clips.collect();
        Self {
            samples,
            joints: clips.iter().map(Features::joints).collect(),
            features: clips.iter().map(mean_positions).collect(),
            clips,
        }
    }

    fn report(&self, generator: &ClipGenerator, goals: &[Goal], real: &Self) -> GoalReport {
        let skeleton = generator.config().data.humanml3d.skeleton();
        let bodies = self.joints.iter().map(Some).chain(repeat(None));
        let samples = self.samples.iter().zip(goals).zip(bodies);
        let samples = samples.map(|((sample, goal), joints)| GoalSample {
            goal,
            ground: &sample.ground,
            joints,
        });
        let samples: Vec<GoalSample> = samples.collect();
        let feet = skeleton.contact_joints();
        // Left and right toe: the second of each pair of contacts.
        let fps = skeleton.description().fps;
        let report = GoalReport::compute(&samples, fps, &[feet[1], feet[3]]);
        let seed = generator.config().run.seed;
        report.with_features(&self.features, &real.features, DIVERSITY_PAIRS, seed)
    }
}

/// The mean over time of each joint's position relative to the root. The goal determines the root.
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
    fn halves_are_random() {
        // Each number occurs twice in a row, like mirrored or neighboring clips of a take.
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
