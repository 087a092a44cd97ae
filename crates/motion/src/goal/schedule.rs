//! The phases of guidance and imputation over the timesteps.

use kinegrad_settings::{InvalidSetting, Refused, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The targets that are used in a step.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// The keyframes and the line between them.
    Dense,
    /// The keyframes alone.
    Points,
    /// None: the model finishes the motion by itself.
    Off,
}

/// Until which timestep of a sampler, counted down, each [`Phase`] acts.
///
/// The appendix (GMD, F) ends guidance and imputation at t = 20; the published evaluation changes
/// from the line to the keyframes at t = 100. The published demonstration goes on to t = 1 with
/// the motion model, which is `points_until = 1` here.
#[derive(Clone, Debug, Deserialize, Eq, PartialEq, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GuidanceSchedule {
    /// Last timestep at which the line between the keyframes acts with them; below it they act
    /// alone.
    pub dense_until: usize,
    /// Last timestep at which keyframes act; below it the model finishes the motion by itself.
    pub points_until: usize,
}

impl Default for GuidanceSchedule {
    fn default() -> Self {
        Self {
            dense_until: 100,
            points_until: 20,
        }
    }
}

impl GuidanceSchedule {
    /// What acts at timestep `t`.
    pub fn phase(&self, t: usize) -> Phase {
        if t >= self.dense_until {
            Phase::Dense
        } else if t >= self.points_until {
            Phase::Points
        } else {
            Phase::Off
        }
    }

    /// Rejects a line that acts longer than its keyframes.
    ///
    /// # Errors
    /// Names `dense_until`.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        let allowed = format!("{} (`points_until`) or more", self.points_until);
        let (dense, points) = (self.dense_until, self.points_until);
        require(dense >= points, "dense_until", dense, allowed)
            .hint("timesteps count down: the line between keyframes ends before they do")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_ends_at_100_and_the_points_at_20() {
        let schedule = GuidanceSchedule::default();
        let phases = [999, 100, 99, 20, 19, 0].map(|t| schedule.phase(t));
        let expected = [
            Phase::Dense,
            Phase::Dense,
            Phase::Points,
            Phase::Points,
            Phase::Off,
            Phase::Off,
        ];
        assert_eq!(phases, expected);
    }

    #[test]
    fn a_line_without_its_key_frames_is_refused() {
        let read = |json: &str| serde_json::from_str::<GuidanceSchedule>(json);
        let schedule = read(r#"{"dense_until": 5}"#).unwrap();
        let message = schedule.validate().unwrap_err().to_string();
        assert_eq!(
            message,
            "`dense_until` is 5, allowed: 20 (`points_until`) or more"
        );
        read(r#"{"dense_until": 20}"#).unwrap().validate().unwrap();
        assert!(read(r#"{"dense": 20}"#).is_err());
    }
}
