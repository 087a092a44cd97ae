//! Variety of several motions of one condition.

use kinegrad_random::{Key, Purpose};

use super::diversity::distance;
use super::mean;
use crate::moments::mean_and_deviation;

/// Trajectory diversity (GMD): the root mean square distance of the ground positions of repetitions
/// from their mean, averaged over conditions. `None` if the result is not finite.
///
/// `paths[condition][repetition]` are positions `[x, z]` in metres.
pub fn trajectory_diversity(paths: &[Vec<Vec<[f64; 2]>>]) -> Option<f64> {
    mean(paths.iter().map(|repetitions| {
        let (count, frames) = (repetitions.len(), repetitions.first()?.len());
        let mut sum = 0.0;
        for frame in 0..frames {
            let at = |axis: usize| repetitions.iter().map(move |path| path[frame][axis]);
            for axis in 0..2 {
                let mean = at(axis).sum::<f64>() / count as f64;
                sum += at(axis).map(|value| (value - mean).powi(2)).sum::<f64>();
            }
        }
        let same = repetitions.iter().all(|path| path.len() == frames);
        assert!(same, "repetitions of one length");
        Some((sum / (count * frames) as f64).sqrt())
    }))
}

/// Multimodality: the mean Euclidean distance between the embeddings of two motions of one
/// condition, over `pairs` random pairs. All conditions use the same pairs. As published, pairs
/// share no first or second index. `None` for fewer repetitions than pairs, or a mean that is not
/// finite.
///
/// `embeddings[condition][repetition]` are vectors of one length.
pub fn multimodality(embeddings: &[Vec<Vec<f64>>], pairs: usize, seed: u64) -> Option<f64> {
    let count = embeddings.iter().map(Vec::len).min()?;
    if pairs == 0 || count < pairs {
        return None;
    }
    let key = Key::new(seed, Purpose::Pairs);
    let [firsts, seconds] = [0, 1].map(|side| key.at(side).permutation(count)[..pairs].to_vec());
    mean_pair_distance(embeddings, &firsts, &seconds)
}

/// The mean Euclidean distance of repetitions `firsts[i]` and `seconds[i]`; `None` if not finite.
///
/// # Panics
/// Panics if a repetition is missing.
pub fn mean_pair_distance(
    embeddings: &[Vec<Vec<f64>>],
    firsts: &[usize],
    seconds: &[usize],
) -> Option<f64> {
    let distances = embeddings.iter().flat_map(|repetitions| {
        let pairs = firsts.iter().zip(seconds);
        pairs.map(|(&first, &second)| Some(distance(&repetitions[first], &repetitions[second])))
    });
    mean(distances)
}

/// Half the width of the published 95 % interval of the mean of replications: 1.96 population
/// standard deviations divided by the square root of their number. NaN without replications.
pub fn replication_interval(values: &[f64]) -> f64 {
    let (_, deviation) = mean_and_deviation(values.iter().copied());
    1.96 * deviation / (values.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_that_part_are_diverse() {
        let along = |x: f64, frames: usize| vec![[x, 1.0]; frames];
        // Paths 1 m to either side of the mean; three equal paths.
        let paths = [
            vec![along(-1.0, 5), along(1.0, 5)],
            vec![along(4.0, 3), along(4.0, 3), along(4.0, 3)],
        ];
        assert_eq!(trajectory_diversity(&paths), Some(0.5));
        assert_eq!(trajectory_diversity(&paths[1..]), Some(0.0));
        assert_eq!(trajectory_diversity(&[]), None);
        assert_eq!(trajectory_diversity(&[vec![along(f64::NAN, 2)]]), None);
    }

    #[test]
    fn motions_of_one_condition_are_compared_with_each_other_alone() {
        let at = |place: f64, spread: f64| -> Vec<Vec<f64>> {
            let places = (0..4).map(|n| vec![place + spread * f64::from(n)]);
            places.collect()
        };
        let far = [at(0.0, 0.0), at(100.0, 0.0)];
        assert_eq!(multimodality(&far, 3, 5), Some(0.0));
        let wide = |seed| multimodality(&[at(0.0, 2.0), at(50.0, 2.0)], 4, seed).unwrap();
        assert!(wide(1) > 0.0 && wide(1) <= 6.0);
        assert!((0..9).any(|seed| wide(seed) != wide(1)));
        assert_eq!(multimodality(&far, 5, 0), None);
        assert_eq!(multimodality(&[], 1, 0), None);
        // Given first and second indices.
        let found = mean_pair_distance(&[at(0.0, 2.0), at(50.0, 1.0)], &[0, 3], &[1, 3]);
        assert_eq!(found, Some((2.0 + 0.0 + 1.0 + 0.0) / 4.0));
    }
}
