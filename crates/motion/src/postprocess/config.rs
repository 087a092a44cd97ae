//! Settings of the post-processor.

use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, in_range, require};
use serde::{Deserialize, Serialize};

/// Which of the two quaternions of a rotation, `q` or `-q`, is kept.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Hemisphere {
    /// The one nearer to the frame before, so that no sign jumps in time. The sound rule.
    #[default]
    Continuous,
    /// The one with w >= 0, frame by frame, as CC-MotionGen has it. A turn through w = 0 then jumps
    /// from `q` to `-q` between two frames; most real dances have such turns.
    PositiveW,
}

/// Which differences step 5 blends with.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Differences {
    /// `x[t+1] - x[t]`, as the losses and the checks take them: blending halves what they measure.
    #[default]
    Forward,
    /// `x[t] - x[t-1]`, as CC-MotionGen has it, which may make it worse (docs/sources.md, section
    /// 1.14, hazard 9).
    Backward,
}

/// Largest absolute value of each component (CC-MotionGen, section 9.1; docs/sources.md, section
/// 1.12).
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
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

/// A ready configuration of the post-processor.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PostProcessProfile {
    /// [`PostProcessConfig::default`], the sound reading.
    #[default]
    Default,
    /// [`PostProcessConfig::document`], CC-MotionGen's to the letter.
    #[serde(rename = "ccmotion")]
    Document,
    /// [`PostProcessConfig::none`]: the raw output of the model.
    None,
}

impl From<PostProcessProfile> for PostProcessConfig {
    fn from(profile: PostProcessProfile) -> Self {
        match profile {
            PostProcessProfile::Default => Self::default(),
            PostProcessProfile::Document => Self::document(),
            PostProcessProfile::None => Self::none(),
        }
    }
}

/// What [`process`](super::process) does (CC-MotionGen, section 9.1; docs/sources.md, section
/// 1.12).
///
/// [`default`](Self::default) is the sound reading, [`document`](Self::document) the literal one,
/// and [`none`](Self::none) does nothing; the steps stand in the order in which they run.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct PostProcessConfig {
    /// Step 1: clamp position, velocity, acceleration and angular velocity to `limits`.
    pub clamp_values: bool,
    /// Bounds of the clamps.
    pub limits: ClampLimits,
    /// Widen each channel's bounds to the range of the training phrases, where their statistics are
    /// at hand: real dances turn faster than CC-MotionGen's 10 rad/s.
    pub widen_limits: bool,
    /// Step 2: bring quaternions to unit norm and to one `hemisphere`.
    pub normalize_quaternions: bool,
    /// Which of `q` and `-q` steps 2 and 3 keep.
    pub hemisphere: Hemisphere,
    /// Step 3: replace each quaternion by the mean of its neighbours.
    pub smooth_quaternions: bool,
    /// Frames in that mean, odd.
    pub quaternion_smoothing_window: usize,
    /// Step 4: clamp the phase to [0, 1].
    pub clamp_phase: bool,
    /// Step 4: hold the phase where it steps back by at most half a bar.
    pub enforce_phase_monotonic: bool,
    /// Step 5: blend velocity half and half with the differences of position.
    pub enforce_velocity_coherence: bool,
    /// Step 5: blend acceleration half and half with the differences of velocity.
    pub enforce_accel_coherence: bool,
    /// Which differences those are.
    pub differences: Differences,
    /// Step 6: replace vectors and style by their mean over neighbouring frames.
    pub apply_smoothing: bool,
    /// Frames in that mean, odd.
    pub smoothing_kernel_size: usize,
    /// Step 7: replace position, velocity, acceleration, quaternions and phase by those of the
    /// nearest motion that agrees with itself ([`crate::coherence`]), where the training phrases'
    /// statistics are at hand. Not in CC-MotionGen. Positions then move as the accelerations say,
    /// whatever the network: coherence of such motion is no merit of its training.
    pub fit_coherent_motion: bool,
    /// Step 8: replace the angular velocity by that of the quaternions as written. CC-MotionGen
    /// leaves the two unrelated.
    pub derive_angular_velocity: bool,
}

impl Default for PostProcessConfig {
    /// Unit norm, signs continuous in time, phase clamped, clamps no tighter than the training
    /// range, the nearest coherent motion, angular velocity that of the quaternions.
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
    /// CC-MotionGen's defaults: w >= 0 in every frame, its clamps as they stand, backward
    /// differences, every channel as the model says.
    pub fn document() -> Self {
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
            hemisphere: Hemisphere::Continuous,
            smooth_quaternions: false,
            quaternion_smoothing_window: 5,
            clamp_phase: false,
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

    /// Rejects even windows and limits that are not positive and finite.
    ///
    /// # Errors
    /// Names the first such setting.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        for (key, frames) in [
            (
                "quaternion_smoothing_window",
                self.quaternion_smoothing_window,
            ),
            ("smoothing_kernel_size", self.smoothing_kernel_size),
        ] {
            let allowed = "an odd number of frames: 1, 3, 5, ...";
            require(!frames.is_multiple_of(2), key, frames, allowed)?;
        }
        let limits = &self.limits;
        in_range("limits.position", limits.position, ABOVE_ZERO)?;
        in_range("limits.velocity", limits.velocity, ABOVE_ZERO)?;
        in_range("limits.acceleration", limits.acceleration, ABOVE_ZERO)?;
        in_range(
            "limits.angular_velocity",
            limits.angular_velocity,
            ABOVE_ZERO,
        )
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
        assert_eq!(config, PostProcessConfig::document());
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
            PostProcessConfig::document(),
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
