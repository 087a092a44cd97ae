//! Beat alignment of motion and music.
//!
//! The score of Li et al. 2021 (AIST++, <https://arxiv.org/abs/2101.08779>), for the root.

use kinegrad_random::Key;

use crate::phrase::VELOCITY;
use crate::vector::length;
use crate::{FPS, Phrase};

/// Width of the score's bell, seconds: the paper's 3 frames at 60 frames per second.
pub const BEAT_SIGMA: f64 = 0.05;

/// Times in seconds at which the root is slowest: local minima of the velocity channels' norm,
/// unsmoothed. A plateau is one beat, at its middle; the ends are no beats.
pub fn kinematic_beats(motion: &Phrase) -> Vec<f64> {
    peaks(motion, |speed| -speed)
}

/// Times in seconds at which the root is fastest. In real dances, speed peaks are often on beats
/// (docs/results.md).
pub fn speed_peaks(motion: &Phrase) -> Vec<f64> {
    peaks(motion, |speed| speed)
}

/// Times in seconds of the local maxima of a function of the speed.
fn peaks(motion: &Phrase, of: fn(f64) -> f64) -> Vec<f64> {
    let velocities = motion.vectors(VELOCITY).into_iter();
    let values: Vec<f64> = velocities.map(|velocity| of(length(velocity))).collect();
    let places = local_maxima(&values).into_iter();
    places.map(|place| place / FPS).collect()
}

/// Mean over the kinematic beats of `exp(-d^2 / (2 sigma^2))`, d the distance in seconds to the
/// nearest music beat and sigma [`BEAT_SIGMA`]. `None` if motion or music has no beats.
pub fn beat_alignment(kinematic: &[f64], music: &[f64]) -> Option<f64> {
    if kinematic.is_empty() || music.is_empty() {
        return None;
    }
    let score = |beat: &f64| {
        let distances = music.iter().map(|other| (other - beat).abs());
        let nearest = distances.fold(f64::INFINITY, f64::min);
        (-nearest.powi(2) / (2.0 * BEAT_SIGMA.powi(2))).exp()
    };
    Some(kinematic.iter().map(score).sum::<f64>() / kinematic.len() as f64)
}

/// Number of offsets for the chance level.
const OFFSETS: usize = 50;

/// Chance level: mean [`beat_alignment`] over random circular shifts within `seconds`.
pub fn chance_alignment(kinematic: &[f64], music: &[f64], seconds: f64, key: Key) -> Option<f64> {
    let at = |offset: f32| {
        let moved = |beat: &f64| (beat + f64::from(offset) * seconds).rem_euclid(seconds);
        beat_alignment(&kinematic.iter().map(moved).collect::<Vec<_>>(), music)
    };
    super::mean(key.uniforms(OFFSETS).into_iter().map(at))
}

/// Positions, in frames, of local maxima, except at the ends. A plateau counts once, at its middle.
fn local_maxima(values: &[f64]) -> Vec<f64> {
    let mut maxima = Vec::new();
    let mut start = 0;
    while start < values.len() {
        let level = values[start];
        let plateau = values[start..].iter().take_while(|value| **value == level);
        // NaN is not equal to itself.
        let end = start + plateau.count().max(1);
        let rises = start > 0 && values[start - 1] < level;
        let falls = values.get(end).is_some_and(|&after| after < level);
        if rises && falls {
            maxima.push((start + end - 1) as f64 / 2.0);
        }
        start = end;
    }
    maxima
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::CHANNELS;

    /// A phrase with these speeds and changing directions.
    fn with_speeds(speeds: &[f64]) -> Phrase {
        let mut motion = Phrase::new(vec![0.0; speeds.len() * CHANNELS]).unwrap();
        for (t, &speed) in speeds.iter().enumerate() {
            let direction = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]][t % 3];
            motion.set_vector(t, VELOCITY, direction.map(|axis| axis * speed));
        }
        motion
    }

    fn frames(beats: &[f64]) -> Vec<f64> {
        beats.iter().map(|seconds| seconds * FPS).collect()
    }

    #[test]
    fn the_root_is_slow_between_faster_frames() {
        let beats = |speeds: &[f64]| frames(&kinematic_beats(&with_speeds(speeds)));
        assert_eq!(beats(&[3.0, 1.0, 2.0, 4.0, 0.5, 5.0]), [1.0, 4.0]);
        assert_eq!(beats(&[3.0, 2.0, 2.0, 2.0, 2.0, 3.0]), [2.5], "a plateau");
        assert_eq!(beats(&[3.0, 2.0, 2.0, 1.0, 2.0]), [3.0], "a step is none");
        assert!(beats(&[1.0, 1.0, 2.0, 3.0, 1.0]).is_empty(), "the edges");
        assert!(beats(&[2.0, 2.0]).is_empty() && beats(&[2.0]).is_empty());
        assert!(beats(&[2.0, f64::NAN, 2.0, f64::NAN]).is_empty());
        let fast = |speeds: &[f64]| frames(&speed_peaks(&with_speeds(speeds)));
        assert_eq!(fast(&[3.0, 1.0, 2.0, 4.0, 0.5, 5.0]), [3.0]);
        assert!(fast(&[3.0, 2.0, 2.0, 3.0]).is_empty());
    }

    #[test]
    fn the_score_is_the_mean_over_kinematic_beats() {
        // One beat on the music, one off by a sigma, one far from all.
        let score = beat_alignment(&[1.0, 2.05, 9.0], &[1.0, 2.0, 3.0]).unwrap();
        assert!((score - (1.0 + (-0.5f64).exp()) / 3.0).abs() < 1e-12);
        // The nearest music beat counts; other music beats do not.
        let score = beat_alignment(&[1.0], &[0.9, 1.1, 1.05, 4.0]).unwrap();
        assert!((score - (-0.5f64).exp()).abs() < 1e-12);
        assert_eq!(beat_alignment(&[], &[1.0]), None);
        assert_eq!(beat_alignment(&[1.0], &[]), None);
    }

    #[test]
    fn chance_is_what_beats_out_of_place_score() {
        use kinegrad_random::Purpose;

        let key = Key::new(0, Purpose::BeatOffset);
        let music: Vec<f64> = (0..16).map(|beat| 0.5 * f64::from(beat)).collect();
        let danced: Vec<f64> = (0..8).map(f64::from).collect();
        assert_eq!(beat_alignment(&danced, &music), Some(1.0));
        // A bell with width 0.05 s covers 0.125 s, a quarter of each half second.
        let chance = chance_alignment(&danced, &music, 8.0, key).unwrap();
        assert!((0.1..0.4).contains(&chance), "{chance}");
        assert_eq!(chance_alignment(&danced, &music, 8.0, key), Some(chance));
        // The chance level ignores the initial offset.
        let late: Vec<f64> = danced.iter().map(|beat| beat + 0.25).collect();
        let score = beat_alignment(&late, &music).unwrap();
        assert!(score < 1e-4, "{score}");
        let chance = chance_alignment(&late, &music, 8.0, key).unwrap();
        assert!((0.1..0.4).contains(&chance), "{chance}");
        assert_eq!(chance_alignment(&[], &music, 8.0, key), None);
    }

    proptest! {
        #[test]
        fn the_score_depends_on_differences_of_time_alone(
            kinematic in proptest::collection::vec(0.0..4.0f64, 1..12),
            music in proptest::collection::vec(0.0..4.0f64, 1..12),
            shift in -3.0..3.0f64,
        ) {
            let moved = |beats: &[f64]| beats.iter().map(|beat| beat + shift).collect::<Vec<_>>();
            let score = beat_alignment(&kinematic, &music).unwrap();
            prop_assert!((0.0..=1.0).contains(&score));
            let again = beat_alignment(&moved(&kinematic), &moved(&music)).unwrap();
            prop_assert!((score - again).abs() < 1e-9);
            prop_assert_eq!(beat_alignment(&kinematic, &kinematic), Some(1.0));
        }
    }
}
