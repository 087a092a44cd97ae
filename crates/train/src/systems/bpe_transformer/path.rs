//! A draw that follows a path over the ground (docs/sources.md, section 7).
//!
//! Clips begin at the origin and face +z: the path is moved there for the draw, and the motion to the
//! path afterwards.

use std::cell::RefCell;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{GaussianDiffusion, Objective};
use kinegrad_motion::Statistics;
use kinegrad_motion::feet::{ContactRule, hold};
use kinegrad_motion::humanml::{Features, Joints, Root, Skeleton};
use kinegrad_motion::path::{
    Course, Edges, HEADING_ORDER, HEADING_WINDOW, PathLoss, PathLossConfig, PathPlan, PathReport,
    Polyline, Turning, Warp, headings_of, placed, root_channels, savgol, unwrapped,
};
use kinegrad_random::Key;
use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, Refused, in_range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::told::of_path;
use crate::error::Error;

/// Channels of the root's rotation and place on the ground.
const ROOT: usize = 3;

/// The table `evaluation.path`: how motion follows a path.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PathConfig {
    /// How the root is kept on the path while motion is drawn.
    pub method: PathMethod,
    /// For `warp`: whether feet are held where they stand in the draw, by two-bone inverse kinematics.
    pub fix_feet: bool,
    /// For `override`: what replaces the root.
    pub reading: OverrideReading,
    /// For `override`: whether the heading is replaced as well. Without it the path is seen from the
    /// headings of the draw itself.
    pub yaw: bool,
    /// For `guidance`: whether the gradient is that of the predicted clean motion through the network,
    /// multiplied by the variance of the step, and not of the noisy motion itself.
    pub through_network: bool,
    /// For `guidance`: length of a step against the gradient. Omitted: 100 through the network, 0.002 for
    /// the noisy motion itself.
    pub eta: Option<f64>,
    /// For `guidance` through the network: furthest that a frame is moved in one step, over all its
    /// channels, in standard deviations of the step's noise. A relative root's early frames move all that
    /// follow: without a limit their gradient breaks the motion.
    pub max_shift: f64,
    /// Last timestep at which the path acts; below it the model finishes the motion by itself. At 0 an
    /// override holds to the end.
    pub until: usize,
    /// For `guidance`: the loss.
    pub loss: PathLossConfig,
}

impl Default for PathConfig {
    fn default() -> Self {
        Self {
            method: PathMethod::Warp,
            fix_feet: true,
            reading: OverrideReading::Sample,
            yaw: true,
            through_network: true,
            eta: None,
            max_shift: 10.0,
            until: 0,
            loss: PathLossConfig::default(),
        }
    }
}

/// How motion follows a path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PathMethod {
    /// Drawn freely, and moved onto the path afterwards (option A).
    #[default]
    Warp,
    /// The root is replaced at each step (option B).
    Override,
    /// Each step goes against the gradient of a loss (option D).
    Guidance,
    /// Both: guided, and replaced.
    OverrideGuidance,
    /// The network is told the path (options C and E).
    Tokens,
    /// Both: told and guided.
    TokensGuidance,
}

impl PathMethod {
    /// Whether the root is replaced.
    pub fn replaces(self) -> bool {
        matches!(self, Self::Override | Self::OverrideGuidance)
    }

    /// Whether a gradient guides.
    pub fn guides(self) -> bool {
        matches!(
            self,
            Self::Guidance | Self::OverrideGuidance | Self::TokensGuidance
        )
    }

    /// Whether the network is told the path.
    pub fn tells(self) -> bool {
        matches!(self, Self::Tokens | Self::TokensGuidance)
    }
}

/// What replaces the root at each step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OverrideReading {
    /// The path in the noisy motion as it is, as the source prints it: less noise there than the
    /// network was trained for.
    Clean,
    /// The path in the noisy motion, noised to the step's level.
    Noised,
    /// The path in the predicted clean motion.
    #[default]
    Sample,
}

impl PathConfig {
    /// Length of a step against the gradient.
    pub fn eta(&self) -> f64 {
        self.eta
            .unwrap_or(if self.through_network { 100.0 } else { 0.002 })
    }

    /// # Errors
    /// Names the key that cannot work with so many timesteps.
    pub fn validate(&self, num_train_timesteps: usize) -> Result<(), InvalidSetting> {
        in_range("eta", self.eta(), 0.0..)?;
        in_range("until", self.until, 0..num_train_timesteps)?;
        in_range("max_shift", self.max_shift, ABOVE_ZERO)?;
        self.loss.validate().within("loss")
    }
}

/// Where a motion of so many frames is to be.
#[derive(Clone, Debug)]
pub struct PathTarget {
    /// The path.
    pub line: Polyline,
    /// Its place in each frame.
    pub course: Course,
    /// Where it leads in each frame, smoothed, without jumps, radians.
    pub headings: Vec<f64>,
}

impl PathTarget {
    /// The target of a plan for `frames` frames at `fps` frames per second.
    ///
    /// # Errors
    /// If the plan is no path.
    pub fn new(plan: &PathPlan, frames: usize, fps: f64) -> Result<Self, Error> {
        let unusable = |error: &dyn std::fmt::Display| {
            Error::usage(
                format!("the path cannot be followed: {error}"),
                "docs/paths.md",
            )
        };
        plan.validate().map_err(|error| unusable(&error))?;
        let line = plan.polyline().map_err(|error| unusable(&error))?;
        let course = Course::at_speed(&line, frames, plan.speed, fps);
        let headings = unwrapped(&headings_of(&course.points));
        let headings = savgol(&headings, HEADING_WINDOW, HEADING_ORDER, Edges::Fitted);
        Ok(Self {
            line,
            course,
            headings,
        })
    }

    /// The largest speed that it asks for, metres per second.
    pub fn speed(&self, fps: f64) -> f64 {
        let steps = self.course.metres.windows(2).map(|pair| pair[1] - pair[0]);
        steps.fold(0.0, f64::max) * fps
    }

    /// The same as a draw sees it: from the origin, facing +z.
    fn at_origin(&self) -> Self {
        let (start, turn) = (self.course.points[0], -self.headings[0]);
        let (sin, cos) = turn.sin_cos();
        let moved = |[x, z]: &[f64; 2]| {
            let (dx, dz) = (x - start[0], z - start[1]);
            [dx * cos + dz * sin, dz * cos - dx * sin]
        };
        let points: Vec<[f64; 2]> = self.course.points.iter().map(moved).collect();
        Self {
            line: self.line.clone(),
            course: Course {
                metres: self.course.metres.clone(),
                points,
            },
            headings: self.headings.iter().map(|heading| heading + turn).collect(),
        }
    }

    /// What the network is told of it, `[1, PATH_CHANNELS, frames]`.
    pub(super) fn told(&self, fps: f64, device: &Device) -> Tensor<3> {
        of_path(&self.at_origin().course.points, fps, device)
    }

    /// A motion that was drawn along the path as seen from its start, on the path itself.
    fn onto(&self, joints: &Joints) -> Result<Joints, Error> {
        let (start, turn) = (self.course.points[0], self.headings[0]);
        let (sin, cos) = turn.sin_cos();
        let track = joints.track(0);
        let points = track
            .iter()
            .map(|[x, _, z]| [start[0] + x * cos + z * sin, start[1] - x * sin + z * cos]);
        let points: Vec<[f64; 2]> = points.collect();
        Ok(placed(joints, &points, &vec![turn; points.len()])?)
    }

    /// A motion that was drawn as `config` says, on the path.
    ///
    /// # Errors
    /// If it is not of the skeleton.
    pub fn finish(
        &self,
        features: &Features,
        skeleton: &Skeleton,
        config: &PathConfig,
    ) -> Result<Followed, Error> {
        let joints = features.joints();
        if config.method != PathMethod::Warp {
            let joints = self.onto(&joints)?;
            let report = PathReport::of(&joints, skeleton, &self.line, &self.course)?;
            return Ok(Followed {
                joints,
                report,
                legs_short: 0.0,
            });
        }
        let warp = Warp {
            turning: Turning::Relative,
            smooth: true,
            least_speed: Warp::STANDING,
            ..Warp::default()
        };
        // As far as its speed leads in so many frames.
        let line = self
            .line
            .up_to(self.course.metres.last().copied().unwrap_or(0.0));
        let warped = warp.apply(&joints, skeleton, &line);
        let warped = warped.map_err(|error| {
            let message = format!("the motion cannot be moved onto the path: {error}");
            Error::usage(message, "docs/paths.md")
        })?;
        let (joints, legs_short) = match config.fix_feet {
            true => {
                let held = hold(&warped.joints, &joints, skeleton, &ContactRule::default())?;
                (held.joints, held.missed)
            }
            false => (warped.joints, 0.0),
        };
        let report = PathReport::of(&joints, skeleton, &line, &warped.course)?;
        Ok(Followed {
            joints,
            report,
            legs_short,
        })
    }
}

/// A motion on its path.
#[derive(Clone, Debug)]
pub struct Followed {
    /// Where its joints are.
    pub joints: Joints,
    /// How it follows.
    pub report: PathReport,
    /// How far a foot is from where it should stand, at most, as its leg does not reach so far, metres.
    pub legs_short: f64,
}

/// What keeps one draw on its path.
pub(super) struct PathControl<'a> {
    config: &'a PathConfig,
    /// As the draw sees it.
    target: PathTarget,
    root: Root,
    mean: Vec<f64>,
    std: Vec<f64>,
    /// The rotation channel of the last predicted clean motion.
    turning: RefCell<Option<Vec<f64>>>,
    key: Key,
}

impl<'a> PathControl<'a> {
    /// The control of a draw whose features are normalised by `statistics`.
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

    /// Whether the path acts at timestep `t`.
    pub fn acts(&self, t: usize) -> bool {
        t >= self.config.until
    }

    /// The noisy motion that the network is given, `[1, channels, time]`: with the path in it, or a step
    /// nearer to it.
    pub fn noisy(&self, x_t: Tensor<3>, t: usize, diffusion: &GaussianDiffusion) -> Tensor<3> {
        if !self.acts(t) {
            return x_t;
        }
        let mut x_t = x_t;
        let config = self.config;
        if config.method.guides() && !config.through_network {
            let gradient = self.gradient(&x_t);
            x_t = x_t - gradient * config.eta();
        }
        if !config.method.replaces() || config.reading == OverrideReading::Sample {
            return x_t;
        }
        let (keep, noise) = match config.reading {
            OverrideReading::Noised => (
                diffusion.schedule.sqrt_alphas_cumprod[t],
                diffusion.schedule.sqrt_one_minus_alphas_cumprod[t],
            ),
            _ => (1.0, 0.0),
        };
        let frames = x_t.dims()[2];
        let drawn = self.key.at(t as u64).normals(ROOT * frames);
        let noised = self.channels().into_iter().enumerate().map(|(c, values)| {
            let values = values.into_iter().enumerate();
            let noised =
                values.map(|(n, value)| keep * value + noise * f64::from(drawn[c * frames + n]));
            noised.collect()
        });
        self.put(x_t, noised.collect())
    }

    /// The predicted clean motion with the path in it, where that is the reading; and its rotations,
    /// noted for the next step.
    pub fn clean(&self, x_start: Tensor<3>, t: usize) -> Tensor<3> {
        let rotation = self.physical(&x_start).into_iter().map(|[a, ..]| a);
        *self.turning.borrow_mut() = Some(rotation.collect());
        let puts = self.config.method.replaces()
            && self.config.reading == OverrideReading::Sample
            && self.acts(t);
        match puts {
            true => self.put(x_start, self.channels()),
            false => x_start,
        }
    }

    /// The drawn motion: with the path itself where the root was replaced to the end.
    pub fn last(&self, x: Tensor<3>) -> Tensor<3> {
        if !self.config.method.replaces() || !self.acts(0) {
            return x;
        }
        let rotation = self.physical(&x).into_iter().map(|[a, ..]| a);
        *self.turning.borrow_mut() = Some(rotation.collect());
        self.put(x, self.channels())
    }

    /// Normalised root channels on the path, seen from its own headings or those of the draw.
    fn channels(&self) -> Vec<Vec<f64>> {
        let points = &self.target.course.points;
        let turning = self.turning.borrow();
        let headings = match (&*turning, self.config.yaw) {
            (Some(rotations), false) => {
                let rows: Vec<[f64; 4]> = rotations.iter().map(|a| [*a, 0.0, 0.0, 0.0]).collect();
                self.root
                    .half_angles(&rows)
                    .iter()
                    .map(|a| -2.0 * a)
                    .collect()
            }
            _ => self.target.headings.clone(),
        };
        let rows = root_channels(points, &headings, self.root);
        (0..ROOT)
            .map(|c| {
                rows.iter()
                    .map(|row| (row[c] - self.mean[c]) / self.std[c])
                    .collect()
            })
            .collect()
    }

    /// Puts normalised channels in the place of the motion's own; the rotation only with `yaw`.
    fn put(&self, x: Tensor<3>, channels: Vec<Vec<f64>>) -> Tensor<3> {
        let [batch, all, frames] = x.dims();
        assert_eq!(batch, 1, "a path is of one motion");
        let first = usize::from(!self.config.yaw);
        let values: Vec<f32> = channels[first..ROOT]
            .concat()
            .into_iter()
            .map(|value| value as f32)
            .collect();
        let data = TensorData::new(values, [1, ROOT - first, frames]);
        let given = Tensor::from_data(data, &x.device());
        let mut parts = vec![given, x.clone().narrow(1, ROOT, all - ROOT)];
        if first > 0 {
            parts.insert(0, x.narrow(1, 0, first));
        }
        Tensor::cat(parts, 1)
    }

    /// The root's first channels in radians and metres, `[frames]`.
    fn physical(&self, x: &Tensor<3>) -> Vec<[f64; 3]> {
        let [_, _, frames] = x.dims();
        let values = x.clone().narrow(1, 0, ROOT).try_into_vec_as::<f32>();
        let values = values.expect("samples are float32");
        let value =
            |c: usize, n: usize| f64::from(values[c * frames + n]) * self.std[c] + self.mean[c];
        (0..frames)
            .map(|n| [0, 1, 2].map(|c| value(c, n)))
            .collect()
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
