//! Settings chosen by what is measured.

use std::ops::Range;

use serde::Serialize;

use crate::Settings;

/// Most pairs of frames of the examples and the motion that all attempts together compare.
const MOST_PAIRS: usize = 8_000_000;
/// Coherences in the order in which they are tried, each with the next noise of the seed. None: the
/// settings of the job.
const COHERENCES: [Option<f64>; 16] = {
    let [own, half, most] = [None, Some(0.5), Some(1.0)];
    [
        own, own, half, half, most, most, most, most, most, most, most, most, most, most, most,
        most,
    ]
};
/// Attempts at a loop without constraints that start from the repeated examples, because a coherent
/// loop from noise freezes in a pose of rest.
pub(super) const REPEATS: Range<usize> = 4..10;
/// Coherence of these attempts.
const REPEATED: f64 = 0.75;
/// Continuity of attempts with a coherence from noise.
const CONTINUITY: f64 = 1.0;
/// Attempts from this one on have longer patches.
const LONGER: usize = 10;
/// Frames of a longer patch.
const LONGER_PATCH: usize = 21;

/// Replacement of the settings of a job.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Adaptation {
    /// The coherence, as in [`Settings::with_coherence`]; none if the job's settings were kept and
    /// only the noise is another.
    pub coherence: Option<f64>,
    /// Number of the attempt, from 0.
    pub attempt: usize,
    /// Number of attempts.
    pub attempts: usize,
}

/// Settings of the attempts at a motion of `frames` frames from examples with `examples` frames.
/// `repeats`: some [start from the examples](REPEATS).
pub(super) fn attempts(
    settings: &Settings,
    examples: &[usize],
    frames: usize,
    repeats: bool,
) -> Vec<Settings> {
    let pairs = frames.saturating_mul(examples.iter().sum()).max(1);
    let most = (MOST_PAIRS / pairs).clamp(1, COHERENCES.len());
    let shortest = examples.iter().copied().min().unwrap_or(0).min(frames);
    let attempt = |index: usize| {
        let mut settings = settings.clone();
        if let Some(coherence) = coherence(index, repeats) {
            settings = settings.with_coherence(coherence).expect("0 to 1");
            if !(repeats && REPEATS.contains(&index)) {
                settings.continuity = CONTINUITY;
            }
        }
        if index >= LONGER && shortest >= 2 * LONGER_PATCH {
            settings.patch_size = LONGER_PATCH;
        }
        settings
    };
    (0..most).map(attempt).collect()
}

/// The coherence of an attempt; none for that of the job.
fn coherence(attempt: usize, repeats: bool) -> Option<f64> {
    match repeats && REPEATS.contains(&attempt) {
        true => Some(REPEATED),
        false => COHERENCES[attempt],
    }
}

impl Adaptation {
    /// The replacement by attempt `attempt` of `attempts`; none for the first.
    pub(super) fn of(attempt: usize, attempts: usize, repeats: bool) -> Option<Self> {
        (attempt > 0).then(|| Self {
            coherence: coherence(attempt, repeats),
            attempt,
            attempts,
        })
    }
}
