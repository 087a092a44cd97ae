//! The table `steering`: guidance and imputation for goals.

use kinegrad_diffusion::SamplerConfig;
use kinegrad_motion::goal::{GuidanceConfig, GuidanceSchedule};
use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, Refused, in_range};
use kinegrad_train::config::PLAIN;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, to_value};

/// The padding of a clip that is shorter than the sampled length.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Padding {
    /// Noised zeros of normalised motion, as in training: the network infers the length of the clip
    /// from them.
    #[default]
    Zeros,
    /// Padding is sampled as motion and cut off, as in the published program of GMD: for models
    /// whose training clips were never shorter than `data.target_frames`.
    Sampled,
}

/// The table `steering`: guidance and imputation for goals (Guided Motion Diffusion, appendix F).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SteeringConfig {
    /// The padding of clips that are shorter than the sampled length, for recipes `gmd_motion` and
    /// `gmd_trajectory`.
    pub padding: Padding,
    /// Strength s of the classifier guidance, 100 to 200 in the paper; 0 guides nothing.
    pub scale: f64,
    /// Largest shift of a frame by guidance in one step, over all channels of the network's space,
    /// in standard deviations of the step's noise. Unset, the shift is not limited, which with few
    /// steps and a large scale makes some motions diverge. Not in the paper.
    pub max_shift: Option<f64>,
    /// Impute known positions.
    pub imputation: bool,
    /// Guide the second stage along the path of the first, in addition to imputation, as in the
    /// published demonstration; the published evaluation does not.
    pub second_stage_guidance: bool,
    /// Denoising steps of the first stage, whose model is small: paths of few steps shake. Omitted:
    /// those of the second.
    pub first_stage_steps: Option<usize>,
    /// Classifier-free guidance scale of the first stage. Omitted: that of the second.
    pub first_stage_guidance_scale: Option<f64>,
    /// The loss whose gradient guides.
    pub guidance: GuidanceConfig,
    /// The timesteps at which positions act.
    pub schedule: GuidanceSchedule,
}

impl Default for SteeringConfig {
    fn default() -> Self {
        Self {
            padding: Padding::default(),
            scale: 100.0,
            max_shift: None,
            imputation: true,
            second_stage_guidance: true,
            first_stage_steps: None,
            first_stage_guidance_scale: None,
            guidance: GuidanceConfig::default(),
            schedule: GuidanceSchedule::default(),
        }
    }
}

impl SteeringConfig {
    /// The sampler of the first of two stages, where `sampler` is that of the second.
    pub fn first_stage(&self, sampler: &SamplerConfig) -> SamplerConfig {
        let mut first = sampler.clone();
        let scale = &mut first.guidance_scale;
        *scale = self.first_stage_guidance_scale.unwrap_or(*scale);
        let steps = &mut first.num_inference_steps;
        *steps = self.first_stage_steps.unwrap_or(*steps);
        first
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
        in_range("max_shift", self.max_shift.unwrap_or(1.0), ABOVE_ZERO)
            .hint("standard deviations of a step's noise; leave it out for no limit")?;
        self.guidance.validate().within("guidance")?;
        self.schedule.validate().within("schedule")
    }
}
