//! The guidance loss of a goal and its gradient.

use kinegrad_settings::{InvalidSetting, Refused, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Goal, GroundTargets};

/// The norm of the distance from a target.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GuidanceNorm {
    /// Absolute differences, p = 1 in the source.
    #[default]
    L1,
    /// Squared differences, as in the published demonstration.
    Mse,
}

/// Settings of the [`GuidanceLoss`].
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GuidanceConfig {
    /// The norm of the distance from a target.
    pub norm: GuidanceNorm,
    /// Number of frames, from the first on, in the sum of distances. The divisor counts the targets
    /// of all frames. 120 in the published programs; the default is all frames.
    pub frame_limit: Option<usize>,
}

impl GuidanceConfig {
    /// # Errors
    /// An error for a limit of 0.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        in_range("frame_limit", self.frame_limit.unwrap_or(1), 1..)
            .hint("leave it out to guide all frames")
    }
}

/// The loss that guides a sampler towards the goals of a batch (GMD, appendix F):
///
/// ```text
/// L = B / M sum_b w_b sum_n m |p - g|                        m (p - g)^2 for the squared norm
///   + sum_b v_b / N_b sum_obstacles sum_n max(0, margin_b - d(p))
/// ```
///
/// p is the ground position `[x, z]` of sample b in frame n, g its target, m the mask of targets, M
/// the number of masked values in the batch of B samples. d is the signed distance from an
/// obstacle, N_b the number of the goal's frames, w and v the goal's weights.
#[derive(Clone, Debug)]
pub struct GuidanceLoss {
    norm: GuidanceNorm,
    frame_limit: usize,
    frames: usize,
    factor: f64,
    samples: Vec<Sample>,
}

#[derive(Clone, Debug)]
struct Sample {
    targets: GroundTargets,
    goal: Goal,
}

impl GuidanceLoss {
    /// The loss of a batch of `frames` frames with one goal per sample. Frames after a goal's end
    /// are free.
    ///
    /// # Errors
    /// The errors of [`Goal::validate`] and [`GuidanceConfig::validate`]; an error for too long
    /// goals.
    pub fn new(
        config: &GuidanceConfig,
        goals: &[Goal],
        frames: usize,
    ) -> Result<Self, InvalidSetting> {
        config.validate()?;
        for goal in goals {
            goal.validate()?;
            let allowed = format!("at most {frames}, the length of the motion");
            require(goal.frames <= frames, "frames", goal.frames, allowed)
                .hint("shorten the goal, or sample a longer motion")?;
        }
        let samples = goals.iter().map(|goal| Sample {
            targets: goal.points(),
            goal: goal.clone(),
        });
        let samples: Vec<Sample> = samples.collect();
        Ok(Self {
            norm: config.norm,
            frame_limit: config.frame_limit.unwrap_or(frames),
            frames,
            factor: factor(&samples),
            samples,
        })
    }

    /// The loss with `paths`, one per goal, instead of the goals' targets.
    ///
    /// # Errors
    /// The errors of [`new`](Self::new).
    pub fn along(
        config: &GuidanceConfig,
        goals: &[Goal],
        paths: &[Vec<[f64; 2]>],
        frames: usize,
    ) -> Result<Self, InvalidSetting> {
        assert_eq!(goals.len(), paths.len(), "a path for each goal");
        let mut loss = Self::new(config, goals, frames)?;
        for (sample, path) in loss.samples.iter_mut().zip(paths) {
            assert!(path.len() <= frames, "a frame for each position");
            sample.targets = GroundTargets::trajectory(path, 0, path.len());
        }
        loss.factor = factor(&loss.samples);
        Ok(loss)
    }

    /// The loss of ground positions `[batch, frames, 2]` in metres, and the gradient. At kinks the
    /// subgradient is 0: at the margin, and at the target under the absolute norm.
    pub fn evaluate(&self, positions: &[f64]) -> (f64, Vec<f64>) {
        let width = 2 * self.frames;
        let expected = self.samples.len() * width;
        assert_eq!(positions.len(), expected, "x and z of all frames");
        let mut value = 0.0;
        let mut gradient = vec![0.0; positions.len()];
        for (index, sample) in self.samples.iter().enumerate() {
            let range = index * width..(index + 1) * width;
            let (positions, _) = positions[range.clone()].as_chunks::<2>();
            let (gradient, _) = gradient[range].as_chunks_mut::<2>();
            value += self.add_distances(sample, positions, gradient);
            value += sample.add_depths(positions, gradient);
        }
        (value, gradient)
    }

    /// The sample's part of the first sum; its gradient is added to `gradient`.
    fn add_distances(
        &self,
        sample: &Sample,
        positions: &[[f64; 2]],
        gradient: &mut [[f64; 2]],
    ) -> f64 {
        let factor = self.factor * sample.goal.weights.position;
        let mut value = 0.0;
        let guided = |(frame, _): &(usize, [f64; 2])| *frame < self.frame_limit;
        for (frame, target) in sample.targets.masked().filter(guided) {
            for axis in 0..2 {
                let difference = positions[frame][axis] - target[axis];
                let (term, slope) = match self.norm {
                    GuidanceNorm::L1 => (difference.abs(), sign(difference)),
                    GuidanceNorm::Mse => (difference.powi(2), 2.0 * difference),
                };
                value += factor * term;
                gradient[frame][axis] += factor * slope;
            }
        }
        value
    }
}

impl Sample {
    /// The sample's part of the second sum; its gradient is added to `gradient`.
    fn add_depths(&self, positions: &[[f64; 2]], gradient: &mut [[f64; 2]]) -> f64 {
        // Later frames are free.
        let frames = self.goal.frames;
        let factor = self.goal.weights.obstacle / frames as f64;
        let mut value = 0.0;
        for obstacle in &self.goal.obstacles {
            for (position, gradient) in positions.iter().zip(gradient.iter_mut()).take(frames) {
                let (distance, direction) = obstacle.distance_and_gradient(*position);
                let depth = self.goal.margin - distance;
                // NaN must not count as outside.
                if depth <= 0.0 {
                    continue;
                }
                value += factor * depth;
                for axis in 0..2 {
                    gradient[axis] -= factor * direction[axis];
                }
            }
        }
        value
    }
}

/// B / M, the factor of each term of the first sum.
fn factor(samples: &[Sample]) -> f64 {
    let masked: usize = samples.iter().map(|s| 2 * s.targets.masked().count()).sum();
    // Without targets the sum is empty.
    samples.len() as f64 / masked.max(1) as f64
}

/// -1, 0 or 1; NaN stays NaN.
fn sign(value: f64) -> f64 {
    if value == 0.0 { 0.0 } else { value.signum() }
}
