//! Which groups of audio features the frames of a song are described by.

use kinegrad_audio::pulse::BEAT_FEATURES;
use kinegrad_settings::{InvalidSetting, Refused, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::features::AUDIO_CHANNELS;

/// A group of audio features.
#[derive(Clone, Copy, Debug, Deserialize, Eq, JsonSchema, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum AudioGroup {
    /// The 163 features of CC-MotionGen, sections 4.1 and 4.3.
    Document,
    /// Sine and cosine of the position in the beat and, where the downbeat is known, in the bar; a
    /// mark on each beat; the local tempo.
    Beats,
}

/// The groups that a model hears, in the order in which they are stacked.
#[derive(Clone, Copy, Debug, Default, Eq, PartialEq)]
pub struct AudioLayout {
    /// Whether the seven beat features follow the 163.
    pub beats: bool,
}

impl AudioLayout {
    /// The 163 features alone.
    pub const DOCUMENT: Self = Self { beats: false };

    /// The 163 features, then those of the beats.
    pub const WITH_BEATS: Self = Self { beats: true };

    /// The layout that lists `groups`, which have been [checked](check_groups).
    pub fn of(groups: &[AudioGroup]) -> Self {
        Self {
            beats: groups.contains(&AudioGroup::Beats),
        }
    }

    /// The groups, as configs and manifests list them.
    pub fn groups(self) -> Vec<AudioGroup> {
        match self.beats {
            false => vec![AudioGroup::Document],
            true => vec![AudioGroup::Document, AudioGroup::Beats],
        }
    }

    /// Features of a frame: 163 or 170.
    pub fn channels(self) -> usize {
        match self.beats {
            false => AUDIO_CHANNELS,
            true => AUDIO_CHANNELS + BEAT_FEATURES.len(),
        }
    }
}

/// Rejects lists of groups that no model hears.
///
/// # Errors
/// Names `key`, what was found and what is allowed.
pub fn check_groups(key: &str, groups: &[AudioGroup]) -> Result<(), InvalidSetting> {
    let named = serde_json::to_string(groups).unwrap_or_default();
    let allowed = "[\"document\"] or [\"document\", \"beats\"]";
    require(
        AudioLayout::of(groups).groups() == groups,
        key,
        named,
        allowed,
    )
    .hint("\"beats\" comes beside the 163 features of \"document\", not instead of them")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_lists_are_known() {
        use AudioGroup::{Beats, Document};
        for (groups, channels) in [(&[Document][..], 163), (&[Document, Beats], 170)] {
            check_groups("k", groups).expect("a known list");
            assert_eq!(AudioLayout::of(groups).channels(), channels);
        }
        for groups in [&[][..], &[Beats], &[Beats, Document], &[Document, Document]] {
            let error = check_groups("data.audio_features", groups).unwrap_err();
            assert!(error.to_string().contains("data.audio_features"), "{error}");
        }
    }
}
