//! Phase error of motion and music.

use crate::circular;

/// Mean [circular distance](circular::distance) of two bar phases over frames, in cycles. A bar has
/// `cycles_per_bar` cycles: 1 for bars, the number of beats for beats. Range 0 to 0.5, chance level
/// 0.25. NaN without frames or for values that are not finite.
pub fn phase_error(found: &[f64], expected: &[f64], cycles_per_bar: f64) -> f64 {
    assert_eq!(found.len(), expected.len(), "one phase a frame");
    let distance =
        |(a, b): (&f64, &f64)| circular::distance(a * cycles_per_bar, b * cycles_per_bar);
    let sum: f64 = found.iter().zip(expected).map(distance).sum();
    sum / found.len() as f64
}

#[cfg(test)]
mod tests {
    use kinegrad_random::{Key, Purpose};

    use super::*;

    /// Phases of `frames` frames from `start` on, advancing by 0.019 bars a frame.
    fn phase(start: f64, frames: usize) -> Vec<f64> {
        (0..frames)
            .map(|t| (start + 0.019 * t as f64).rem_euclid(1.0))
            .collect()
    }

    #[test]
    fn the_error_is_the_part_of_the_cycle_that_lies_between() {
        for beats_per_bar in [3.0, 4.0] {
            let music = phase(0.93, 97);
            assert_eq!(phase_error(&music, &music, beats_per_bar), 0.0);
            let shifted = |beats: f64| phase(0.93 + beats / beats_per_bar, 97);
            for (beats, beat_error, bar_error) in [
                (0.5, 0.5, 0.5 / beats_per_bar),
                (0.1, 0.1, 0.1 / beats_per_bar),
                (-0.1, 0.1, 0.1 / beats_per_bar),
                (1.0, 0.0, 1.0 / beats_per_bar),
                (beats_per_bar, 0.0, 0.0),
            ] {
                let danced = shifted(beats);
                let found = phase_error(&danced, &music, beats_per_bar);
                assert!((found - beat_error).abs() < 1e-9, "{beats}: {found}");
                let found = phase_error(&danced, &music, 1.0);
                assert!((found - bar_error).abs() < 1e-9, "{beats}: {found}");
            }
        }
    }

    #[test]
    fn phases_without_relation_are_a_quarter_apart() {
        let key = Key::new(3, Purpose::Noise);
        let [a, b] = [0, 1].map(|k| -> Vec<f64> {
            let uniforms = key.at(k).uniforms(20_000);
            uniforms.into_iter().map(f64::from).collect()
        });
        for cycles in [1.0, 3.0, 4.0] {
            let found = phase_error(&a, &b, cycles);
            assert!((found - 0.25).abs() < 0.01, "{found}");
        }
        // A constant phase is at the chance level too.
        let found = phase_error(&vec![0.5; 1000], &phase(0.0, 1000), 4.0);
        assert!((found - 0.25).abs() < 0.01, "{found}");
    }

    #[test]
    fn a_phase_that_is_not_finite_has_no_error() {
        assert!(phase_error(&[0.1, f64::NAN], &[0.1, 0.2], 1.0).is_nan());
        assert!(phase_error(&[], &[], 1.0).is_nan());
    }
}
