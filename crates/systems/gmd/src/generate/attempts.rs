//! Sampling root paths, and clips with goals, again that are out of bounds.

use kinegrad_motion::Statistics;
use kinegrad_motion::goal::Goal;
use kinegrad_motion::humanml::Skeleton;
use kinegrad_train::clips::path_target::Fastest;
use kinegrad_train::config::SamplingConfig;
use kinegrad_train::evaluation::OnStep;
use kinegrad_train::sampling::GroundRecord;
use kinegrad_train::{Error, TrainedModel};

use super::{ClipGenerator, ClipRequest, GeneratedClip, NoiseKey};
use crate::recipe_name::RecipeName;

/// The training motion that root paths are compared with.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GroundBounds {
    fps: f64,
    /// Metres per second.
    fastest: f64,
}

impl GroundBounds {
    /// That of a trained model.
    pub fn of(trained: &TrainedModel) -> Self {
        let skeleton = trained.config().data.humanml3d.skeleton();
        Self::new(&trained.saved.state.statistics, &skeleton)
    }

    /// That of a generator's training.
    pub fn of_generator(generator: &ClipGenerator) -> Self {
        let skeleton = generator.config().data.humanml3d.skeleton();
        Self::new(&generator.state.statistics, &skeleton)
    }

    fn new(statistics: &Statistics, skeleton: &Skeleton) -> Self {
        Self {
            fps: skeleton.description().fps,
            fastest: Fastest::of_clips(statistics, skeleton).speed(),
        }
    }

    /// The measures of a clip's root path, with the obstacles of its goal.
    pub fn measured(&self, clip: &GeneratedClip, goal: Option<&Goal>) -> GroundRecord {
        let obstacles = goal.map_or(&[][..], |goal| &goal.obstacles);
        let of = |ground: &[_]| GroundRecord::of(ground, obstacles, self.fps, self.fastest);
        let first_stage = clip.path.as_ref().map(|path| Box::new(of(path)));
        GroundRecord {
            rejected: clip.rejected,
            first_stage,
            ..of(&clip.ground)
        }
    }
}

impl ClipGenerator {
    /// Generates the clips of `requests` as one batch. The model `trajectory`, if given, first
    /// generates ground paths. A clip depends on its key, its request and the sampled number of
    /// frames. A clip with a goal also depends on its batch's number of keyframes, the divisor of
    /// the published guidance. `on_step` gets the stage, `trajectory` or `motion`.
    ///
    /// Root paths, and clips with goals, that are out of [bounds](GroundRecord::excess) are sampled
    /// again from other noise, in batches of their own, at most `steering.attempts` times in all.
    /// The best is returned.
    ///
    /// Samples have at least the training length and are cut to the requested length: shorter noise
    /// would give the network more padding than in training (docs/sources.md, section 4.13).
    ///
    /// # Errors
    /// For a goal, setting or text that one of the models does not support.
    pub fn sample(
        &self,
        trajectory: Option<&Self>,
        requests: &[ClipRequest],
        sampling: &SamplingConfig,
        keys: &[NoiseKey],
        on_step: &mut OnStep<'_>,
    ) -> Result<Vec<GeneratedClip>, Error> {
        let bounds = GroundBounds::of_generator(self);
        let is_path = RecipeName::of(self.config()) == RecipeName::Trajectory;
        let excess = |index: usize, clip: &GeneratedClip| {
            let goal = requests[index].goal.as_ref();
            match is_path || goal.is_some() {
                true => bounds.measured(clip, goal).excess(),
                false => 0.0,
            }
        };
        let mut clips = self.sample_once(trajectory, requests, sampling, keys, on_step)?;
        for attempt in 1..self.steering.attempts {
            let bad = |index: &usize| excess(*index, &clips[*index]) > 0.0;
            let bad: Vec<usize> = (0..clips.len()).filter(bad).collect();
            if bad.is_empty() {
                break;
            }
            let name = format!("attempt {attempt}");
            let again: Vec<ClipRequest> = bad.iter().map(|&i| requests[i].clone()).collect();
            let noise = bad.iter().map(|&i| (keys[i].0.named(&name), keys[i].1));
            let noise: Vec<NoiseKey> = noise.collect();
            let found = self.sample_once(trajectory, &again, sampling, &noise, on_step)?;
            for (index, clip) in bad.into_iter().zip(found) {
                if excess(index, &clip) < excess(index, &clips[index]) {
                    clips[index] = GeneratedClip {
                        rejected: attempt,
                        ..clip
                    };
                }
            }
        }
        Ok(clips)
    }
}
