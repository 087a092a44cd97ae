//! The part that reports of phrases and of clips share.

use serde::{Deserialize, Serialize};

/// Frames of a take that no phrase or clip has.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Rejection {
    /// First of them on the take's time line.
    pub first_frame: usize,
    /// Number of frames.
    pub frames: usize,
    /// The reason.
    pub reason: String,
}
