//! Still frames of a motion.

use serde::Serialize;

use crate::Frames;

/// Largest change of a still frame, relative to the examples' median change between frames that
/// differ.
const STILL: f64 = 0.1;

/// Largest change due to rounding.
const UNCHANGED: f64 = 1e-5;

/// Fractions of still frames: their rotations differ from the frame before by less than a tenth of
/// the examples' median. Means of many different patches are still.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Stillness {
    /// Of the new motion.
    pub motion: f64,
    /// Of the examples.
    pub examples: f64,
}

impl Stillness {
    /// Compares rotations, `[frames, channels]`. `None` for fewer than two frames.
    pub(crate) fn of(motion: &Frames, examples: &[Frames]) -> Option<Self> {
        let usual: Vec<f64> = examples.iter().flat_map(changes).collect();
        // Repeated frames are excluded from the median.
        let mut moving: Vec<f64> = usual.iter().copied().filter(|c| *c > UNCHANGED).collect();
        if moving.is_empty() || motion.frames() < 2 {
            return None;
        }
        moving.sort_unstable_by(f64::total_cmp);
        let bound = STILL * moving[moving.len() / 2];
        let share = |changes: &[f64]| {
            let still = changes.iter().filter(|change| **change < bound).count();
            still as f64 / changes.len() as f64
        };
        Some(Self {
            motion: share(&changes(motion)),
            examples: share(&usual),
        })
    }
}

/// Distances of neighbouring frames.
fn changes(frames: &Frames) -> Vec<f64> {
    let change = |t: usize| {
        let pairs = frames.frame(t).iter().zip(frames.frame(t - 1));
        let squares = pairs.map(|(now, before)| f64::from(now - before).powi(2));
        squares.sum::<f64>().sqrt()
    };
    (1..frames.frames()).map(change).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_repeated_pose_is_still_and_a_slow_one_is_not() {
        let walk = |pace: fn(usize) -> f32| Frames::new(1, (0..100).map(pace).collect());
        let example = walk(|t| t as f32);
        let of = |motion: &Frames| Stillness::of(motion, std::slice::from_ref(&example)).unwrap();
        assert_eq!(of(&walk(|t| 0.5 * t as f32)).motion, 0.0);
        let stopped = of(&walk(|t| t.min(79) as f32));
        assert!((stopped.motion - 20.0 / 99.0).abs() < 1e-12, "{stopped:?}");
        assert_eq!(stopped.examples, 0.0);
        // Examples with still frames.
        let resting = walk(|t| t.max(30) as f32);
        let both = Stillness::of(&example, &[example.clone(), resting]).unwrap();
        assert_eq!((both.motion, both.examples), (0.0, 30.0 / 198.0));
        assert_eq!(Stillness::of(&Frames::new(1, vec![0.0]), &[example]), None);
        // Three of four frames repeat, as in a capture that is stored at four times its rate.
        let stored = walk(|t| (t / 4) as f32);
        let frozen = Stillness::of(&walk(|_| 0.0), std::slice::from_ref(&stored)).unwrap();
        assert_eq!(frozen.motion, 1.0);
        assert!((frozen.examples - 0.75).abs() < 0.01, "{frozen:?}");
    }
}
