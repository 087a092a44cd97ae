//! The table `sampling.steering`: how a draw is led to its goal.

use kinegrad_motion::goal::{GoalError, GuidanceConfig, GuidanceSchedule};
use serde::{Deserialize, Serialize};

use super::ConfigError;
use crate::Error;

/// How a draw is led to its goal (Guided Motion Diffusion, appendix F).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SteeringConfig {
    /// Strength s of the classifier guidance, 100 to 200 in the paper; 0 guides nothing.
    pub scale: f64,
    /// Whether known positions are put into the draw.
    pub imputation: bool,
    /// The loss whose gradient guides.
    pub guidance: GuidanceConfig,
    /// Which positions act at which timesteps.
    pub schedule: GuidanceSchedule,
}

impl Default for SteeringConfig {
    fn default() -> Self {
        Self {
            scale: 100.0,
            imputation: true,
            guidance: GuidanceConfig::default(),
            schedule: GuidanceSchedule::default(),
        }
    }
}

impl SteeringConfig {
    /// Refuses what no draw can be led by.
    ///
    /// # Errors
    /// Names the first key with a bad value.
    pub fn validate(&self) -> Result<(), Error> {
        ConfigError::unless_at_least_zero("sampling.steering.scale", self.scale)?;
        if self.guidance.frame_limit == Some(0) {
            let key = "sampling.steering.guidance.frame_limit";
            return Err(ConfigError::range(key, 0, "1 or more, or no such key").into());
        }
        self.schedule.validate().map_err(|error| match error {
            GoalError::Invalid {
                key,
                found,
                allowed,
                ..
            } => {
                let key = format!("sampling.steering.schedule.{key}");
                ConfigError::range(key, found, allowed).into()
            }
            other => Error::from(other),
        })
    }
}
