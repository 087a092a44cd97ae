//! The metrics over embeddings of motions and captions.

use kinegrad_settings::counted;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::metrics::diversity::distance;
use crate::metrics::{FeatureMoments, feature_diversity, frechet_distance, mean};

/// Number of motions that each caption is ranked among.
pub const POOL: usize = 32;

/// Number of pairs for diversity.
pub const DIVERSITY_PAIRS: usize = 300;

/// R-precision: the shares of captions whose own motion is among the nearest one, two and three
/// motions of the pool. Embeddings are `[n, width]`; a pair has one index.
///
/// Pools are [`POOL`] consecutive pairs; the remainder is not ranked. Equally near motions rank in
/// order of index, so identical motions rank by chance. Motions of equal captions in the pool count
/// as the own motion, because small datasets repeat captions. As in the published program, motions
/// are ranked by Euclidean distance for each caption; the paper ranks captions for each motion.
/// `None` for less than one pool or values that are not finite.
pub fn r_precision(texts: &[Vec<f64>], motions: &[Vec<f64>]) -> Option<[f64; 3]> {
    assert_eq!(texts.len(), motions.len(), "a caption for each motion");
    let mut found = [0usize; 3];
    let (text_pools, motion_pools) = (texts.chunks_exact(POOL), motions.chunks_exact(POOL));
    let ranked = text_pools.len() * POOL;
    for (texts, motions) in text_pools.zip(motion_pools) {
        for (own, text) in texts.iter().enumerate() {
            let distances = motions.iter().map(|motion| distance(text, motion));
            let distances: Vec<f64> = distances.collect();
            if !distances.iter().all(|distance| distance.is_finite()) {
                return None;
            }
            let mut order: Vec<usize> = (0..POOL).collect();
            order.sort_by(|&a, &b| distances[a].total_cmp(&distances[b]));
            let described = |&motion: &usize| motion == own || texts[motion] == *text;
            let rank = order.iter().position(described).expect("its own");
            found.iter_mut().skip(rank).for_each(|count| *count += 1);
        }
    }
    (ranked > 0).then(|| found.map(|count| count as f64 / ranked as f64))
}

/// Mean Euclidean distance between the embeddings of captions and their motions, both `[n, width]`;
/// also called matching score. `None` without values, or if a value is not finite.
pub fn multimodal_distance(texts: &[Vec<f64>], motions: &[Vec<f64>]) -> Option<f64> {
    assert_eq!(texts.len(), motions.len(), "a caption for each motion");
    mean(texts.iter().zip(motions).map(|(a, b)| Some(distance(a, b))))
}

/// Share of the motions whose nearest caption, among all distinct captions, is their own.
/// Embeddings are those of [`r_precision`]. `None` without motions, for a single caption, or values
/// that are not finite.
pub fn caption_accuracy(texts: &[Vec<f64>], motions: &[Vec<f64>]) -> Option<f64> {
    let first = |text: &Vec<f64>| texts.iter().position(|other| other == text);
    let own = texts.iter().enumerate();
    let own = own.map(|(i, text)| first(text).or(Some(i)));
    label_accuracy(texts, motions, &own.collect::<Vec<_>>())
}

/// Share of the motions whose nearest caption, among all distinct captions, belongs to a motion
/// with the same label. `labels` are the values of one label, such as the action. Motions without a
/// label are not counted. `None` for fewer than two values or embeddings that are not finite.
pub fn label_accuracy<L: Copy + Ord>(
    texts: &[Vec<f64>],
    motions: &[Vec<f64>],
    labels: &[Option<L>],
) -> Option<f64> {
    assert_eq!(texts.len(), motions.len(), "a caption for each motion");
    assert_eq!(labels.len(), motions.len(), "labels of all motions");
    // For each caption, the label values of its motions.
    let mut different: Vec<(&Vec<f64>, BTreeSet<L>)> = Vec::new();
    for (text, label) in texts.iter().zip(labels) {
        let Some(label) = label else { continue };
        match different.iter_mut().find(|(known, _)| *known == text) {
            Some((_, values)) => _ = values.insert(*label),
            None => different.push((text, BTreeSet::from([*label]))),
        }
    }
    let values: BTreeSet<L> = labels.iter().copied().flatten().collect();
    if values.len() < 2 {
        return None;
    }
    let labelled = motions.iter().zip(labels);
    let labelled = labelled.filter_map(|(motion, label)| Some((motion, (*label)?)));
    mean(labelled.map(|(motion, label)| {
        let distances = different.iter().map(|(text, _)| distance(text, motion));
        let distances: Vec<f64> = distances.collect();
        let all_finite = distances.iter().all(|distance| distance.is_finite());
        let nearest = distances.iter().copied().fold(f64::INFINITY, f64::min);
        let mut ranked = different.iter().zip(&distances);
        let right = ranked.any(|((_, values), d)| *d <= nearest && values.contains(&label));
        all_finite.then(|| f64::from(u8::from(right)))
    }))
}

/// Metrics of motions, their captions and real motions, by their embeddings. A metric without data
/// or with values that are not finite is `None`. The remainder after the last pool is dropped only
/// for the R-precision; the published program drops it for all metrics.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct TextMotionReport {
    /// Number of motions.
    pub samples: usize,
    /// Number of pools, for the R-precision.
    pub pools: usize,
    /// First number of [`r_precision`].
    pub r_precision_top1: Option<f64>,
    /// Second number of [`r_precision`].
    pub r_precision_top2: Option<f64>,
    /// Third number of [`r_precision`].
    pub r_precision_top3: Option<f64>,
    /// [`caption_accuracy`].
    #[serde(default)]
    pub caption_accuracy: Option<f64>,
    /// [`label_accuracy`] by label; empty without labels.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub label_accuracy: BTreeMap<String, Option<f64>>,
    /// [`multimodal_distance`].
    pub multimodal_distance: Option<f64>,
    /// [`frechet_distance`] from real motion (FID).
    pub frechet_distance: Option<f64>,
    /// [`feature_diversity`] over [`DIVERSITY_PAIRS`] pairs.
    pub diversity: Option<f64>,
}

impl TextMotionReport {
    /// Measures motions by the embeddings of motions, captions (at the same index) and real
    /// motions. `seed` determines the pairs for diversity.
    pub fn compute(texts: &[Vec<f64>], motions: &[Vec<f64>], real: &[Vec<f64>], seed: u64) -> Self {
        let r_precision = r_precision(texts, motions);
        let moments = FeatureMoments::compute(motions).zip(FeatureMoments::compute(real));
        Self {
            samples: motions.len(),
            pools: motions.len() / POOL,
            r_precision_top1: r_precision.map(|top| top[0]),
            r_precision_top2: r_precision.map(|top| top[1]),
            r_precision_top3: r_precision.map(|top| top[2]),
            caption_accuracy: caption_accuracy(texts, motions),
            label_accuracy: BTreeMap::new(),
            multimodal_distance: multimodal_distance(texts, motions),
            frechet_distance: moments.map(|(motions, real)| frechet_distance(&motions, &real)),
            diversity: feature_diversity(motions, DIVERSITY_PAIRS, seed),
        }
    }

    /// Adds the [`label_accuracy`] of each label of the motions.
    #[must_use]
    pub fn with_labels(
        mut self,
        texts: &[Vec<f64>],
        motions: &[Vec<f64>],
        labels: &[Option<&BTreeMap<String, String>>],
    ) -> Self {
        let names: BTreeSet<&String> = labels.iter().flatten().flat_map(|of| of.keys()).collect();
        for name in names {
            let values = labels.iter().map(|of| (*of)?.get(name).map(String::as_str));
            let values: Vec<Option<&str>> = values.collect();
            let accuracy = label_accuracy(texts, motions, &values);
            self.label_accuracy.insert(name.clone(), accuracy);
        }
        self
    }

    /// The metrics in print order, with name.
    pub fn rows(&self) -> Vec<(String, Option<f64>)> {
        let named = |(name, value): (&str, Option<f64>)| (name.to_owned(), value);
        let of_label =
            |(label, value): (&String, &Option<f64>)| (format!("{label} accuracy"), *value);
        let mut rows = vec![
            named(("R-precision, top 1", self.r_precision_top1)),
            named(("R-precision, top 2", self.r_precision_top2)),
            named(("R-precision, top 3", self.r_precision_top3)),
            named(("caption accuracy", self.caption_accuracy)),
        ];
        rows.extend(self.label_accuracy.iter().map(of_label));
        rows.extend([
            named(("multimodal distance", self.multimodal_distance)),
            named(("FID", self.frechet_distance)),
            named(("diversity", self.diversity)),
        ]);
        rows
    }
}

impl fmt::Display for TextMotionReport {
    /// One line for each available metric.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { samples, pools, .. } = self;
        let (samples, pools) = (counted(*samples, "motion"), counted(*pools, "pool"));
        write!(f, "{samples}, {pools} of {POOL}")?;
        for (name, value) in self.rows() {
            if let Some(value) = value {
                write!(f, "\n{name:<24} {value:>9.4}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_random::{Key, Purpose};

    use super::*;

    /// Embeddings on a line, at these places.
    fn at(places: impl IntoIterator<Item = f64>) -> Vec<Vec<f64>> {
        places.into_iter().map(|place| vec![place, 0.0]).collect()
    }

    /// The numbers below `count`.
    fn numbers(count: u8) -> impl Iterator<Item = f64> {
        (0..count).map(f64::from)
    }

    #[test]
    fn captions_beside_their_motions_find_them() {
        let motions = at(numbers(64));
        let texts = at(numbers(64).map(|place| place + 0.2));
        assert_eq!(r_precision(&texts, &motions), Some([1.0; 3]));
        let distance = multimodal_distance(&texts, &motions).unwrap();
        assert!((distance - 0.2).abs() < 1e-12);
    }

    #[test]
    fn a_motion_is_ranked_within_its_pool() {
        // Every caption is nearest to the next motion, then to its own. The last caption's next
        // motion is in another pool.
        let motions = at(numbers(64));
        let texts = at(numbers(64).map(|place| place + 0.9));
        let found = r_precision(&texts, &motions).unwrap();
        assert_eq!(found, [1.0 / 32.0, 1.0, 1.0]);
        // The own motion is third nearest, except for the last two of a pool.
        let texts = at(numbers(64).map(|place| place + 1.4));
        let found = r_precision(&texts, &motions).unwrap();
        assert_eq!(found, [1.0 / 32.0, 2.0 / 32.0, 1.0]);
    }

    #[test]
    fn the_remainder_is_not_ranked() {
        let mut motions = at(numbers(40));
        let texts = motions.clone();
        motions[32..].reverse();
        assert_eq!(r_precision(&texts, &motions), Some([1.0; 3]));
        assert_eq!(r_precision(&texts[..31], &motions[..31]), None);
        // The last eight distances add up to (7 + 5 + 3 + 1) * 2.
        assert_eq!(multimodal_distance(&texts, &motions), Some(32.0 / 40.0));
        assert_eq!(multimodal_distance(&[], &[]), None);
    }

    #[test]
    fn motions_that_are_all_alike_rank_as_by_chance() {
        let (texts, motions) = (at(numbers(32)), at([3.0; 32]));
        let chance = [1.0 / 32.0, 2.0 / 32.0, 3.0 / 32.0];
        assert_eq!(r_precision(&texts, &motions), Some(chance));
    }

    #[test]
    fn motions_of_equal_captions_are_as_good_as_the_own_one() {
        // There are two kinds: every caption is nearest to a motion of its kind.
        let motions = at(numbers(32).map(|place| place % 2.0 * 10.0 + place / 100.0));
        let kinds = at(numbers(32).map(|place| place % 2.0 * 10.0));
        assert_eq!(r_precision(&kinds, &motions), Some([1.0; 3]));
        assert_eq!(caption_accuracy(&kinds, &motions), Some(1.0));
        // Every caption is near the motions of the other kind, so these 16 rank first.
        let other = at(numbers(32).map(|place| 10.0 - place % 2.0 * 10.0));
        assert_eq!(r_precision(&other, &motions), Some([0.0; 3]));
        assert_eq!(caption_accuracy(&other, &motions), Some(0.0));
        assert_eq!(caption_accuracy(&at([1.0; 4]), &at(numbers(4))), None);
        assert_eq!(caption_accuracy(&[], &[]), None);
    }

    #[test]
    fn a_label_is_right_where_the_nearest_caption_has_it() {
        let labels = [
            ("walk", "sad"),
            ("walk", "happy"),
            ("run", "sad"),
            ("run", "happy"),
        ];
        let texts = at([0.0, 1.0, 10.0, 11.0]);
        // The first two motions are confused, and the last is nearest to the sad run.
        let motions = at([0.9, 0.1, 10.0, 10.2]);
        let of = |which: fn((&'static str, &'static str)) -> &'static str| {
            label_accuracy(&texts, &motions, &labels.map(|label| Some(which(label))))
        };
        assert_eq!(of(|label| label.0), Some(1.0));
        assert_eq!(of(|label| label.1), Some(0.25));
        // Motions without a label are not counted. A caption with two label values is right for
        // both.
        let some = [Some("sad"), Some("happy"), None, Some("happy")];
        assert_eq!(label_accuracy(&texts, &motions, &some), Some(1.0 / 3.0));
        let one = at([0.0, 0.0, 10.0, 11.0]);
        let some = [Some("sad"), Some("happy"), Some("sad"), Some("happy")];
        assert_eq!(label_accuracy(&one, &motions, &some), Some(0.75));
        assert_eq!(label_accuracy(&texts, &motions, &[Some("sad"); 4]), None);

        let labelled = labels.map(|(content, style)| {
            let named = |(a, b): (&str, &str)| (a.to_owned(), b.to_owned());
            BTreeMap::from([("content", content), ("style", style)].map(named))
        });
        let labelled: Vec<_> = labelled.iter().map(Some).collect();
        let report = TextMotionReport::compute(&texts, &motions, &motions, 0);
        let report = report.with_labels(&texts, &motions, &labelled);
        let found: Vec<_> = report.label_accuracy.into_iter().collect();
        let expected = [
            ("content".to_owned(), Some(1.0)),
            ("style".to_owned(), Some(0.25)),
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn broken_embeddings_have_no_metrics() {
        let motions = at(numbers(32));
        let mut broken = motions.clone();
        broken[7][1] = f64::NAN;
        let report = TextMotionReport::compute(&motions, &broken, &motions, 0);
        let none = TextMotionReport {
            samples: 32,
            pools: 1,
            ..TextMotionReport::default()
        };
        assert_eq!(report, none);
    }

    #[test]
    fn a_report_has_all_metrics_and_survives_storage() {
        let embeddings = |seed: u64| -> Vec<Vec<f64>> {
            let vector = |index| Key::new(seed, Purpose::Synthetic).at(index).normals(4);
            let wide = |vector: Vec<f32>| vector.into_iter().map(f64::from).collect();
            (0..70).map(vector).map(wide).collect()
        };
        let (texts, motions) = (embeddings(1), embeddings(2));
        let report = TextMotionReport::compute(&texts, &motions, &motions, 5);
        assert_eq!((report.samples, report.pools), (70, 2));
        assert!(report.frechet_distance.unwrap() < 1e-9);
        let diversity = feature_diversity(&motions, DIVERSITY_PAIRS, 5);
        assert_eq!(report.diversity, diversity);
        let top = r_precision(&texts, &motions).map(|top| top[2]);
        assert_eq!(report.r_precision_top3, top);
        let json = serde_json::to_string(&report).unwrap();
        assert_eq!(
            serde_json::from_str::<TextMotionReport>(&json).unwrap(),
            report
        );
        let printed = report.to_string();
        assert!(printed.starts_with("70 motions, 2 pools of 32\nR-precision, top 1 "));
        assert_eq!(printed.lines().count(), 8);
    }
}
