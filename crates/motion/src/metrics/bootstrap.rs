//! Means with bootstrap intervals.

use kinegrad_random::{Key, Purpose};
use serde::Serialize;

use crate::quantiles::percentile;

/// Number of resamples.
const RESAMPLES: u64 = 2000;

/// The mean of some values with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// The mean of all values.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

impl Estimate {
    /// The mean of the values of all `groups` with its bootstrap percentile interval (Efron and
    /// Tibshirani 1993, sections 8 and 13): groups are resampled with replacement 2000 times, and
    /// then the values of each sampled group. Values of one group may be dependent, such as phrases
    /// of one song. Estimates with the same groups and `seed` use the same resamples.
    ///
    /// `None` without values, or if a value is not finite.
    pub fn of(groups: &[Vec<f64>], seed: u64) -> Option<Self> {
        let groups = groups.iter().filter(|group| !group.is_empty());
        let groups: Vec<&Vec<f64>> = groups.collect();
        let all = || groups.iter().flat_map(|group| group.iter().copied());
        if groups.is_empty() || !all().all(f64::is_finite) {
            return None;
        }
        let key = Key::new(seed, Purpose::Bootstrap);
        let means = (0..RESAMPLES).map(|resample| {
            let key = key.at(resample);
            let resampled = key.at(0).integers(groups.len(), groups.len());
            let (mut sum, mut count) = (0.0, 0);
            for (place, group) in resampled.into_iter().enumerate() {
                let group = groups[group];
                for value in key.at(1 + place as u64).integers(group.len(), group.len()) {
                    sum += group[value];
                }
                count += group.len();
            }
            sum / count as f64
        });
        let means: Vec<f64> = means.collect();
        Some(Self {
            mean: all().sum::<f64>() / all().count() as f64,
            low: percentile(means.clone(), 2.5),
            high: percentile(means, 97.5),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn normals(seed: u64, count: usize) -> Vec<f64> {
        let normals = Key::new(seed, Purpose::Noise).normals(count);
        normals.into_iter().map(f64::from).collect()
    }

    #[test]
    fn the_mean_is_of_all_values_however_they_are_grouped() {
        let groups = [vec![1.0, 2.0, 3.0], vec![], vec![10.0]];
        let found = Estimate::of(&groups, 0).unwrap();
        assert_eq!(found.mean, 4.0);
        assert!(found.low >= 1.0 && found.low < 4.0, "{found:?}");
        assert!(found.high > 4.0 && found.high <= 10.0, "{found:?}");
        assert_eq!(Estimate::of(&groups, 0), Some(found), "the same twice");
        let many = [normals(1, 30), normals(2, 9)];
        assert_ne!(Estimate::of(&many, 0), Estimate::of(&many, 1));
        let alike = Estimate::of(&[vec![2.0; 4], vec![2.0]], 3).unwrap();
        assert_eq!((alike.mean, alike.low, alike.high), (2.0, 2.0, 2.0));
    }

    #[test]
    fn nothing_and_what_is_not_finite_have_no_mean() {
        assert_eq!(Estimate::of(&[], 0), None);
        assert_eq!(Estimate::of(&[vec![], vec![]], 0), None);
        assert_eq!(Estimate::of(&[vec![1.0, f64::NAN]], 0), None);
        assert_eq!(Estimate::of(&[vec![f64::INFINITY]], 0), None);
    }

    #[test]
    fn intervals_cover_the_mean_about_as_often_as_stated() {
        let covered = (0..60u64)
            .filter(|&seed| {
                let values = normals(seed, 40);
                let groups: Vec<_> = values.chunks(1).map(<[f64]>::to_vec).collect();
                let found = Estimate::of(&groups, seed).unwrap();
                found.low <= 0.0 && 0.0 <= found.high
            })
            .count();
        // 95 % of 60 are 57; wider intervals would also pass.
        assert!((50..=60).contains(&covered), "{covered}");
        let groups: Vec<_> = normals(0, 40)
            .into_iter()
            .map(|value| vec![value])
            .collect();
        let found = Estimate::of(&groups, 0).unwrap();
        // Twice 1.96 over the root of 40 is 0.62.
        assert!((0.4..0.85).contains(&(found.high - found.low)), "{found:?}");
    }

    #[test]
    fn values_that_agree_within_groups_are_worth_a_value_a_group() {
        let offsets = normals(7, 6);
        let groups: Vec<Vec<f64>> = offsets.iter().map(|&value| vec![value; 20]).collect();
        let wide = Estimate::of(&groups, 0).unwrap();
        let alone: Vec<Vec<f64>> = groups.iter().flatten().map(|&value| vec![value]).collect();
        let narrow = Estimate::of(&alone, 0).unwrap();
        assert!((wide.mean - narrow.mean).abs() < 1e-12);
        let ratio = (wide.high - wide.low) / (narrow.high - narrow.low);
        // The root of 20 is 4.5.
        assert!((3.0..6.0).contains(&ratio), "{ratio}");
    }
}
