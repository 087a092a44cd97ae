//! Differences between phrases.

use kinegrad_random::{Key, Purpose};

use super::{TRAJECTORY, mean};
use crate::{Phrase, Statistics};

/// Root mean square difference in [`TRAJECTORY`] over the common frames, in training deviations.
pub fn trajectory_distance(a: &Phrase, b: &Phrase, training: &Statistics) -> f64 {
    let frames = a.frames().min(b.frames());
    let mut sum = 0.0;
    for t in 0..frames {
        let (a, b) = (a.frame(t), b.frame(t));
        for channel in TRAJECTORY {
            let difference = f64::from(a[channel]) - f64::from(b[channel]);
            sum += (difference / training.std[channel]).powi(2);
        }
    }
    (sum / (frames * TRAJECTORY.len()) as f64).sqrt()
}

/// Mean [`trajectory_distance`] over all pairs; `None` without pairs or if the mean is not finite.
pub fn diversity(motions: &[&Phrase], training: &Statistics) -> Option<f64> {
    mean(motions.iter().enumerate().flat_map(|(index, a)| {
        let others = motions[index + 1..].iter();
        others.map(move |b| Some(trajectory_distance(a, b, training)))
    }))
}

/// Mean Euclidean distance of feature vectors `[n, features]` over all pairs, or over `pairs`
/// random pairs if that is fewer. `None` without pairs or if the mean is not finite.
pub fn feature_diversity(features: &[Vec<f64>], pairs: usize, seed: u64) -> Option<f64> {
    let count = features.len();
    if count < 2 || pairs == 0 {
        return None;
    }
    let indices: Vec<(usize, usize)> = if count * (count - 1) / 2 <= pairs {
        let all = (0..count).flat_map(|first| (0..first).map(move |second| (first, second)));
        all.collect()
    } else {
        let key = Key::new(seed, Purpose::Pairs);
        let firsts = key.at(0).integers(pairs, count);
        let seconds = key.at(1).integers(pairs, count - 1);
        // The second index is sampled from all except the first.
        let others = |(first, second)| (first, second + usize::from(second >= first));
        firsts.into_iter().zip(seconds).map(others).collect()
    };
    let between = |(first, second): (usize, usize)| distance(&features[first], &features[second]);
    mean(indices.into_iter().map(between).map(Some))
}

/// Euclidean distance.
pub(super) fn distance(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len(), "feature vectors of one length");
    let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::CHANNELS;
    use crate::random_phrase::random_phrase;

    fn training() -> Statistics {
        let phrases: Vec<Phrase> = (0..5).map(|seed| random_phrase(seed, 40)).collect();
        crate::phrase_statistics(&phrases).unwrap()
    }

    /// A phrase with `value` in one channel of every frame, zero elsewhere.
    fn constant(channel: usize, value: f64, frames: usize) -> Phrase {
        let mut motion = Phrase::new(vec![0.0; frames * CHANNELS]).unwrap();
        (0..frames).for_each(|t| motion.frame_mut(t)[channel] = value as f32);
        motion
    }

    #[test]
    fn differences_count_in_training_deviations() {
        let mut training = training();
        training.std[7] = 0.5;
        let still = constant(7, 0.0, 4);
        // 6 deviations in one of nine channels: sqrt(36 / 9).
        let moved = constant(7, 3.0, 4);
        assert!((trajectory_distance(&still, &moved, &training) - 2.0).abs() < 1e-12);
        // The pairs are 2, 4 and 2 apart.
        let opposite = constant(7, -3.0, 4);
        let mean = diversity(&[&still, &moved, &opposite], &training).unwrap();
        assert!((mean - 8.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn rotation_phase_and_style_do_not_count() {
        let training = training();
        for channel in 0..CHANNELS {
            let distance =
                trajectory_distance(&constant(channel, 1.0, 3), &constant(0, 0.0, 3), &training);
            assert_eq!(distance > 0.0, channel < 9, "{channel}");
        }
    }

    #[test]
    fn unequal_phrases_are_compared_over_the_shorter_one() {
        let training = training();
        let (long, short) = (random_phrase(8, 30), random_phrase(9, 20));
        let cut = trajectory_distance(&long.slice(0..20), &short, &training);
        assert_eq!(trajectory_distance(&long, &short, &training), cut);
        assert_eq!(trajectory_distance(&short, &long, &training), cut);
    }

    #[test]
    fn too_few_or_broken_phrases_have_no_diversity() {
        let training = training();
        let good = random_phrase(1, 10);
        assert_eq!(diversity(&[], &training), None);
        assert_eq!(diversity(&[&good], &training), None);
        assert_eq!(diversity(&[&good, &good], &training), Some(0.0));
        let broken = constant(2, f64::NAN, 10);
        assert_eq!(diversity(&[&good, &broken], &training), None);
    }

    #[test]
    fn feature_vectors_are_compared_in_pairs() {
        let features = vec![vec![0.0, 0.0], vec![3.0, 4.0], vec![0.0, 10.0]];
        // Distances 5, 10 and sqrt(45).
        let mean = feature_diversity(&features, 3, 0).unwrap();
        assert!((mean - (15.0 + 45f64.sqrt()) / 3.0).abs() < 1e-12);
        let one = feature_diversity(&features, 1, 7).unwrap();
        assert!([5.0, 10.0, 45f64.sqrt()].contains(&one));
        assert_eq!(feature_diversity(&features, 1, 7), Some(one));
        assert_eq!(feature_diversity(&features[..1], 3, 0), None);
        assert_eq!(feature_diversity(&features, 0, 0), None);
        let broken = [vec![f64::NAN], vec![1.0]];
        assert_eq!(feature_diversity(&broken, 3, 0), None);
    }

    #[test]
    fn sampled_pairs_approximate_all_pairs() {
        let vector = |index| Key::new(1, Purpose::Synthetic).at(index).normals(8);
        let wide = |vector: Vec<f32>| vector.into_iter().map(f64::from).collect();
        let features: Vec<Vec<f64>> = (0..60).map(vector).map(wide).collect();
        let all = feature_diversity(&features, 60 * 59 / 2, 0).unwrap();
        let sampled = feature_diversity(&features, 600, 0).unwrap();
        assert!((sampled / all - 1.0).abs() < 0.05, "{sampled} of {all}");
        assert_ne!(feature_diversity(&features, 600, 1), Some(sampled));
    }

    proptest! {
        #[test]
        fn order_does_not_matter_and_scale_carries_over(seed: u64, factor in 1.0f32..10.0) {
            let training = training();
            let phrases = [0, 1, 2].map(|i| random_phrase(seed.wrapping_add(i), 12));
            let [a, b, c] = phrases.each_ref();
            let straight = diversity(&[a, b, c], &training).unwrap();
            let shuffled = diversity(&[c, a, b], &training).unwrap();
            prop_assert!((straight - shuffled).abs() < 1e-12);
            let larger = phrases.each_ref().map(|phrase| {
                let values = phrase.as_slice().iter().map(|value| value * factor).collect();
                Phrase::new(values).unwrap()
            });
            let scaled = diversity(&larger.each_ref(), &training).unwrap();
            prop_assert!((scaled / (straight * f64::from(factor)) - 1.0).abs() < 1e-5);
        }
    }
}
