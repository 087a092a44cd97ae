//! Reports of takes.

use serde::{Deserialize, Serialize};

use super::grid::GridReport;

/// What became of a take.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub struct TakeReport {
    /// Its name.
    pub name: String,
    /// Phrases made.
    pub phrases: usize,
    /// Seconds of motion in them.
    pub seconds: f64,
    /// Why nothing could be made of it at all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
    /// What was left out.
    pub rejected: Vec<Rejection>,
    /// What a user should know of the rest.
    pub notes: Vec<String>,
    /// Where the plan states the beats: from the stated beginning of each bar to the nearest tracked
    /// beat, whichever of the two the motion is laid on, in milliseconds, positive where the music comes later. Bars that lie wholly before or
    /// after all tracked beats are left out.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub bar_offsets_ms: Vec<f64>,
    /// Of segments with a song: which beats they lie on, and how stated and tracked ones agree.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub grid: Option<GridReport>,
}

/// Frames that no phrase holds.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Rejection {
    /// First of them on the take's time line.
    pub first_frame: usize,
    /// How many.
    pub frames: usize,
    /// Why.
    pub reason: String,
}
