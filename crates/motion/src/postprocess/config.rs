//! Settings of the post-processor.

use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, in_range, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The sign of a rotation's quaternion, `q` or `-q`.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, JsonSchema, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Hemisphere {
    /// The sign nearer to the previous frame: continuous in time.
    #[default]
    Continuous,
    /// `w >= 0` in every frame, as in CC-MotionGen. Rotations through `w = 0` are common in real
    /// dances and flip the sign between two frames.
    PositiveW,
}

/// Differences of step 5.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, JsonSchema, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Differences {
    /// `x[t+1] - x[t]`, as in the losses and checks.
    #[default]
    Forward,
    /// `x[t] - x[t-1]`, as in CC-MotionGen (docs/sources.md, section 1.14, hazard 9).
    Backward,
}

/// Largest absolute value of each component (docs/sources.md, section 1.12).
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClampLimits {
    /// Position, metres.
    pub position: f64,
    /// Velocity, metres per second.
    pub velocity: f64,
    /// Acceleration, metres per second squared.
    pub acceleration: f64,
    /// Angular velocity, radians per second.
    pub angular_velocity: f64,
}

impl Default for ClampLimits {
    fn default() -> Self {
        Self {
            position: 100.0,
            velocity: 50.0,
            acceleration: 100.0,
            angular_velocity: 10.0,
        }
    }
}

/// A preset of the post-processor.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PostProcessProfile {
    /// [`PostProcessConfig::default`].
    #[default]
    Default,
    /// [`PostProcessConfig::ccmotion`], exactly as in CC-MotionGen.
    Ccmotion,
    /// [`PostProcessConfig::none`]: the raw output of the model.
    None,
}

impl From<PostProcessProfile> for PostProcessConfig {
    fn from(profile: PostProcessProfile) -> Self {
        match profile {
            PostProcessProfile::Default => Self::default(),
            PostProcessProfile::Ccmotion => Self::ccmotion(),
            PostProcessProfile::None => Self::none(),
        }
    }
}

/// Settings of [`process`](super::process) (CC-MotionGen, section 9.1; docs/sources.md, section
/// 1.12), in the order of the steps. Presets: [`default`](Self::default),
/// [`ccmotion`](Self::ccmotion) and [`none`](Self::none).
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct PostProcessConfig {
    /// Step 1: clamp position, velocity, acceleration and angular velocity to `limits`.
    pub clamp_values: bool,
    /// Limits of the clamps.
    pub limits: ClampLimits,
    /// Widen limits to the range of the training phrases, if known. Real dances exceed 10 rad/s.
    pub widen_limits: bool,
    /// Step 2: normalize quaternions, with signs by `hemisphere`.
    pub normalize_quaternions: bool,
    /// Norm below which a quaternion has no direction: the previous one is repeated.
    pub quaternion_eps: f64,
    /// Sign of quaternions in steps 2 and 3.
    pub hemisphere: Hemisphere,
    /// Step 3: replace each quaternion by the mean of its neighbors.
    pub smooth_quaternions: bool,
    /// Frames in that mean, odd.
    pub quaternion_smoothing_window: usize,
    /// Step 4: clamp the phase to `phase_min` and `phase_max`.
    pub clamp_phase: bool,
    /// Smallest clamped phase, bars.
    pub phase_min: f64,
    /// Largest clamped phase, bars.
    pub phase_max: f64,
    /// Step 4: hold the phase at backward steps of at most half a bar.
    pub enforce_phase_monotonic: bool,
    /// Step 5: average the velocity with position differences.
    pub enforce_velocity_coherence: bool,
    /// Step 5: average the acceleration with velocity differences.
    pub enforce_accel_coherence: bool,
    /// Differences of step 5.
    pub differences: Differences,
    /// Step 6: replace vectors and style by their mean over neighboring frames.
    pub apply_smoothing: bool,
    /// Frames in that mean, odd.
    pub smoothing_kernel_size: usize,
    /// Step 7: fit the nearest coherent motion, if training statistics are known. Not in CC-MotionGen. The coherence of a fitted motion does not measure the network.
    pub fit_coherent_motion: bool,
    /// Step 8: derive the angular velocity from the quaternions. Not in CC-MotionGen.
    pub derive_angular_velocity: bool,
}

impl Default for PostProcessConfig {
    /// Normalized quaternions, clamps at least as wide as the training range, coherent motion.
    fn default() -> Self {
        Self {
            clamp_values: true,
            widen_limits: true,
            normalize_quaternions: true,
            hemisphere: Hemisphere::Continuous,
            clamp_phase: true,
            fit_coherent_motion: true,
            derive_angular_velocity: true,
            ..Self::none()
        }
    }
}

impl PostProcessConfig {
    /// CC-MotionGen's defaults: `w >= 0`, its limits, backward differences, no fit.
    pub fn ccmotion() -> Self {
        Self {
            widen_limits: false,
            hemisphere: Hemisphere::PositiveW,
            differences: Differences::Backward,
            fit_coherent_motion: false,
            derive_angular_velocity: false,
            ..Self::default()
        }
    }

    /// Every step off.
    pub fn none() -> Self {
        Self {
            clamp_values: false,
            limits: ClampLimits::default(),
            widen_limits: false,
            normalize_quaternions: false,
            quaternion_eps: 1e-8,
            hemisphere: Hemisphere::Continuous,
            smooth_quaternions: false,
            quaternion_smoothing_window: 5,
            clamp_phase: false,
            phase_min: 0.0,
            phase_max: 1.0,
            enforce_phase_monotonic: false,
            enforce_velocity_coherence: false,
            enforce_accel_coherence: false,
            differences: Differences::Forward,
            apply_smoothing: false,
            smoothing_kernel_size: 3,
            fit_coherent_motion: false,
            derive_angular_velocity: false,
        }
    }

    /// # Errors
    /// Errors for even windows, for limits and `quaternion_eps` that are not positive and finite, and
    /// for a `phase_min` above `phase_max`.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        let keys = ["quaternion_smoothing_window", "smoothing_kernel_size"];
        let windows = [self.quaternion_smoothing_window, self.smoothing_kernel_size];
        for (key, frames) in keys.into_iter().zip(windows) {
            let allowed = "an odd number of frames: 1, 3, 5, ...";
            require(!frames.is_multiple_of(2), key, frames, allowed)?;
        }
        in_range("quaternion_eps", self.quaternion_eps, ABOVE_ZERO)?;
        in_range("phase_max", self.phase_max, ..)?;
        in_range("phase_min", self.phase_min, ..=self.phase_max)?;
        let limits = &self.limits;
        in_range("limits.position", limits.position, ABOVE_ZERO)?;
        in_range("limits.velocity", limits.velocity, ABOVE_ZERO)?;
        in_range("limits.acceleration", limits.acceleration, ABOVE_ZERO)?;
        let rate = limits.angular_velocity;
        in_range("limits.angular_velocity", rate, ABOVE_ZERO)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_keys_take_the_default_and_unknown_ones_are_refused() {
        let read = |json: &str| serde_json::from_str::<PostProcessConfig>(json);
        assert_eq!(read("{}").unwrap(), PostProcessConfig::default());
        let config = read(
            r#"{"hemisphere": "positive_w", "widen_limits": false, "differences": "backward",
                "fit_coherent_motion": false, "derive_angular_velocity": false}"#,
        )
        .unwrap();
        assert_eq!(config, PostProcessConfig::ccmotion());
        let config = read(r#"{"limits": {"velocity": 20}}"#).unwrap();
        assert_eq!(
            config.limits,
            ClampLimits {
                velocity: 20.0,
                ..ClampLimits::default()
            }
        );
        assert!(read(r#"{"clamp_value": true}"#).is_err());
        assert!(read(r#"{"limits": {"speed": 20}}"#).is_err());
        assert!(read(r#"{"hemisphere": "north"}"#).is_err());
    }

    #[test]
    fn ready_configurations_are_valid() {
        for config in [
            PostProcessConfig::default(),
            PostProcessConfig::ccmotion(),
            PostProcessConfig::none(),
        ] {
            assert_eq!(config.validate(), Ok(()));
            let text = serde_json::to_string(&config).unwrap();
            assert_eq!(
                serde_json::from_str::<PostProcessConfig>(&text).unwrap(),
                config
            );
        }
    }
}
