//! What the reports of phrases and of clips have in common.

use serde::{Deserialize, Serialize};

/// Frames of a take that no phrase or clip has.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Rejection {
    /// First of them on the take's time line.
    pub first_frame: usize,
    /// How many.
    pub frames: usize,
    /// Why.
    pub reason: String,
}
