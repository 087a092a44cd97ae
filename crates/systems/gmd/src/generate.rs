//! Generating clips from checkpoints, with or without goals.
//!
//! Two-stage sampling (Guided Motion Diffusion, appendix F): a trajectory model generates a ground
//! path for the goal; the motion model generates motion along the ground path, with imputation and
//! guidance in every frame. Rotation and height are not constrained.

mod attempts;
mod once;

use std::iter::repeat;
use std::ops::ControlFlow;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{
    GaussianDiffusion, Networks, NoiseKeys, SamplerConfig, sample, steered_sample,
};
use kinegrad_kernels::batch_invariant;
use kinegrad_motion::goal::Goal;
use kinegrad_motion::humanml::{Features, Root};
use kinegrad_random::{Key, Purpose};
use kinegrad_settings::{Refused, in_range, require};
use kinegrad_train::checkpoint::State;
use kinegrad_train::clips::FeatureSpace;
use kinegrad_train::clips::captions::{ClipText, TextInput};
use kinegrad_train::clips::path_condition::of_paths;
use kinegrad_train::config::{Config, SamplingConfig};
use kinegrad_train::evaluation::OnStep;
use kinegrad_train::{Error, TrainedModel};
use serde::{Deserialize, Serialize};

pub(super) use attempts::GroundBounds;

use super::GmdConfig;
use super::load::{TrainedClips, channels_of, text_input};
use super::padding::Padded;
use super::recipe_name::RecipeName;
use super::stage::{StageModel, StageSteering};
use super::steering::{Padding, SteeringConfig};
use crate::network::{Along, TextDenoiser};

/// The key of a clip's noise, and the clip's index among clips with the same key.
pub type NoiseKey = (Key, u64);

pub(super) fn keys(seed: u64, count: usize) -> impl Iterator<Item = NoiseKey> {
    let key = Key::new(seed, Purpose::Sampling);
    (0..count as u64).map(move |number| (key, number))
}

/// A request for one clip.
#[derive(Clone, Debug)]
pub struct ClipRequest {
    /// Number of frames, at least 1; a goal's number of frames takes precedence.
    pub frames: usize,
    /// Position control of the root.
    pub goal: Option<Goal>,
    /// The text; unconditional if `None`.
    pub text: Option<ClipText>,
}

impl ClipRequest {
    pub(super) fn length(&self) -> usize {
        self.goal.as_ref().map_or(self.frames, |goal| goal.frames)
    }
}

/// One clip.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct GeneratedClip {
    /// The clip's features, with the root representation of the run; `None` for a trajectory model.
    pub features: Option<Features>,
    /// The root's ground position in each frame, x and z in meters.
    pub ground: Vec<[f64; 2]>,
    /// The ground path of the first stage.
    pub path: Option<Vec<[f64; 2]>>,
    /// Number of samples before it whose root paths were out of bounds.
    pub rejected: usize,
}

impl GeneratedClip {
    fn cut(mut self, frames: usize) -> Self {
        self.features = self.features.map(|features| features.slice(0..frames));
        self.ground.truncate(frames);
        if let Some(path) = &mut self.path {
            path.truncate(frames);
        }
        self
    }

    pub(super) fn of(features: Features) -> Self {
        let positions = features.root_positions().into_iter();
        Self {
            ground: positions.map(|[x, _, z]| [x, z]).collect(),
            features: Some(features),
            path: None,
            rejected: 0,
        }
    }
}

#[derive(Clone, Copy)]
struct Stage<'a> {
    texts: &'a [Option<&'a ClipText>],
    /// One per clip, or none.
    goals: &'a [Goal],
    /// The paths of a first stage, one per clip, with the sampled length or the clip's length.
    paths: Option<&'a [Vec<[f64; 2]>]>,
    frames: usize,
    lengths: &'a [usize],
    sampling: &'a SamplingConfig,
    steering: &'a SteeringConfig,
    keys: &'a [NoiseKey],
}

/// Number of sampled frames for clips of `frames` frames: at least the training length.
pub(super) fn sampled_frames(config: &Config, frames: usize) -> usize {
    frames.max(config.data.target_frames)
}

/// A trained denoiser of clips, ready to generate samples.
pub struct ClipGenerator {
    plain: TextDenoiser,
    tracked: TextDenoiser,
    diffusion: GaussianDiffusion,
    space: FeatureSpace,
    text: TextInput,
    state: State,
    steering: SteeringConfig,
    channels: usize,
    /// Maximum number of frames of the network.
    longest: Option<usize>,
    device: Device,
}

impl ClipGenerator {
    /// Loads the networks of a trained model.
    ///
    /// # Errors
    /// If the checkpoint is damaged.
    pub fn load(trained: &TrainedModel) -> Result<Self, Error> {
        let device = &trained.device;
        let TrainedClips {
            model,
            projection,
            state,
        } = TrainedClips::load(&trained.saved, trained.weights, &device.clone().autodiff())?;
        let channels = channels_of(&state.config);
        let own: &GmdConfig = state.config.own();
        let [mean, std] = [&state.statistics.mean, &state.statistics.std].map(|s| &s[..channels]);
        Ok(Self {
            plain: model.valid(),
            tracked: model.no_grad(),
            diffusion: GaussianDiffusion::new(&own.diffusion)?,
            space: FeatureSpace::new(mean, std, projection.as_ref(), device),
            text: text_input(&state.config),
            channels,
            longest: own.model.network.longest(),
            steering: own.steering.clone(),
            device: device.clone(),
            state,
        })
    }

    /// The run's config.
    pub fn config(&self) -> &Config {
        &self.state.config
    }

    /// A generator whose goals are paths with a position for each frame.
    #[must_use]
    pub fn along_paths(self) -> Self {
        Self {
            steering: self.steering.along_path(),
            ..self
        }
    }

    /// [`sample`](Self::sample) in one attempt.
    fn sample_once(
        &self,
        trajectory: Option<&Self>,
        requests: &[ClipRequest],
        sampling: &SamplingConfig,
        keys: &[NoiseKey],
        on_step: &mut OnStep<'_>,
    ) -> Result<Vec<GeneratedClip>, Error> {
        let texts: Vec<Option<&ClipText>> = requests.iter().map(|r| r.text.as_ref()).collect();
        let goals: Option<Vec<Goal>> = requests.iter().map(|r| r.goal.clone()).collect();
        let goals = goals.unwrap_or_default();
        let lengths: Vec<usize> = requests.iter().map(ClipRequest::length).collect();
        let frames = lengths.iter().copied().max().unwrap_or(0);
        let own = sampled_frames(self.config(), frames);
        // The second stage has a position for each frame.
        let steering = &match trajectory {
            Some(_) => self.steering.along_path(),
            None => self.steering.clone(),
        };
        let stage = Stage {
            texts: &texts,
            goals: &goals,
            paths: None,
            frames: own,
            lengths: &lengths,
            sampling,
            steering,
            keys,
        };
        let mut paths = None;
        if let (Some(model), false) = (trajectory, goals.is_empty()) {
            self.must_match(model)?;
            // A motion model that samples the padding follows a path in the padding too.
            let follows_behind = steering.padding == Padding::Sampled;
            let followed = if follows_behind { own } else { frames };
            let named = |(key, number): &NoiseKey| (key.named("trajectory"), *number);
            let keys: Vec<NoiseKey> = keys.iter().map(named).collect();
            // The first stage's own run determines its clamping and padding, except if the second
            // stage follows the path in the padding.
            let first = SamplingConfig {
                clip: model.config().sampling.clip,
                clip_range: model.config().sampling.clip_range,
                sampler: steering.first_stage(&sampling.sampler),
                ..sampling.clone()
            };
            let of_first = SteeringConfig {
                padding: match follows_behind {
                    true => Padding::Sampled,
                    false => model.steering.padding,
                },
                ..steering.clone()
            };
            let stage = Stage {
                frames: sampled_frames(model.config(), followed),
                sampling: &first,
                steering: &of_first,
                keys: &keys,
                ..stage
            };
            let x = model.sampled(stage, &mut |done, all| on_step("trajectory", done, all))?;
            let mut sampled = model.paths(x);
            for (path, &length) in sampled.iter_mut().zip(&lengths) {
                path.truncate(if follows_behind { own } else { length });
            }
            paths = Some(sampled);
        }
        let stage = Stage {
            paths: paths.as_deref(),
            ..stage
        };
        let x = self.sampled(stage, &mut |done, all| on_step("motion", done, all))?;
        let samples: Vec<GeneratedClip> = match RecipeName::of(self.config()) {
            RecipeName::Trajectory => {
                let of_path = |ground| GeneratedClip {
                    features: None,
                    ground,
                    path: None,
                    rejected: 0,
                };
                self.paths(x).into_iter().map(of_path).collect()
            }
            RecipeName::Motion => {
                // The root is on a detour up to its end, where free frames follow.
                let is_alone = paths.is_none() && steering.imputation;
                let end = |index: usize| {
                    let goal: &Goal = goals.get(index).filter(|_| is_alone)?;
                    let frames = goal.keyframes.iter().map(|keyframe| keyframe.frame);
                    frames.max().filter(|_| steering.has_detours(goal))
                };
                let features = self.features(x)?.into_iter().enumerate();
                let features = features.map(|(index, features)| match end(index) {
                    Some(last) => features.continued_after(last),
                    None => features,
                });
                let paths = paths.into_iter().flatten().map(Some);
                let samples = features
                    .map(GeneratedClip::of)
                    .zip(paths.chain(repeat(None)));
                let samples = samples.map(|(sample, path)| GeneratedClip { path, ..sample });
                samples.collect()
            }
        };
        let samples = samples.into_iter().zip(lengths);
        Ok(samples.map(|(sample, length)| sample.cut(length)).collect())
    }

    /// Rejects a trajectory model of other clips, or a trajectory model as the second stage.
    fn must_match(&self, trajectory: &Self) -> Result<(), Error> {
        let (own, other) = (self.config(), trajectory.config());
        let clips = |config: &Config| {
            let clips = &config.data.humanml3d;
            (
                clips.skeleton,
                clips.root,
                clips.skeleton().description().fps,
            )
        };
        let same = clips(own) == clips(other);
        if RecipeName::of(own) == RecipeName::Motion && same {
            return Ok(());
        }
        let (path_run, run) = (&other.run.name, &own.run.name);
        Err(Error::usage(
            format!("`{path_run}` cannot generate paths for `{run}`"),
            "the first must be a run of recipe `gmd_trajectory`, the second one of \
             `gmd_motion`, on clips of the same `data.humanml3d.skeleton`, `root` and `fps`",
        ))
    }

    /// Motion in the network's space, steered to optional goals.
    fn sampled(
        &self,
        stage: Stage<'_>,
        on_step: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Result<Tensor<3>, Error> {
        let Stage {
            texts,
            frames,
            sampling,
            steering,
            keys,
            ..
        } = stage;
        if let Some(most) = self.longest {
            in_range("frames", frames, 1..=most).hint(
                "`model.padded_frames` is the maximum length of the network: shorten the goal, or use \
                 fewer frames (option `frames`) without one",
            )?;
        }
        let (batch, channels) = (texts.len(), self.channels);
        let values: Vec<f32> = keys
            .iter()
            .flat_map(|(key, number)| key.named("start").at(*number).normals(channels * frames))
            .collect();
        let data = TensorData::new(values, [batch, channels, frames]);
        let start = Tensor::from_data(data, &self.device);
        let mut text = Vec::new();
        for each in texts {
            text.extend(self.text.values_or_zeros(*each)?);
        }
        let data = TensorData::new(text, [batch, self.text.channels(), 1]);
        let cond = Tensor::from_data(data, &self.device);
        let sampler = SamplerConfig {
            // Without any text, both passes of the guidance are equal.
            guidance_scale: match texts.iter().any(Option::is_some) {
                true => sampling.sampler.guidance_scale,
                false => 0.0,
            },
            ..sampling.sampler.clone()
        };
        let clip = sampling.clip_bounds(&self.state.statistics, channels)?;
        let mut on_sampled = |done, all, _: &Tensor<3>| on_step(done, all);
        let lengths = match steering.padding {
            Padding::Zeros => stage.lengths.to_vec(),
            Padding::Sampled => vec![frames; batch],
        };
        let path = self.path_of(&stage);
        let along = |network, path| Along {
            network,
            path,
            path_guidance_scale: steering.path_guidance_scale,
        };
        let tracked = along(&self.tracked, path.clone().map(Tensor::autodiff));
        let along = along(&self.plain, path);
        let plain = Padded::new(&along, &self.diffusion, &lengths, &start);
        if stage.goals.is_empty() {
            // Each clip equals the clip sampled alone, to the bit.
            let x = batch_invariant(batch, || {
                sample(
                    &self.diffusion,
                    &plain,
                    start,
                    &cond,
                    &sampler,
                    &clip,
                    NoiseKeys::Numbered(keys),
                    &mut on_sampled,
                )
            })?;
            return Ok(x);
        }
        require(
            self.config().data.humanml3d.root == Root::Absolute,
            "data.humanml3d.root",
            "\"relative\" in the run's config",
            "\"absolute\" for position control",
        )
        .hint("train with `data.humanml3d.root = \"absolute\"`, its default")?;
        let model = StageModel {
            space: &self.space,
            channels,
            of_motion: RecipeName::of(self.config()) == RecipeName::Motion,
            frames,
            device: &self.device,
        };
        let steering = match stage.paths {
            Some(paths) => StageSteering::along(steering, stage.goals, paths, model)?,
            None => StageSteering::of_goals(steering, stage.goals, model)?,
        };
        let at = |timestep| steering.at(timestep);
        let like = start.clone().autodiff();
        let networks = Networks {
            tracked: &Padded::new(&tracked, &self.diffusion, &lengths, &like),
            plain: &plain,
        };
        let x = steered_sample(
            &self.diffusion,
            &networks,
            start,
            &cond,
            &sampler,
            &clip,
            &at,
            NoiseKeys::Numbered(keys),
            &mut on_sampled,
        )?;
        Ok(x)
    }

    /// The condition of a path-conditioned network: the paths of the first stage, or of goals with a
    /// position in each frame.
    fn path_of(&self, stage: &Stage<'_>) -> Option<Tensor<3>> {
        let of_goals = || {
            let points = |goal: &'_ Goal| match &goal.trajectory {
                Some(path) if path.first_frame == 0 => Some(path.points.clone()),
                _ => None,
            };
            stage.goals.iter().map(points).collect::<Option<Vec<_>>>()
        };
        let paths = match stage.paths {
            Some(paths) => Some(paths.to_vec()),
            None => of_goals().filter(|paths| !paths.is_empty()),
        };
        let paths = paths.filter(|_| self.plain.has_path())?;
        let frames = stage.frames;
        let cut = |path: &'_ Vec<[f64; 2]>| path.len().min(frames);
        let paths: Vec<&[[f64; 2]]> = paths.iter().map(|path| &path[..cut(path)]).collect();
        let fps = self.config().data.humanml3d.skeleton().description().fps;
        Some(of_paths(&paths, fps, frames, &self.device))
    }

    fn paths(&self, x: Tensor<3>) -> Vec<Vec<[f64; 2]>> {
        let [_, _, frames] = x.dims();
        let positions = self.space.ground(x).swap_dims(1, 2);
        let values = positions.try_into_vec_as::<f32>();
        let values = values.expect("samples are float32");
        let path = |path: &[f32]| path.chunks(2).map(|p| [p[0].into(), p[1].into()]).collect();
        values.chunks(2 * frames).map(path).collect()
    }

    fn features(&self, x: Tensor<3>) -> Result<Vec<Features>, Error> {
        let count = x.dims()[0];
        let name = |index| format!("{} of {count}", index + 1);
        self.space.features(x, &self.config().data.humanml3d, name)
    }
}
