//! Style conditions of samples.

use kinegrad_motion::Statistics;
use kinegrad_motion::phrase::{CHANNELS, STYLE as STYLE_CHANNELS};

/// Name of the condition on style numbers `[9, 1]`: eight normalized numbers and a 1. Zeros are the
/// null condition.
pub const STYLE: &str = "style";

/// Name of the condition on the label, `[labels, 1]`, one-hot. Zeros are the null condition.
pub const LABEL: &str = "label";

/// Style numbers of a phrase.
pub const STYLE_NUMBERS: usize = 8;

/// The style conditions of samples: numbers, label, both or neither.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StyleConditions {
    /// Mean and deviation of each style channel.
    scale: Option<[[f64; STYLE_NUMBERS]; 2]>,
    labels: Option<Vec<String>>,
}

impl StyleConditions {
    /// Adds style numbers, normalized by `statistics` of the 25 stored channels.
    #[must_use]
    pub fn with_numbers(self, statistics: &Statistics) -> Self {
        let of = |values: &[f64]| {
            let values = values[STYLE_CHANNELS].iter().copied();
            <[f64; STYLE_NUMBERS]>::try_from(values.collect::<Vec<_>>()).expect("eight channels")
        };
        Self {
            scale: Some([of(&statistics.mean), of(&statistics.std)]),
            ..self
        }
    }

    /// Adds a label, one of `labels`.
    #[must_use]
    pub fn with_labels(self, labels: Vec<String>) -> Self {
        Self {
            labels: Some(labels),
            ..self
        }
    }

    /// Name and number of values of each condition.
    pub fn shapes(&self) -> Vec<(&'static str, usize)> {
        let numbers = self.scale.map(|_| (STYLE, STYLE_NUMBERS + 1));
        let labels = self.labels.as_ref().map(|labels| (LABEL, labels.len()));
        numbers.into_iter().chain(labels).collect()
    }

    /// The known labels; `None` without a label condition.
    pub fn labels(&self) -> Option<&[String]> {
        self.labels.as_deref()
    }

    /// The values of each condition, in the order of [`shapes`](Self::shapes), for a label and
    /// style `numbers` in physical units. Missing or unknown values give zeros.
    pub fn values(
        &self,
        numbers: Option<[f64; STYLE_NUMBERS]>,
        label: Option<&str>,
    ) -> Vec<Vec<f32>> {
        let of_numbers = self.scale.map(|[mean, std]| match numbers {
            None => vec![0.0; STYLE_NUMBERS + 1],
            Some(numbers) => {
                let normalized = |i: usize| ((numbers[i] - mean[i]) / std[i]) as f32;
                let normalized = (0..STYLE_NUMBERS).map(normalized);
                normalized.chain([1.0]).collect()
            }
        });
        let of_label = self.labels.as_ref().map(|labels| {
            let is_label = |known: &String| f32::from(Some(known.as_str()) == label);
            labels.iter().map(is_label).collect()
        });
        of_numbers.into_iter().chain(of_label).collect()
    }
}

/// The mean of the style channels of `rows`, `[frames, 25]`, at least one frame.
pub fn mean_style(rows: &[f32]) -> [f64; STYLE_NUMBERS] {
    let mut sum = [0.0; STYLE_NUMBERS];
    for frame in rows.chunks_exact(CHANNELS) {
        let channels = &frame[STYLE_CHANNELS];
        for (sum, &value) in sum.iter_mut().zip(channels) {
            *sum += f64::from(value);
        }
    }
    let frames = (rows.len() / CHANNELS) as f64;
    sum.map(|sum| sum / frames)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn statistics() -> Statistics {
        let mut statistics = Statistics::unit(CHANNELS);
        for channel in STYLE_CHANNELS {
            statistics.mean[channel] = channel as f64;
            statistics.std[channel] = 2.0;
        }
        statistics
    }

    #[test]
    fn the_number_of_conditions_follows_the_style() {
        let labels = || vec!["rumba".to_owned(), "waltz".to_owned()];
        let none = StyleConditions::default();
        let both = none
            .clone()
            .with_numbers(&statistics())
            .with_labels(labels());
        assert!(none.shapes().is_empty() && none.values(None, Some("waltz")).is_empty());
        assert_eq!(both.shapes(), [(STYLE, 9), (LABEL, 2)]);
        assert_eq!(none.with_labels(labels()).shapes(), [(LABEL, 2)]);
        let numbers = [17.0, 18.0, 19.0, 20.0, 21.0, 22.0, 23.0, 26.0];
        assert_eq!(
            both.values(Some(numbers), Some("waltz")),
            [
                vec![0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0],
                vec![0.0, 1.0]
            ]
        );
        // Missing values and an unknown label give zeros.
        assert_eq!(
            both.values(None, Some("tango")),
            [vec![0.0; 9], vec![0.0; 2]]
        );
    }

    #[test]
    fn the_numbers_are_means_over_the_frames() {
        let mut rows = vec![7.0; 3 * CHANNELS];
        for (t, frame) in rows.chunks_exact_mut(CHANNELS).enumerate() {
            for (i, value) in frame[STYLE_CHANNELS].iter_mut().enumerate() {
                *value = (i * t) as f32;
            }
        }
        assert_eq!(mean_style(&rows), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    }
}
