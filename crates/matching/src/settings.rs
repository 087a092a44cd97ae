//! Settings of a synthesis, and the presets.

use std::fmt::{self, Display};
use std::str::FromStr;

use kinegrad_settings::{ABOVE_ZERO, InvalidSetting, Refused, in_range, require};
use serde::{Deserialize, Serialize};

use crate::Distance;

/// Length of the coarsest level.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
#[serde(try_from = "String", into = "String")]
pub enum CoarseRatio {
    /// Coarsest length of the longest example in patch sizes, K of the paper; written `5x`.
    Patches(f64),
    /// As a part of the length of each motion; written `0.15`.
    Ratio(f64),
}

impl CoarseRatio {
    /// The coarsest length relative to each motion's length. `longest`: frames of the longest
    /// example.
    pub fn ratio(self, patch_size: usize, longest: usize) -> f64 {
        match self {
            Self::Patches(patches) => patches * patch_size as f64 / longest as f64,
            Self::Ratio(ratio) => ratio,
        }
    }
}

impl Display for CoarseRatio {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Patches(patches) => write!(f, "{patches}x"),
            Self::Ratio(ratio) => write!(f, "{ratio}"),
        }
    }
}

impl From<CoarseRatio> for String {
    fn from(ratio: CoarseRatio) -> Self {
        ratio.to_string()
    }
}

impl FromStr for CoarseRatio {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| text.trim().parse::<f64>().ok();
        let parsed = match text.strip_suffix('x') {
            Some(patches) => number(patches).map(Self::Patches),
            None => number(text).map(Self::Ratio),
        };
        let allowed = "allowed: patch sizes of the longest example, as 5x, or a part of each \
                       length, as 0.15";
        parsed.ok_or_else(|| allowed.to_string())
    }
}

impl TryFrom<String> for CoarseRatio {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

/// Start of the coarsest level.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Start {
    /// The joined examples, resampled, plus noise, modulo 1, as in the published program.
    Examples,
    /// Noise alone, as in the paper.
    Noise,
}

/// Loops: motions whose last frame is followed by the first.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Looping {
    /// No loop.
    #[default]
    Off,
    /// The loop of the published program: near the seam a frame is the mean of the means of both
    /// sides, and half a patch from the seam the motion jumps.
    Halves,
    /// Every frame is the mean of all patches that cover it around the loop; the seam is not special.
    Even,
}

/// Presets of the settings.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// The published program: K 5, 3 steps, mean square, examples with noise, one part.
    #[default]
    Published,
    /// The paper: K 4, 5 steps, Euclidean distance, noise alone, body parts, foot contacts.
    Paper,
}

/// Settings of a synthesis.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Frames of a patch, p; odd. Smaller patches make transitions more frequent.
    pub patch_size: usize,
    /// Length of a level divided by the length of the next finer level.
    pub pyr_factor: f64,
    /// Length of the coarsest level, K. More patches give more variety and less coherence.
    pub coarse_ratio: CoarseRatio,
    /// Completeness: example patches far from the motion gain weight. In measurements, a smaller
    /// value shows more of the example; the paper states this and the contrary. `None` turns
    /// completeness off.
    pub alpha: Option<f64>,
    /// Standard deviation of the noise of the coarsest level; 0 is no noise.
    pub sigma: f64,
    /// Steps of matching and voting at each level, E.
    pub num_steps: usize,
    /// Preference for the patch that follows the match before: how much further away than the nearest
    /// it may be, in median distances of neighbouring example patches. 0, as in the published
    /// program, takes the nearest.
    #[serde(default)]
    pub continuity: f64,
    /// Distance of two patches.
    pub distance: Distance,
    /// Start of the coarsest level.
    pub start: Start,
    /// Looping of the motion.
    pub looping: Looping,
}

impl Default for Settings {
    fn default() -> Self {
        Self::of(Preset::default())
    }
}

impl Settings {
    /// The settings of a preset, without body parts and contacts.
    pub fn of(preset: Preset) -> Self {
        let published = Self {
            patch_size: 11,
            pyr_factor: 0.75,
            coarse_ratio: CoarseRatio::Patches(5.0),
            alpha: Some(0.01),
            sigma: 10.0,
            num_steps: 3,
            continuity: 0.0,
            distance: Distance::MeanSquare,
            start: Start::Examples,
            looping: Looping::Off,
        };
        match preset {
            Preset::Published => published,
            Preset::Paper => Self {
                coarse_ratio: CoarseRatio::Patches(4.0),
                sigma: 1.0,
                num_steps: 5,
                distance: Distance::L2,
                start: Start::Noise,
                ..published
            },
        }
    }

    /// One control from mixing (0) to copying (1) in place of K and alpha: K falls from 12 to 2
    /// patch sizes and alpha rises from 0.001 to 0.1, both geometrically.
    ///
    /// # Errors
    /// If `coherence` is not between 0 and 1.
    pub fn with_coherence(self, coherence: f64) -> Result<Self, InvalidSetting> {
        in_range("coherence", coherence, 0.0..=1.0)
            .hint("0 mixes most, 1 copies long stretches of the example")?;
        let between = |from: f64, to: f64| from * (to / from).powf(coherence);
        Ok(Self {
            coarse_ratio: CoarseRatio::Patches(between(12.0, 2.0)),
            alpha: Some(between(0.001, 0.1)),
            ..self
        })
    }

    /// Checks the ranges of all settings.
    ///
    /// # Errors
    /// The error names the setting.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        let odd = self.patch_size % 2 == 1 && self.patch_size > 1;
        require(odd, "patch_size", self.patch_size, "an odd number from 3")
            .hint("11 frames are a third of a second")?;
        let hint = "0.75 makes each level a third longer than the one before";
        in_range("pyr_factor", self.pyr_factor, 0.1..=0.99).hint(hint)?;
        let (CoarseRatio::Patches(ratio) | CoarseRatio::Ratio(ratio)) = self.coarse_ratio;
        in_range("coarse_ratio", ratio, ABOVE_ZERO).hint("5x is the published program's")?;
        if let Some(alpha) = self.alpha {
            in_range("alpha", alpha, 1e-9..=1e9).hint("0.01; `none` leaves completeness out")?;
        }
        in_range("continuity", self.continuity, 0.0..=1e6).hint("0 takes the nearest patch")?;
        in_range("sigma", self.sigma, 0.0..=1e6).hint("0 is no noise")?;
        in_range("num_steps", self.num_steps, 1..=1000).hint("3 to 5 are usual")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coarse_ratios_are_read_as_they_are_written() {
        for (text, ratio) in [
            ("5x", CoarseRatio::Patches(5.0)),
            ("0.15", CoarseRatio::Ratio(0.15)),
        ] {
            assert_eq!(text.parse(), Ok(ratio));
            assert_eq!(ratio.to_string(), text);
        }
        assert!("five".parse::<CoarseRatio>().is_err());
        let ratio = CoarseRatio::Patches(5.0).ratio(11, 371);
        assert!((ratio - 0.148_247_978).abs() < 1e-8);
    }

    #[test]
    fn settings_out_of_range_are_named() {
        let published = Settings::of(Preset::Published);
        published.validate().unwrap();
        Settings::of(Preset::Paper).validate().unwrap();
        let refused = |change: fn(&mut Settings)| {
            let mut settings = Settings::of(Preset::Published);
            change(&mut settings);
            settings.validate().unwrap_err().key
        };
        assert_eq!(refused(|s| s.patch_size = 10), "patch_size");
        assert_eq!(refused(|s| s.patch_size = 1), "patch_size");
        assert_eq!(refused(|s| s.pyr_factor = 1.0), "pyr_factor");
        assert_eq!(refused(|s| s.alpha = Some(0.0)), "alpha");
        assert_eq!(refused(|s| s.sigma = f64::NAN), "sigma");
        assert_eq!(refused(|s| s.num_steps = 0), "num_steps");
        let zero = |s: &mut Settings| s.coarse_ratio = CoarseRatio::Ratio(0.0);
        assert_eq!(refused(zero), "coarse_ratio");
        assert!(published.with_coherence(1.5).is_err());
    }

    #[test]
    fn coherence_lowers_the_number_of_patches() {
        let at = |coherence| {
            let settings = Settings::of(Preset::Published)
                .with_coherence(coherence)
                .unwrap();
            (settings.coarse_ratio.ratio(1, 1), settings.alpha.unwrap())
        };
        let close = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).abs() + (a.1 - b.1).abs() < 1e-9;
        assert!(close(at(0.0), (12.0, 0.001)) && close(at(1.0), (2.0, 0.1)));
        assert!(at(0.5).0 < at(0.2).0 && at(0.5).1 > at(0.2).1);
    }
}
