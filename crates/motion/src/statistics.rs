//! Statistics of training motion, for normalization and the bounds of sanity checks.
//!
//! The source trains on raw values and clips predictions to +-1, while positions range over +-100
//! (docs/sources.md, section 1.14, hazard 6). Here each channel has zero mean and unit deviation,
//! unless a [representation](crate::Representation) defines it otherwise.

use std::collections::BTreeMap;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::humanml::Root;
use crate::{ChannelMoments, Error};

/// A channel whose deviation is below this counts as constant.
pub(crate) const CONSTANT: f64 = 1e-8;

/// Statistics of the training motion, stored in the run.
///
/// A normalized value is `(value - mean) / std`. Deserialization rejects lists of unequal length,
/// values that are not finite, and a `std` that is not positive.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(try_from = "Stored", into = "Stored")]
pub struct Statistics {
    /// Subtracted in normalization, `[channels]`.
    pub mean: Vec<f64>,
    /// Divided by in normalization, `[channels]`.
    pub std: Vec<f64>,
    /// Smallest and largest value of each channel, `[channels]` each; `None` for published
    /// statistics.
    pub range: Option<[Vec<f64>; 2]>,
    /// Number of frames of all items; 0 if unknown.
    pub frames: usize,
    /// Number of items; 0 if unknown.
    pub items: usize,
    /// Root mean square of the root's speed, metres per second, if measured.
    pub rms_speed: Option<f64>,
    /// Root mean square of the root's acceleration, m/s^2, if measured.
    pub rms_acceleration: Option<f64>,
    /// 95th percentile of the items' mean jerk norms, metres per second cubed, if measured.
    pub jerk_p95: Option<f64>,
    /// 1st and 99th percentile over the items of each [measure](crate::MotionMeasure), if measured.
    pub movement: BTreeMap<String, [f64; 2]>,
    /// Representation of the root of joint features.
    pub root: Option<Root>,
}

impl Statistics {
    /// Statistics of motion in -1 to 1 that needs no normalization.
    pub fn unit(channels: usize) -> Self {
        Self {
            mean: vec![0.0; channels],
            std: vec![1.0; channels],
            range: Some([vec![-1.0; channels], vec![1.0; channels]]),
            frames: 1,
            items: 1,
            rms_speed: Some(1.0),
            rms_acceleration: Some(1.0),
            jerk_p95: Some(1.0),
            ..Self::default()
        }
    }

    /// Zero mean and unit deviation in every channel; constant channels keep their scale.
    pub fn standard(moments: ChannelMoments) -> Self {
        let scale = |deviation: f64| if deviation < CONSTANT { 1.0 } else { deviation };
        Self {
            mean: moments.mean,
            std: moments.std.into_iter().map(scale).collect(),
            range: Some([moments.min, moments.max]),
            frames: moments.frames,
            items: moments.items,
            ..Self::default()
        }
    }

    /// Means and deviations that come with a dataset.
    ///
    /// # Errors
    /// [`Error::InvalidStatistics`] for values that are not finite or deviations not positive.
    pub fn new(mean: Vec<f64>, std: Vec<f64>, root: Option<Root>) -> Result<Self, Error> {
        Self {
            mean,
            std,
            root,
            ..Self::default()
        }
        .checked()
    }

    /// Whether they contain the measures of movement; those that come with a dataset do not.
    pub fn describes_movement(&self) -> bool {
        let means = [self.rms_speed, self.rms_acceleration, self.jerk_p95];
        !self.movement.is_empty() && means.iter().all(Option::is_some)
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.mean.len()
    }

    /// The normalized values of one channel of `rows`, `[frames, channels]`.
    pub fn normalize_channel<'a>(
        &self,
        rows: &'a [f32],
        channel: usize,
    ) -> impl ExactSizeIterator<Item = f32> + use<'a> {
        let (mean, std) = (self.mean[channel], self.std[channel]);
        let frames = rows.chunks_exact(self.channels());
        frames.map(move |frame| ((f64::from(frame[channel]) - mean) / std) as f32)
    }

    /// The normalized `rows` `[frames, channels]` as channel-major `[channels, frames]`.
    pub fn normalize(&self, rows: &[f32]) -> Vec<f32> {
        let column = |channel| self.normalize_channel(rows, channel);
        (0..self.channels()).flat_map(column).collect()
    }

    /// The rows `[frames, channels]` of normalized channel-major values `[channels, frames]`.
    pub fn denormalize(&self, values: &[f32]) -> Vec<f32> {
        let frames = values.len() / self.channels();
        let row_major = (0..frames).flat_map(|t| (0..self.channels()).map(move |c| (t, c)));
        row_major
            .map(|(t, c)| (f64::from(values[c * frames + t]) * self.std[c] + self.mean[c]) as f32)
            .collect()
    }

    /// Normalized range of training motion, `[channels]` each, as bounds for predicted data. The
    /// source's bounds of +-1 would clip real data, which reaches 21 standard deviations.
    pub fn normalized_range(&self) -> Option<[Vec<f32>; 2]> {
        // Bounds are rounded like the data, so extreme items stay within.
        let bound = |values: &Vec<f64>| {
            let values: Vec<f32> = values.iter().map(|&value| value as f32).collect();
            self.normalize(&values)
        };
        self.range.as_ref().map(|range| range.each_ref().map(bound))
    }

    /// Widens the range of horizontal `vectors` to all directions, and of `signed` channels to +-1.
    pub fn widen_range_for_yaw(&mut self, vectors: &[Range<usize>], signed: Range<usize>) {
        let Some([min, max]) = &mut self.range else {
            return;
        };
        for vector in vectors {
            let (x, z) = (vector.start, vector.start + 2);
            let reach = |c: usize| min[c].abs().max(max[c].abs());
            let length = reach(x).hypot(reach(z));
            for channel in [x, z] {
                (min[channel], max[channel]) = (-length, length);
            }
        }
        for channel in signed {
            (min[channel], max[channel]) = (-1.0, 1.0);
        }
    }

    /// Widens the range of `channels` symmetrically about zero, for augmentation that negates them.
    pub fn widen_range_for_signs(&mut self, channels: impl IntoIterator<Item = usize>) {
        let Some([min, max]) = &mut self.range else {
            return;
        };
        for channel in channels {
            let reach = min[channel].abs().max(max[channel].abs());
            (min[channel], max[channel]) = (-reach, reach);
        }
    }

    /// Widens the range of `channels` by `factor` from zero, for augmentation that scales them.
    pub fn widen_range_by(&mut self, factor: f64, channels: impl IntoIterator<Item = usize>) {
        let Some([min, max]) = &mut self.range else {
            return;
        };
        for channel in channels {
            min[channel] = min[channel].min(factor * min[channel]);
            max[channel] = max[channel].max(factor * max[channel]);
        }
    }

    fn checked(self) -> Result<Self, Error> {
        let invalid = |reason: String| Err(Error::InvalidStatistics { reason });
        let channels = self.channels();
        let lists = [&self.mean, &self.std].into_iter();
        let lists = lists.chain(self.range.iter().flatten());
        for (name, list) in ["mean", "std", "min", "max"].into_iter().zip(lists) {
            if list.len() != channels {
                return invalid(format!("`{name}` has {} of {channels} values", list.len()));
            }
            if let Some(channel) = list.iter().position(|value| !value.is_finite()) {
                return invalid(format!("`{name}[{channel}]` is not finite"));
            }
        }
        if let Some(channel) = self.std.iter().position(|deviation| *deviation <= 0.0) {
            return invalid(format!("`std[{channel}]` is not positive"));
        }
        let unusable = |bounds: &[f64; 2]| !bounds.iter().all(|bound| bound.is_finite());
        match self.movement.iter().find(|(_, bounds)| unusable(bounds)) {
            Some((name, _)) => invalid(format!("`movement.{name}` is not finite")),
            None => Ok(self),
        }
    }
}

/// [`Statistics`] as stored. The name of the number of items depends on their kind.
#[derive(Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    #[serde(skip_serializing_if = "Option::is_none")]
    root: Option<Root>,
    mean: Vec<f64>,
    std: Vec<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    min: Option<Vec<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    max: Option<Vec<f64>>,
    frames: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    phrases: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    clips: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rms_speed: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rms_acceleration: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    jerk_p95: Option<f64>,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    movement: BTreeMap<String, [f64; 2]>,
}

impl TryFrom<Stored> for Statistics {
    type Error = Error;

    fn try_from(stored: Stored) -> Result<Self, Error> {
        Self {
            range: stored.min.zip(stored.max).map(|(min, max)| [min, max]),
            items: stored.phrases.or(stored.clips).unwrap_or_default(),
            mean: stored.mean,
            std: stored.std,
            frames: stored.frames,
            rms_speed: stored.rms_speed,
            rms_acceleration: stored.rms_acceleration,
            jerk_p95: stored.jerk_p95,
            movement: stored.movement,
            root: stored.root,
        }
        .checked()
    }
}

impl From<Statistics> for Stored {
    fn from(statistics: Statistics) -> Self {
        let (min, max) = statistics.range.map(|[min, max]| (min, max)).unzip();
        let (items, is_phrases) = (Some(statistics.items), statistics.root.is_none());
        Self {
            root: statistics.root,
            mean: statistics.mean,
            std: statistics.std,
            min,
            max,
            frames: statistics.frames,
            phrases: items.filter(|_| is_phrases),
            clips: items.filter(|_| !is_phrases),
            rms_speed: statistics.rms_speed,
            rms_acceleration: statistics.rms_acceleration,
            jerk_p95: statistics.jerk_p95,
            movement: statistics.movement,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(frames: usize) -> Vec<f32> {
        let value = |i: usize| {
            if i % 4 == 3 {
                0.3
            } else {
                ((i * 7919) % 101) as f32 - 40.0
            }
        };
        (0..4 * frames).map(value).collect()
    }

    fn example() -> (Vec<f32>, Statistics) {
        let rows = rows(20);
        let statistics = Statistics::standard(ChannelMoments::measure(4, [&rows[..]]));
        (rows, statistics)
    }

    #[test]
    fn normalised_motion_has_zero_mean_and_unit_deviation() {
        let (rows, statistics) = example();
        for (channel, row) in statistics.normalize(&rows).chunks(20).enumerate() {
            let mean = row.iter().map(|&v| f64::from(v)).sum::<f64>() / 20.0;
            let square = row.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>() / 20.0;
            let expected = if channel == 3 { 0.0 } else { 1.0 };
            assert!(mean.abs() < 1e-6, "{channel}: {mean}");
            assert!((square - expected).abs() < 1e-6, "{channel}: {square}");
        }
        assert_eq!(statistics.std[3], 1.0);
    }

    #[test]
    fn normalising_is_undone() {
        let (rows, statistics) = example();
        let normalized = statistics.normalize(&rows);
        // Channel-major: the first channel's frames come first.
        let first = (f64::from(rows[4]) - statistics.mean[0]) / statistics.std[0];
        assert_eq!(normalized[1], first as f32);
        for (a, b) in statistics.denormalize(&normalized).iter().zip(&rows) {
            assert!((a - b).abs() <= 1e-5, "{a} {b}");
        }
    }

    #[test]
    fn the_range_contains_the_training_motion_and_touches_it() {
        let (rows, statistics) = example();
        let [low, high] = statistics.normalized_range().unwrap();
        for (channel, row) in statistics.normalize(&rows).chunks(20).enumerate() {
            let within = row
                .iter()
                .all(|v| (low[channel]..=high[channel]).contains(v));
            assert!(within && row.contains(&low[channel]) && row.contains(&high[channel]));
        }
    }

    #[test]
    fn statistics_survive_storage_and_unusable_ones_are_refused() {
        let (_, statistics) = example();
        let json = serde_json::to_value(&statistics).unwrap();
        let read = |json| serde_json::from_value::<Statistics>(json);
        assert_eq!(read(json.clone()).unwrap(), statistics);
        let spoil = |key: &str, value: serde_json::Value| {
            let mut json = json.clone();
            json[key] = value;
            read(json).unwrap_err().to_string()
        };
        assert!(spoil("std", vec![1.0; 3].into()).contains("`std` has 3 of 4"));
        assert!(spoil("std", vec![1.0, 1.0, 0.0, 1.0].into()).contains("`std[2]`"));
        assert!(spoil("unheard_of", 1.into()).contains("unheard_of"));
        let new = |mean, std| Statistics::new(mean, std, Some(Root::Relative));
        assert!(new(vec![0.0; 263], vec![1.0; 263]).is_ok());
        assert!(new(vec![0.0; 263], vec![1.0; 262]).is_err());
        assert!(new(vec![f64::NAN; 263], vec![1.0; 263]).is_err());
    }
}
