//! Gaps: frames in which a marker was not captured.

use crate::track::{MarkerGaps, lerp, runs};

/// Fills gaps of at most `max_gap_frames` frames between two known frames.
pub(crate) fn fill_gaps(
    track: &mut [Option<[f64; 3]>],
    max_gap_frames: usize,
    marker: &str,
) -> MarkerGaps {
    let mut gaps = MarkerGaps {
        marker: marker.to_string(),
        ..MarkerGaps::default()
    };
    let missing: Vec<bool> = track.iter().map(Option::is_none).collect();
    for gap in runs(&missing) {
        let length = gap.len();
        gaps.missing_frames += length;
        gaps.longest_gap_frames = gaps.longest_gap_frames.max(length);
        let before = gap.start.checked_sub(1).and_then(|t| track[t]);
        let after = track.get(gap.end).copied().flatten();
        if let (Some(before), Some(after)) = (before, after)
            && length <= max_gap_frames
        {
            gaps.filled_frames += length;
            for (step, t) in (1..).zip(gap) {
                let fraction = f64::from(step) / (length + 1) as f64;
                track[t] = Some(lerp(before, after, fraction));
            }
        }
    }
    gaps
}
