//! What a manifest says of one phrase.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{AudioGroup, Digest, Side};

/// A row of the manifest.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct ManifestRow {
    /// The phrase's id: the name of its folders.
    pub id: String,
    /// The motion it was cut from, as the plan names it.
    pub motion_source: String,
    /// The song, as the plan names it; none where the features are zeros.
    pub audio_source: Option<String>,
    /// Its first frame on the take's time line: that of the song; where there is none, that of the
    /// motion used, which begins at `audio_start_seconds`.
    pub first_frame: i64,
    /// Frames.
    pub frames: i64,
    /// Frames per second.
    pub fps: f64,
    /// Beats within it; none where no beats are known.
    pub beats: Option<f64>,
    /// Beats per minute; none where no beats are known.
    pub tempo: Option<f64>,
    /// Its side of the split; none where the plan leaves that to training.
    pub split: Option<Side>,
    /// Length of its motion file in bytes.
    pub motion_bytes: i64,
    /// Checksum of its motion file.
    pub motion_sha256: Digest,
    /// Length of its audio file in bytes.
    pub audio_bytes: i64,
    /// Checksum of its audio file.
    pub audio_sha256: Digest,
    /// The groups of audio features in its audio file; none where the manifest does not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub audio_features: Option<Vec<AudioGroup>>,
    /// What it is called, such as the kind of dance; none where the plan does not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
    /// What is notable about it, see [`Flag`].
    pub flags: Vec<Flag>,
}

/// What is notable about a phrase.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Flag {
    /// It has no song: its audio features are zeros.
    NoAudio,
    /// It has no beats: its phase is zero throughout.
    NoBeats,
    /// A border between two captured units lies within it.
    JoinedUnits,
    /// Markers were missing over short gaps and were interpolated.
    FilledGaps,
    /// It fails CC-MotionGen's sanity checks.
    FailsDocumentChecks,
    /// A part of its song was damaged or is missing: what follows may be early.
    DamagedAudio,
}

impl fmt::Display for Flag {
    /// As the manifest writes it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}
