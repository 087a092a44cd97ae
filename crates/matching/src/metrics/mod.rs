//! Coverage, diversity and novelty of a new motion.

mod movement;
mod novelty;
mod quality;
mod seam;
mod sliding;
mod windows;

use serde::Serialize;

use crate::Frames;

pub use movement::Movement;
pub(crate) use movement::Reference;
pub use novelty::{Novelty, Run};
pub use quality::Quality;
pub use seam::Seam;
pub use sliding::Sliding;
use windows::{cheapest, segmented, typical};

/// Window of coverage and shortest segment of global diversity, in frames.
const COVERED: usize = 30;
/// Window of local diversity, in frames.
const LOCAL: usize = 15;
/// Largest distance of a covered window.
const THRESHOLD: f64 = 2.0;
/// Most pairs of frames compared.
const MOST_PAIRS: usize = 20_000_000;

/// Measures of a new motion. Distances are Euclidean over the six numbers of each joint's rotation,
/// averaged over the frames of a window. Source: GANimator's evaluation; docs/sources/genmm.md.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Measures {
    /// Fraction of the examples' windows of 30 frames (except each example's last) whose distance
    /// to the nearest window of the motion is below 2. This limit is loose: frames of a dance are 2
    /// to 3 apart.
    pub coverage: f64,
    /// Mean distance of the examples' windows to the motion.
    pub window_cost: f64,
    /// Mean distance of the motion's windows of 15 frames, without the last, to the nearest window
    /// of the examples.
    pub local_diversity: f64,
    /// Largest distance of the motion's windows to the examples.
    pub furthest_window: f64,
    /// Mean distance of the motion's frames to the examples', minimised over cuts into segments of
    /// at least 30 frames. Each segment follows one example. `None` if all examples are too short.
    pub global_diversity: Option<f64>,
    /// `local_diversity` relative to the median distance of windows of the examples that do not
    /// overlap: 0 for a copy, 1 for motion as far from the examples as they are from themselves.
    /// `None` if the examples do not move.
    pub novelty: Option<f64>,
    /// False for a novelty beyond 1: noise, or unrelated motion.
    pub plausible: bool,
}

impl Measures {
    /// Measures `motion` against `examples`, both `[frames, channels]` of rotations. `None` if a
    /// motion has fewer than 31 frames, or more than 20 million pairs of frames would be compared.
    ///
    /// # Panics
    /// Panics if the channels differ.
    pub fn of(motion: &Frames, examples: &[Frames]) -> Option<Self> {
        let all: usize = examples.iter().map(Frames::frames).sum();
        let long = |frames: &Frames| frames.frames() > COVERED;
        let measurable = long(motion) && !examples.is_empty() && examples.iter().all(long);
        if !measurable || motion.frames().saturating_mul(all) > MOST_PAIRS {
            return None;
        }
        let motions = std::slice::from_ref(motion);
        let mut covered = Vec::new();
        for example in examples {
            let mut costs = cheapest(example, motions, COVERED);
            costs.pop();
            covered.extend(costs);
        }
        let mut local = cheapest(motion, examples, LOCAL);
        local.pop();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let hits = covered.iter().filter(|cost| **cost < THRESHOLD).count();
        let unit = typical(examples, LOCAL).filter(|unit| *unit > 0.0);
        let novelty = unit.map(|unit| mean(&local) / unit);
        Some(Self {
            coverage: hits as f64 / covered.len() as f64,
            window_cost: mean(&covered),
            local_diversity: mean(&local),
            furthest_window: local.iter().copied().fold(0.0, f64::max),
            global_diversity: Some(segmented(motion, examples, COVERED)).filter(|d| d.is_finite()),
            novelty,
            plausible: novelty.is_none_or(|novelty| novelty <= 1.0),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Preset, Request, Settings, start_noise, synthesize};

    fn line(frames: std::ops::Range<usize>) -> Frames {
        Frames::new(1, frames.map(|t| t as f32).collect())
    }

    #[test]
    fn a_copy_covers_what_it_copies_and_has_no_diversity() {
        let example = line(0..100);
        let copy = Measures::of(&example, std::slice::from_ref(&example)).unwrap();
        assert_eq!((copy.coverage, copy.window_cost), (1.0, 0.0));
        assert_eq!(
            (copy.local_diversity, copy.global_diversity),
            (0.0, Some(0.0))
        );
        // The first half covers its own windows and those less than 2 frames away: 22 of the 70
        // windows that start before frame 70.
        let half = Measures::of(&line(0..50), &[example]).unwrap();
        assert_eq!(half.coverage, 22.0 / 70.0);
        assert_eq!(half.local_diversity, 0.0);
        let apart = Measures::of(&line(0..100), &[line(500..600)]).unwrap();
        assert_eq!(apart.coverage, 0.0);
        assert!(apart.local_diversity > 400.0 && apart.furthest_window > 480.0);
    }

    #[test]
    fn novelty_tells_copies_from_mixtures_and_from_noise() {
        // A walk of 24 numbers with a slow change, and a synthesis from it.
        let value = |t: usize, channel: usize| {
            let (t, channel) = (t as f32, channel as f32);
            (0.4 * t + channel).sin() + (0.03 * t * (1.0 + 0.1 * channel)).cos()
        };
        let values = (0..200).flat_map(|t| (0..24).map(move |channel| value(t, channel)));
        let example = [Frames::new(24, values.collect())];
        let of = |motion: &Frames| {
            let measures = Measures::of(motion, &example).unwrap();
            (measures.novelty.unwrap(), measures.plausible)
        };
        assert_eq!(of(&example[0]), (0.0, true));
        let request = Request {
            examples: &example,
            frames: 300,
            settings: &Settings::of(Preset::Published),
            groups: &[],
            constraints: &[],
        };
        let (novelty, plausible) = of(&synthesize(&request, 1).unwrap().frames);
        assert!(novelty > 0.01 && novelty < 0.6 && plausible, "{novelty}");
        let noise = start_noise(3, 0, 300, 24);
        let loud = noise.values().iter().map(|value| 3.0 * value).collect();
        let (novelty, plausible) = of(&Frames::new(24, loud));
        assert!(novelty > 1.0 && !plausible, "{novelty}");
        let still = [Frames::zeros(100, 3)];
        let measures = Measures::of(&still[0], &still).unwrap();
        assert_eq!((measures.novelty, measures.plausible), (None, true));
    }

    #[test]
    fn unmeasurable_motions_are_none() {
        assert!(Measures::of(&line(0..30), &[line(0..100)]).is_none());
        assert!(Measures::of(&line(0..100), &[line(0..100), line(0..30)]).is_none());
        assert!(Measures::of(&line(0..100), &[]).is_none());
        assert!(Measures::of(&line(0..5000), &[line(0..5000)]).is_none());
        // 40 frames are neither two segments of 30 nor one segment of a 31-frame example.
        let uncut = Measures::of(&line(0..40), &[line(0..31)]).unwrap();
        assert!(uncut.global_diversity.is_none() && uncut.local_diversity.is_finite());
    }
}
