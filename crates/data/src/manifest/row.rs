//! A row of the manifest.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{AudioGroup, Digest, Side};

/// A row of the manifest.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct ManifestRow {
    /// Id of the phrase and name of its folders.
    pub id: String,
    /// The source motion, as named in the plan.
    pub motion_source: String,
    /// The song, as named in the plan; `None` if the features are zeros.
    pub audio_source: Option<String>,
    /// First frame in the song or, without a song, in the used motion.
    pub first_frame: i64,
    /// Number of frames.
    pub frames: i64,
    /// Frames per second.
    pub fps: f64,
    /// Number of beats, if known.
    pub beats: Option<f64>,
    /// Beats per minute, if known.
    pub tempo: Option<f64>,
    /// Side of the split; `None` if training decides.
    pub split: Option<Side>,
    /// Size of its motion file, bytes.
    pub motion_bytes: i64,
    /// Checksum of its motion file.
    pub motion_sha256: Digest,
    /// Size of its audio file, bytes.
    pub audio_bytes: i64,
    /// Checksum of its audio file.
    pub audio_sha256: Digest,
    /// Groups of audio features in the audio file; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub audio_features: Option<Vec<AudioGroup>>,
    /// Label, such as the dance style, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
    /// Notes about it.
    pub flags: Vec<Flag>,
}

/// A note about a phrase.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Flag {
    /// No song: audio features are zeros.
    NoAudio,
    /// No beats: the phase is zero.
    NoBeats,
    /// The phrase contains a border between two captured units.
    JoinedUnits,
    /// Short gaps of markers were interpolated.
    FilledGaps,
    /// The phrase fails CC-MotionGen's sanity checks.
    FailsCcmotionChecks,
    /// A part of the song was damaged or missing: the following audio may be early.
    DamagedAudio,
}

impl fmt::Display for Flag {
    /// Its name in the manifest.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}
