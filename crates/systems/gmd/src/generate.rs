//! Generating clips from checkpoints, with or without goals.
//!
//! Two-stage sampling (Guided Motion Diffusion, appendix F): a trajectory model generates a ground
//! path for the goal; the motion model generates motion along that path, with imputation and
//! guidance in every frame. Rotation and height are not constrained.

mod once;

use std::iter::repeat;
use std::ops::ControlFlow;

use crate::network::TextDenoiser;
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
use serde::{Deserialize, Serialize};

use super::GmdConfig;
use super::load::{TrainedClips, channels_of, text_input};
use super::padding::Padded;
use super::recipe_name::RecipeName;
use super::stage::{StageModel, StageSteering};
use super::steering::{Padding, SteeringConfig};
use kinegrad_train::Error;
use kinegrad_train::TrainedModel;
use kinegrad_train::checkpoint::State;
use kinegrad_train::clips::FeatureSpace;
use kinegrad_train::clips::captions::{ClipText, TextInput};
use kinegrad_train::config::{Config, SamplingConfig};
use kinegrad_train::evaluation::OnStep;

/// The key of a clip's noise, and its number among the clips of that key.
pub type NoiseKey = (Key, u64);

/// Keys of the noise of the first `count` clips of one condition.
pub(super) fn keys(seed: u64, count: usize) -> impl Iterator<Item = NoiseKey> {
    let key = Key::new(seed, Purpose::Sampling);
    (0..count as u64).map(move |number| (key, number))
}

/// A request for one clip.
#[derive(Clone, Debug)]
pub struct ClipRequest {
    /// Its frames, at least 1; with a goal, the goal's number is used.
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
    /// Its features, absolute or relative as the run's are; none of a trajectory model.
    pub features: Option<Features>,
    /// The root's ground position in each frame, x and z in metres.
    pub ground: Vec<[f64; 2]>,
    /// The ground path of the first stage.
    pub path: Option<Vec<[f64; 2]>>,
}

impl GeneratedClip {
    /// The first `frames` frames.
    fn cut(mut self, frames: usize) -> Self {
        self.features = self.features.map(|features| features.slice(0..frames));
        self.ground.truncate(frames);
        if let Some(path) = &mut self.path {
            path.truncate(frames);
        }
        self
    }

    /// The clip of these features.
    pub(super) fn of(features: Features) -> Self {
        let positions = features.root_positions().into_iter();
        Self {
            ground: positions.map(|[x, _, z]| [x, z]).collect(),
            features: Some(features),
            path: None,
        }
    }
}

/// The steering targets of a sample.
#[derive(Clone, Copy)]
struct Aim<'a> {
    /// One per clip.
    goals: &'a [Goal],
    /// The paths of a first stage, one per clip: of the sampled length, or of the clip's.
    paths: Option<&'a [Vec<[f64; 2]>]>,
}

impl<'a> Aim<'a> {
    fn of(goals: &'a [Goal], paths: Option<&'a [Vec<[f64; 2]>]>) -> Option<Self> {
        (!goals.is_empty()).then_some(Self { goals, paths })
    }
}

/// Sampled frames for clips of `frames` frames: those of training, or more if requested.
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
    channels: usize,
    /// Maximum number of frames of the network.
    longest: Option<usize>,
    device: Device,
}

impl ClipGenerator {
    /// Loads the networks of a trained model.
    ///
    /// # Errors
    /// If the checkpoint is damaged or does not fit its own config.
    pub fn load(trained: &TrainedModel) -> Result<Self, Error> {
        let device = &trained.device;
        let TrainedClips {
            model,
            projection,
            state,
        } = TrainedClips::load(&trained.saved, trained.weights, &device.clone().autodiff())?;
        let channels = channels_of(&state.config);
        let own: &GmdConfig = state.config.own();
        let longest = own.model.network.longest();
        Ok(Self {
            plain: model.valid(),
            tracked: model.no_grad(),
            diffusion: GaussianDiffusion::new(&own.diffusion)?,
            space: FeatureSpace::new(
                &state.statistics.mean[..channels],
                &state.statistics.std[..channels],
                projection.as_ref(),
                device,
            ),
            text: text_input(&state.config),
            state,
            channels,
            longest,
            device: device.clone(),
        })
    }

    /// The config the model was trained with.
    pub fn config(&self) -> &Config {
        &self.state.config
    }

    fn steering(&self) -> &SteeringConfig {
        &self.config().own::<GmdConfig>().steering
    }

    /// [`sample_keyed`](Self::sample_keyed), where clip i depends on `seed`, i and its request.
    ///
    /// # Errors
    /// As [`sample_keyed`](Self::sample_keyed).
    pub fn sample(
        &self,
        trajectory: Option<&Self>,
        requests: &[ClipRequest],
        sampling: &SamplingConfig,
        seed: u64,
        on_step: &mut OnStep<'_>,
    ) -> Result<Vec<GeneratedClip>, Error> {
        let keys: Vec<NoiseKey> = keys(seed, requests.len()).collect();
        self.sample_keyed(trajectory, requests, sampling, &keys, on_step)
    }

    /// Generates the clips of `requests` as one batch; `trajectory`, if given, generates their
    /// ground paths first. A clip depends on its key, its request and the sampled number of frames,
    /// exactly on the CPU; one with a goal also on the number of keyframes of its batch, by the
    /// published guidance's divisor. `on_step` is called with the stage, `trajectory` or `motion`,
    /// and its steps done and in total.
    ///
    /// The models' training length is sampled, or the longest clip's length, and the rest is cut
    /// off: shorter noise would give the network more padding than in training (docs/sources.md,
    /// section 4.13). The padding is `steering.padding`.
    ///
    /// # Errors
    /// If a goal cannot be followed in so many frames, the sampler's settings cannot work, one of the
    /// models cannot follow goals, or does not know a text.
    pub fn sample_keyed(
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
        let steering = self.steering();
        let mut paths = None;
        if let (Some(model), false) = (trajectory, goals.is_empty()) {
            self.must_match(model)?;
            // If the motion model samples the padding, it follows a path there too.
            let follows_behind = steering.padding == Padding::Drawn;
            let followed = if follows_behind { own } else { frames };
            let frames = sampled_frames(model.config(), followed);
            let mut on_path_step = |done, all| on_step("trajectory", done, all);
            let named = |(key, number): &NoiseKey| (key.named("trajectory"), *number);
            let keys: Vec<NoiseKey> = keys.iter().map(named).collect();
            // The first stage is clipped and padded according to its own run, except for a path
            // that is followed everywhere.
            let first = SamplingConfig {
                clip: model.config().sampling.clip,
                sampler: steering.first_stage(&sampling.sampler),
                ..sampling.clone()
            };
            let of_first = SteeringConfig {
                padding: match follows_behind {
                    true => Padding::Drawn,
                    false => model.steering().padding,
                },
                ..steering.clone()
            };
            let aim = Aim::of(&goals, None);
            let x = model.sampled(
                &texts,
                aim,
                (frames, &lengths),
                (&first, &of_first),
                &keys,
                &mut on_path_step,
            )?;
            let mut sampled = model.paths(x);
            for (path, &length) in sampled.iter_mut().zip(&lengths) {
                path.truncate(if follows_behind { own } else { length });
            }
            paths = Some(sampled);
        }
        let mut on_motion_step = |done, all| on_step("motion", done, all);
        let aim = Aim::of(&goals, paths.as_deref());
        let x = self.sampled(
            &texts,
            aim,
            (own, &lengths),
            (sampling, steering),
            keys,
            &mut on_motion_step,
        )?;
        let samples: Vec<GeneratedClip> = match RecipeName::of(self.config()) {
            RecipeName::Trajectory => {
                let of_path = |ground| GeneratedClip {
                    features: None,
                    ground,
                    path: None,
                };
                self.paths(x).into_iter().map(of_path).collect()
            }
            RecipeName::Motion => {
                let features = self.features(x)?.into_iter();
                let paths = paths.into_iter().flatten().map(Some);
                features
                    .map(GeneratedClip::of)
                    .zip(paths.chain(repeat(None)))
                    .map(|(sample, path)| GeneratedClip { path, ..sample })
                    .collect()
            }
        };
        Ok(samples
            .into_iter()
            .zip(lengths)
            .map(|(sample, length)| sample.cut(length))
            .collect())
    }

    /// Rejects a trajectory model of other clips, or before another trajectory model.
    fn must_match(&self, trajectory: &Self) -> Result<(), Error> {
        let (own, other) = (self.config(), trajectory.config());
        let same = (own.data.humanml3d.skeleton, own.data.humanml3d.root)
            == (other.data.humanml3d.skeleton, other.data.humanml3d.root);
        match RecipeName::of(own) == RecipeName::Motion && same {
            true => Ok(()),
            false => Err(Error::usage(
                format!(
                    "`{}` cannot generate paths for `{}`",
                    other.run.name, own.run.name
                ),
                "the first must be a run of recipe `gmd_trajectory`, the second one of \
                 `gmd_motion`, on clips of the same `data.humanml3d.skeleton` and `root`",
            )),
        }
    }

    /// Motion in the network's space, steered to an aim if there is one: of so many frames, for clips
    /// of these lengths.
    fn sampled(
        &self,
        texts: &[Option<&ClipText>],
        aim: Option<Aim<'_>>,
        (frames, lengths): (usize, &[usize]),
        (sampling, steering): (&SamplingConfig, &SteeringConfig),
        keys: &[NoiseKey],
        on_step: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Result<Tensor<3>, Error> {
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
        let values = |text: &Option<&ClipText>| match text {
            Some(text) => self.text.values(text),
            None => Ok(None),
        };
        let texts: Vec<Option<Vec<f32>>> = texts.iter().map(values).collect::<Result<_, _>>()?;
        let has_text = texts.iter().any(Option::is_some);
        let values = self.text.channels();
        let text = texts.into_iter();
        let text = text.flat_map(|text| text.unwrap_or_else(|| vec![0.0; values]));
        let data = TensorData::new(text.collect::<Vec<f32>>(), [batch, values, 1]);
        let cond = Tensor::from_data(data, &self.device);
        let sampler = SamplerConfig {
            // Without any text both passes of the guidance are the same one.
            guidance_scale: match has_text {
                true => sampling.sampler.guidance_scale,
                false => 0.0,
            },
            ..sampling.sampler.clone()
        };
        let clip = sampling.clip.range(&self.state.statistics, channels)?;
        let mut on_sampled = |done, all, _: &Tensor<3>| on_step(done, all);
        let lengths = match steering.padding {
            Padding::Zeros => lengths.to_vec(),
            Padding::Drawn => vec![frames; batch],
        };
        let plain = Padded::new(&self.plain, &self.diffusion, &lengths, &start);
        let Some(aim) = aim else {
            // Each clip equals the one sampled alone, to the bit.
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
        };
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
        let steering = match aim.paths {
            Some(paths) => StageSteering::along(steering, aim.goals, paths, model)?,
            None => StageSteering::of_goals(steering, aim.goals, model)?,
        };
        let at = |timestep| steering.at(timestep);
        let like = start.clone().autodiff();
        let networks = Networks {
            tracked: &Padded::new(&self.tracked, &self.diffusion, &lengths, &like),
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

    fn paths(&self, x: Tensor<3>) -> Vec<Vec<[f64; 2]>> {
        let [_, _, frames] = x.dims();
        let positions = self.space.ground(x).swap_dims(1, 2);
        let values = positions.try_into_vec_as::<f32>();
        let values = values.expect("samples are float32");
        let path = |path: &[f32]| path.chunks(2).map(|p| [p[0].into(), p[1].into()]).collect();
        values.chunks(2 * frames).map(path).collect()
    }

    fn features(&self, x: Tensor<3>) -> Result<Vec<Features>, Error> {
        use kinegrad_diffusion::Space as _;
        let [_, channels, frames] = x.dims();
        let rows = self.space.to_motion(x).swap_dims(1, 2);
        let values = rows.try_into_vec_as::<f32>().expect("samples are float32");
        let humanml3d = &self.config().data.humanml3d;
        let (layout, root) = (humanml3d.skeleton.skeleton().layout(), humanml3d.root);
        let clips = values.chunks(channels * frames).enumerate();
        let features = clips.map(|(index, clip)| {
            if !clip.iter().all(|value| value.is_finite()) {
                let sample = format!("{} of {}", index + 1, values.len() / clip.len());
                return Err(Error::SampleNotFinite { sample });
            }
            Ok(Features::new(clip.to_vec(), layout, root)?)
        });
        features.collect()
    }
}
