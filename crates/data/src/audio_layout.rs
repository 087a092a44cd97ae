//! Groups of audio features.

use kinegrad_audio::pulse::BEAT_FEATURES;
use kinegrad_settings::{InvalidSetting, Refused, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::features::{BEATS, FEATURES};

/// Number of audio features per frame, without beat features.
pub const AUDIO_CHANNELS: usize = 163;

/// A group of audio features.
#[derive(Clone, Copy, Debug, Deserialize, Eq, JsonSchema, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum AudioGroup {
    /// The 163 features of CC-MotionGen, sections 4.1 and 4.3.
    Ccmotion,
    /// Sine and cosine of the phase in the beat and, with a known downbeat, in the bar; beat marks;
    /// local tempo.
    Beats,
}

/// The ordered groups of audio features that condition a model.
#[derive(Clone, Copy, Debug, Default, Eq, PartialEq)]
pub struct AudioLayout {
    /// True if the seven beat features follow the 163 others.
    pub beats: bool,
}

impl AudioLayout {
    /// The 163 features alone.
    pub const CCMOTION: Self = Self { beats: false };

    /// The 163 features, followed by the beat features.
    pub const WITH_BEATS: Self = Self { beats: true };

    /// The layout of `groups`, which must be [valid](check_groups).
    pub fn of(groups: &[AudioGroup]) -> Self {
        Self {
            beats: groups.contains(&AudioGroup::Beats),
        }
    }

    /// The groups, as in configs and manifests.
    pub fn groups(self) -> Vec<AudioGroup> {
        match self.beats {
            false => vec![AudioGroup::Ccmotion],
            true => vec![AudioGroup::Ccmotion, AudioGroup::Beats],
        }
    }

    /// Names and rows of the stored arrays, in order.
    pub(crate) fn arrays(self) -> impl Iterator<Item = (&'static str, usize)> {
        FEATURES.into_iter().chain(self.beats.then_some(BEATS))
    }

    /// Number of features per frame: 163 or 170.
    pub fn channels(self) -> usize {
        match self.beats {
            false => AUDIO_CHANNELS,
            true => AUDIO_CHANNELS + BEAT_FEATURES.len(),
        }
    }
}

/// Rejects unsupported lists of groups. The error names `key`, the found groups and the allowed
/// ones.
pub fn check_groups(key: &str, groups: &[AudioGroup]) -> Result<(), InvalidSetting> {
    let named = serde_json::to_string(groups).unwrap_or_default();
    let allowed = "[\"ccmotion\"] or [\"ccmotion\", \"beats\"]";
    let valid = AudioLayout::of(groups).groups() == groups;
    require(valid, key, named, allowed)
        .hint("\"beats\" comes beside the 163 features of \"ccmotion\", not instead of them")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_lists_are_known() {
        use AudioGroup::{Beats, Ccmotion};
        for (groups, channels) in [(&[Ccmotion][..], 163), (&[Ccmotion, Beats], 170)] {
            check_groups("k", groups).expect("a known list");
            assert_eq!(AudioLayout::of(groups).channels(), channels);
        }
        for groups in [&[][..], &[Beats], &[Beats, Ccmotion], &[Ccmotion, Ccmotion]] {
            let error = check_groups("data.audio_features", groups).unwrap_err();
            assert!(error.to_string().contains("data.audio_features"), "{error}");
        }
    }
}
