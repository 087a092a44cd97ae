//! Sampling along a path on the ground (docs/sources.md, section 7).

use std::cell::RefCell;

use burn::tensor::{Tensor, TensorData};
use kinegrad_diffusion::{GaussianDiffusion, Objective};
use kinegrad_motion::Statistics;
use kinegrad_motion::humanml::{Features, Root, Skeleton};
use kinegrad_motion::path::{PathLoss, PathLossConfig, root_channels};
use kinegrad_random::Key;
use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, Refused, in_range, require};
use kinegrad_train::Error;
use kinegrad_train::clips::path_target::{Followed, PathTarget};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Channels of the root's rotation and ground position.
const ROOT: usize = 3;

/// The table `evaluation.path`: path following.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PathConfig {
    /// The method that keeps the root on the path during sampling.
    pub method: PathMethod,
    /// For `warp`: lock the sample's standing feet by two-bone inverse kinematics.
    pub lock_feet: bool,
    /// For `override`: the replacement of the root.
    pub override_target: OverrideTarget,
    /// For `override`: replace the heading too. If false, the path is relative to the sample's
    /// headings.
    pub yaw: bool,
    /// For `guidance`: use the gradient through the network from the predicted clean motion,
    /// multiplied by the step's variance. If false, use the gradient of the noisy motion.
    pub through_network: bool,
    /// For `guidance`: length of a step against the gradient. Omitted: 100 through the network; for
    /// the noisy motion, 1 with a relative root and 0.05 with an absolute root.
    pub guidance_step_size: Option<f64>,
    /// For the methods with `tokens`: guidance scale of the path. Scales other than 1 and 0 sample with
    /// two passes, with and without the path; 0 ignores it. A network trained from scratch must have
    /// seen motion without a path (`paths.drop_prob`).
    pub path_guidance_scale: f64,
    /// For `guidance` through the network: largest shift of a frame in one step, over all channels,
    /// in standard deviations of the step's noise. With a relative root, early frames move all
    /// later frames, and without a limit their gradient breaks the motion.
    pub max_shift: f64,
    /// Last timestep at which the path acts; at lower timesteps, the model samples freely. With 0,
    /// an override lasts to the end.
    pub stop_timestep: usize,
    /// For `guidance`: the loss.
    pub loss: PathLossConfig,
}

impl Default for PathConfig {
    fn default() -> Self {
        Self {
            method: PathMethod::Warp,
            lock_feet: true,
            override_target: OverrideTarget::Sample,
            yaw: true,
            through_network: true,
            guidance_step_size: None,
            path_guidance_scale: 1.0,
            max_shift: 2.0,
            stop_timestep: 0,
            loss: PathLossConfig::default(),
        }
    }
}

/// The path-following method.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PathMethod {
    /// Samples from the beginning of the path without following it: the baseline.
    None,
    /// Samples freely and moves the motion onto the path afterwards (option A).
    #[default]
    Warp,
    /// Replaces the root at each step (option B).
    Override,
    /// Moves each step against the gradient of a loss (option D).
    Guidance,
    /// Combines guidance and override.
    OverrideGuidance,
    /// Conditions the network on the path (options C and E).
    Tokens,
    /// Path conditioning and guidance.
    TokensGuidance,
    /// Path conditioning; moving the motion onto the path removes the remaining error.
    TokensWarp,
}

impl PathMethod {
    /// True if the root is replaced.
    pub fn replaces(self) -> bool {
        matches!(self, Self::Override | Self::OverrideGuidance)
    }

    /// True if a gradient guides.
    pub fn guides(self) -> bool {
        use PathMethod::{Guidance, OverrideGuidance, TokensGuidance};
        matches!(self, Guidance | OverrideGuidance | TokensGuidance)
    }

    /// True if the method acts during sampling.
    pub fn acts(self) -> bool {
        !matches!(self, Self::None | Self::Warp)
    }

    /// True if the sample is moved after sampling, which changes the sample's features.
    pub fn moves_afterwards(self) -> bool {
        matches!(self, Self::Warp | Self::TokensWarp)
    }

    /// True if the network is conditioned on the path.
    pub fn conditions(self) -> bool {
        matches!(self, Self::Tokens | Self::TokensGuidance | Self::TokensWarp)
    }
}

/// The target of the override at each step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OverrideTarget {
    /// The path in the noisy motion, without noise, as in the source: less noise than in training.
    Clean,
    /// The path in the noisy motion, noised to the step's level.
    Noised,
    /// The path in the predicted clean motion.
    #[default]
    Sample,
}

impl PathConfig {
    /// Length of a step against the gradient, for motion with this root representation.
    pub fn guidance_step_size(&self, root: Root) -> f64 {
        let default = match (self.through_network, root) {
            (true, _) => 100.0,
            (false, Root::Relative) => 1.0,
            (false, Root::Absolute) => 0.05,
        };
        self.guidance_step_size.unwrap_or(default)
    }

    /// # Errors
    /// Names the key that is invalid for the number of timesteps.
    pub fn validate(&self, num_train_timesteps: usize) -> Result<(), InvalidSetting> {
        if let Some(guidance_step_size) = self.guidance_step_size {
            in_range("guidance_step_size", guidance_step_size, 0.0..)?;
        }
        let (key, scale) = ("path_guidance_scale", self.path_guidance_scale);
        in_range(key, scale, 0.0..)?;
        let allowed = "1 unless `evaluation.path.method` is one of the tokens";
        require(
            scale == 1.0 || self.method.conditions(),
            key,
            scale,
            allowed,
        )
        .hint("other methods do not give the path to the network")?;
        in_range("stop_timestep", self.stop_timestep, 0..num_train_timesteps)?;
        in_range("max_shift", self.max_shift, ABOVE_ZERO)?;
        self.loss.validate().within("loss")
    }
}

/// Moves a motion sampled according to `config` onto the path.
pub(super) fn finish(
    target: &PathTarget,
    features: &Features,
    skeleton: &Skeleton,
    config: &PathConfig,
) -> Result<Followed, Error> {
    let joints = features.joints();
    match config.method {
        PathMethod::Warp => target.warped(&joints, skeleton, config.lock_feet),
        PathMethod::TokensWarp => {
            let near = target.placed(&joints, skeleton)?;
            target.corrected(&near.joints, skeleton, config.lock_feet)
        }
        _ => target.placed(&joints, skeleton),
    }
}

pub(super) struct PathControl<'a> {
    config: &'a PathConfig,
    /// The target, in the coordinates of sampling.
    target: PathTarget,
    root: Root,
    mean: Vec<f64>,
    std: Vec<f64>,
    /// The rotation channel of the last predicted clean motion.
    turning: RefCell<Option<Vec<f64>>>,
    key: Key,
}

impl<'a> PathControl<'a> {
    /// The control of a sample with features normalized by `statistics`.
    pub fn new(
        config: &'a PathConfig,
        target: &PathTarget,
        root: Root,
        statistics: &Statistics,
        key: Key,
    ) -> Self {
        Self {
            config,
            target: target.at_origin(),
            root,
            mean: statistics.mean[..ROOT].to_vec(),
            std: statistics.std[..ROOT].to_vec(),
            turning: RefCell::new(None),
            key: key.named("path"),
        }
    }

    /// True if the path acts at timestep `t`.
    pub fn acts(&self, t: usize) -> bool {
        t >= self.config.stop_timestep
    }

    /// The noisy motion for the network, `[1, channels, time]`, moved towards the path by a
    /// guidance step or with its root replaced by the path.
    pub fn noisy(&self, mut x_t: Tensor<3>, t: usize, diffusion: &GaussianDiffusion) -> Tensor<3> {
        if !self.acts(t) {
            return x_t;
        }
        let config = self.config;
        if config.method.guides() && !config.through_network {
            let gradient = self.gradient(&x_t);
            x_t = x_t - gradient * config.guidance_step_size(self.root);
        }
        if !config.method.replaces() || config.override_target == OverrideTarget::Sample {
            return x_t;
        }
        let (signal, noise) = match config.override_target {
            OverrideTarget::Noised => (
                diffusion.schedule.sqrt_alphas_cumprod[t],
                diffusion.schedule.sqrt_one_minus_alphas_cumprod[t],
            ),
            _ => (1.0, 0.0),
        };
        let normals = self.key.at(t as u64).normals(ROOT * x_t.dims()[2]);
        let mut channels = self.channels();
        for (value, normal) in channels.iter_mut().flatten().zip(normals) {
            *value = signal * *value + noise * f64::from(normal);
        }
        self.put(x_t, channels)
    }

    /// The predicted clean motion, with the root on the path if `override_target` is the sample.
    /// Stores the rotations for the next step.
    pub fn clean(&self, x_start: Tensor<3>, t: usize) -> Tensor<3> {
        self.note_rotation(&x_start);
        let target = self.config.override_target;
        match self.config.method.replaces() && target == OverrideTarget::Sample && self.acts(t) {
            true => self.put(x_start, self.channels()),
            false => x_start,
        }
    }

    /// The sampled motion. If the root is replaced to the end, the motion has the exact path.
    pub fn last(&self, x: Tensor<3>) -> Tensor<3> {
        if !self.config.method.replaces() || !self.acts(0) {
            return x;
        }
        self.note_rotation(&x);
        self.put(x, self.channels())
    }

    fn note_rotation(&self, x: &Tensor<3>) {
        let rotation = self.physical(x).into_iter().map(|[a, ..]| a);
        *self.turning.borrow_mut() = Some(rotation.collect());
    }

    /// Normalized root channels on the path, relative to the path's or the sample's headings.
    fn channels(&self) -> Vec<Vec<f64>> {
        let points = &self.target.course.points;
        let turning = self.turning.borrow();
        let headings = match (&*turning, self.config.yaw) {
            (Some(rotations), false) => {
                let rows: Vec<[f64; 4]> = rotations.iter().map(|a| [*a, 0.0, 0.0, 0.0]).collect();
                let angles = self.root.half_angles(&rows);
                angles.iter().map(|a| -2.0 * a).collect()
            }
            _ => self.target.headings.clone(),
        };
        let rows = root_channels(points, &headings, self.root);
        let channel = |c: usize| {
            let values = rows.iter().map(|row| (row[c] - self.mean[c]) / self.std[c]);
            values.collect()
        };
        (0..ROOT).map(channel).collect()
    }

    /// Replaces root channels by normalized channels; replaces the rotation only with `yaw`.
    fn put(&self, x: Tensor<3>, channels: Vec<Vec<f64>>) -> Tensor<3> {
        let [batch, all, frames] = x.dims();
        assert_eq!(batch, 1, "a path is of one motion");
        let first = usize::from(!self.config.yaw);
        let values = channels[first..].concat().into_iter();
        let values: Vec<f32> = values.map(|value| value as f32).collect();
        let data = TensorData::new(values, [1, ROOT - first, frames]);
        let replaced = Tensor::from_data(data, &x.device());
        let mut parts = vec![replaced, x.clone().narrow(1, ROOT, all - ROOT)];
        if first > 0 {
            parts.insert(0, x.narrow(1, 0, first));
        }
        Tensor::cat(parts, 1)
    }

    /// The root's rotation and ground position per frame, in radians and meters.
    fn physical(&self, x: &Tensor<3>) -> Vec<[f64; 3]> {
        let [_, _, frames] = x.dims();
        let values = x.clone().narrow(1, 0, ROOT).try_into_vec_as::<f32>();
        let values = values.expect("samples are float32");
        let frame = |n: usize| {
            [0, 1, 2].map(|c| f64::from(values[c * frames + n]) * self.std[c] + self.mean[c])
        };
        (0..frames).map(frame).collect()
    }
}

impl Objective for PathControl<'_> {
    fn gradient(&self, x: &Tensor<3>) -> Tensor<3> {
        let [_, all, frames] = x.dims();
        let loss = PathLoss {
            config: self.config.loss,
            points: self.target.course.points.clone(),
            headings: self.target.headings.clone(),
        };
        let (_, gradient) = loss.evaluate(self.root, &self.physical(x));
        let values: Vec<f32> = (0..ROOT)
            .flat_map(|c| gradient.iter().map(move |row| (c, row)))
            .map(|(c, row)| (row[c] * self.std[c]) as f32)
            .collect();
        let data = TensorData::new(values, [1, ROOT, frames]);
        let root = Tensor::from_data(data, &x.device());
        let rest = Tensor::zeros([1, all - ROOT, frames], &x.device());
        Tensor::cat(vec![root, rest], 1)
    }
}
