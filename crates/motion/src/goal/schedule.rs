//! Phases of guidance and imputation over the timesteps.

use kinegrad_settings::{InvalidSetting, Refused, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The targets used in a sampling step.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// The keyframes and the line between them.
    Dense,
    /// The keyframes alone.
    Points,
    /// No targets: the model finishes the motion.
    Off,
}

/// The last timestep, counted down, at which each [`Phase`] acts.
///
/// GMD, appendix F, ends guidance and imputation at t = 20. The published evaluation changes from
/// line to keyframes at t = 100. The published demonstration imputes into the motion model until t
/// = 1.
#[derive(Clone, Debug, Deserialize, Eq, PartialEq, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GuidanceSchedule {
    /// Last timestep at which the line between the keyframes acts.
    pub dense_until: usize,
    /// Last timestep at which keyframes act.
    pub points_until: usize,
    /// Last timestep at which positions are imputed into the motion model's samples (1 in the
    /// published demonstration). The default is 0 along a path, along a detour or with a trajectory
    /// model, else `points_until`, which always ends guidance. Without a trajectory model, single
    /// keyframes end at `points_until` at the latest: the motion would jump to them.
    pub motion_until: Option<usize>,
}

impl Default for GuidanceSchedule {
    fn default() -> Self {
        Self {
            dense_until: 100,
            points_until: 20,
            motion_until: None,
        }
    }
}

impl GuidanceSchedule {
    /// Phase at timestep `t`.
    pub fn phase(&self, t: usize) -> Phase {
        match t {
            _ if t < self.points_until => Phase::Off,
            _ if t < self.dense_until => Phase::Points,
            _ => Phase::Dense,
        }
    }

    /// # Errors
    /// An error if the line outlasts the keyframes.
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
