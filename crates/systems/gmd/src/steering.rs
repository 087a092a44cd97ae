//! The table `steering`: guidance and imputation for goals.

use kinegrad_diffusion::SamplerConfig;
use kinegrad_motion::goal::{Goal, GuidanceConfig, GuidanceSchedule};
use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, Refused, in_range};
use kinegrad_train::config::PLAIN;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, to_value};

/// The padding of a clip that is shorter than the sampled length.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Padding {
    /// Noised zeros of normalized motion, as in training; the network infers the clip's length from
    /// the zeros.
    #[default]
    Zeros,
    /// Padding is sampled as motion and cut off, as in GMD's published program. For models with no
    /// training clips shorter than `data.target_frames`.
    Sampled,
}

/// The table `steering`: guidance and imputation for goals (Guided Motion Diffusion, appendix F).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SteeringConfig {
    /// The padding of clips that are shorter than the sampled length, for recipes `gmd_motion` and
    /// `gmd_trajectory`.
    pub padding: Padding,
    /// Strength s of the classifier guidance, 100 to 200 in the paper; 0 disables guidance.
    pub scale: f64,
    /// Largest shift of a frame by guidance in one step, over all channels of the network's space,
    /// in standard deviations of the step's noise: without a limit, small models diverge. Not in the
    /// paper; a large number such as 1e6 removes the limit.
    pub max_shift: f64,
    /// Maximum number of samples of a root path, or of a clip with a goal. A sample is replaced by one
    /// of other noise if its root moves faster than 1.5 times the fastest training step, is inside an
    /// obstacle, or starts more than 0.5 m from the origin; the best is kept. 1 in the paper.
    pub attempts: usize,
    /// Impute known positions.
    pub imputation: bool,
    /// Among obstacles, impute the shortest lines between keyframes that go around them, until
    /// `schedule.points_until`, and without a trajectory model until `schedule.motion_until`. The
    /// paper imputes the keyframes alone.
    pub detours: bool,
    /// Guide the second stage along the first stage's path, in addition to imputation. The
    /// published demonstration guides the second stage; the published evaluation does not.
    pub second_stage_guidance: bool,
    /// Denoising steps of the first stage; paths of few steps shake, and the first stage's model is
    /// small. Omitted: the second stage's steps.
    pub first_stage_steps: Option<usize>,
    /// Classifier-free guidance scale of the first stage. Omitted: the second stage's scale.
    pub first_stage_guidance_scale: Option<f64>,
    /// For a path-conditioned network (`model.path`), which is given the path of a goal or of the
    /// first stage: guidance scale of the path. Scales other than 1 and 0 sample with two passes, with
    /// and without the path; 0 ignores it.
    pub path_guidance_scale: f64,
    /// The loss whose gradient guides.
    pub guidance: GuidanceConfig,
    /// The timesteps at which imputation and guidance act.
    pub schedule: GuidanceSchedule,
}

impl Default for SteeringConfig {
    fn default() -> Self {
        Self {
            padding: Padding::default(),
            scale: 100.0,
            max_shift: 1.0,
            attempts: 4,
            imputation: true,
            detours: true,
            second_stage_guidance: true,
            first_stage_steps: None,
            first_stage_guidance_scale: None,
            path_guidance_scale: 1.0,
            guidance: GuidanceConfig::default(),
            schedule: GuidanceSchedule::default(),
        }
    }
}

impl SteeringConfig {
    /// The sampler of the first stage; `sampler` is the second stage's sampler.
    pub fn first_stage(&self, sampler: &SamplerConfig) -> SamplerConfig {
        let mut first = sampler.clone();
        let scale = &mut first.guidance_scale;
        *scale = self.first_stage_guidance_scale.unwrap_or(*scale);
        let steps = &mut first.num_inference_steps;
        *steps = self.first_stage_steps.unwrap_or(*steps);
        first
    }

    /// Frames of a clip of which no length is asked for, of a model of `target_frames`: all, or a
    /// tenth less if padding is sampled, because the last frames of the sampled length are less
    /// accurate.
    pub(super) fn usual_frames(&self, target_frames: usize) -> usize {
        match self.padding {
            Padding::Zeros => target_frames,
            Padding::Sampled => target_frames - target_frames / 10,
        }
    }

    /// True if the lines between the keyframes of `goal` go around its obstacles.
    pub(super) fn has_detours(&self, goal: &Goal) -> bool {
        self.detours && goal.trajectory.is_none() && !goal.obstacles.is_empty()
    }

    /// The settings along a path with a position for each frame: unless `schedule.motion_until` says
    /// otherwise, it is imputed to the last step. The motion model would leave it again.
    #[must_use]
    pub(super) fn along_path(&self) -> Self {
        let mut along = self.clone();
        along.schedule.motion_until.get_or_insert(0);
        along
    }

    /// The padding and the other settings, for a record.
    pub(super) fn record(&self) -> (Value, Value) {
        let mut rest = to_value(self).expect(PLAIN);
        let padding = rest.as_object_mut().and_then(|keys| keys.remove("padding"));
        (padding.expect("a key"), rest)
    }

    /// # Errors
    /// Names the first key with a bad value.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        in_range("scale", self.scale, 0.0..)?;
        in_range("max_shift", self.max_shift, ABOVE_ZERO)
            .hint("standard deviations of a step's noise; 1e6 removes the limit")?;
        in_range("attempts", self.attempts, 1..=100)?;
        in_range("path_guidance_scale", self.path_guidance_scale, 0.0..)?;
        self.guidance.validate().within("guidance")?;
        self.schedule.validate().within("schedule")
    }
}
