//! Gaps: frames in which a marker was not captured.

use crate::track::lerp;

/// What was missing of one marker.
#[derive(Clone, Debug, Default, Eq, PartialEq)]
pub struct MarkerGaps {
    /// The marker's label in the file.
    pub marker: String,
    /// Frames without it.
    pub missing_frames: usize,
    /// Those of them that were filled by a straight line.
    pub filled_frames: usize,
    /// Length of its longest gap in frames.
    pub longest_gap_frames: usize,
}

/// Fills gaps of at most `max_gap_frames` frames between two known frames.
pub(super) fn fill_gaps(
    track: &mut [Option<[f64; 3]>],
    max_gap_frames: usize,
    marker: &str,
) -> MarkerGaps {
    let mut gaps = MarkerGaps {
        marker: marker.to_string(),
        ..MarkerGaps::default()
    };
    let mut end = 0;
    while end < track.len() {
        let start = end;
        while end < track.len() && track[end].is_none() {
            end += 1;
        }
        let length = end - start;
        gaps.missing_frames += length;
        gaps.longest_gap_frames = gaps.longest_gap_frames.max(length);
        let before = start.checked_sub(1).and_then(|t| track[t]);
        let after = track.get(end).copied().flatten();
        if let (Some(before), Some(after)) = (before, after)
            && length <= max_gap_frames
        {
            gaps.filled_frames += length;
            for step in 0..length {
                let fraction = (step + 1) as f64 / (length + 1) as f64;
                track[start + step] = Some(lerp(before, after, fraction));
            }
        }
        end += 1;
    }
    gaps
}
