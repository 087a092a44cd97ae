//! What a run remembers of its training phrases: how to normalise, and what real motion is like.
//!
//! The source trains on raw values and clips predicted data to +-1 while positions range over +-100
//! (docs/sources.md, section 1.14, hazard 6). Here each channel is brought to zero mean and unit
//! deviation, except where a channel has a natural scale: the quaternion stays as it is (its norm
//! would no longer be 1), and the phase is centred from [0, 1] to [-1, 1].

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::kinematics::mean_jerk_norm;
use crate::phrase::{ACCELERATION, ANGULAR_VELOCITY, PHASE, POSITION, QUATERNION, VELOCITY};
use crate::{CHANNELS, ChannelMoments, Error, Motion};

/// A channel whose deviation is below this counts as constant.
pub(crate) const CONSTANT: f64 = 1e-8;

/// Statistics of the training phrases, computed once and stored in the run.
///
/// A normalised value is `(value - mean) / std`. Reading refuses lists of another length than 25,
/// values that are not finite, and a `std` that is not positive.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(try_from = "Stored")]
pub struct TrainingStatistics {
    /// What normalisation subtracts, `[25]`, dataset units: the mean, but 0 for the quaternion and
    /// 0.5 for the phase.
    pub mean: Vec<f64>,
    /// What normalisation divides by, `[25]`, dataset units: the standard deviation, but 1 for the
    /// quaternion, 0.5 for the phase and 1 for a constant channel.
    pub std: Vec<f64>,
    /// Smallest value of each channel, `[25]`, dataset units.
    pub min: Vec<f64>,
    /// Largest value of each channel, `[25]`, dataset units.
    pub max: Vec<f64>,
    /// Number of frames of all training phrases together.
    pub frames: usize,
    /// Number of training phrases.
    pub phrases: usize,
    /// Root mean square of the speed over all frames, metres per second.
    pub rms_speed: f64,
    /// Root mean square of the acceleration over all frames, metres per second squared.
    pub rms_acceleration: f64,
    /// 95th percentile (linear interpolation) of the phrases' mean jerk norms, metres per second
    /// cubed.
    pub jerk_p95: f64,
}

impl TrainingStatistics {
    /// Those of motion that is its own normalised form, in -1 to 1.
    pub fn unit() -> Self {
        Self {
            mean: vec![0.0; CHANNELS],
            std: vec![1.0; CHANNELS],
            min: vec![-1.0; CHANNELS],
            max: vec![1.0; CHANNELS],
            frames: 1,
            phrases: 1,
            rms_speed: 1.0,
            rms_acceleration: 1.0,
            jerk_p95: 1.0,
        }
    }

    /// Computes the statistics of phrases without padding, in double precision.
    ///
    /// # Errors
    /// [`Error::NoPhrases`] if there are none; [`Error::NonFinite`] if a value is not finite.
    pub fn compute<'a>(phrases: impl IntoIterator<Item = &'a Motion>) -> Result<Self, Error> {
        let phrases: Vec<&Motion> = phrases.into_iter().collect();
        let moments = ChannelMoments::compute(phrases.iter().copied())?;
        let jerks = phrases
            .iter()
            .map(|motion| mean_jerk_norm(motion))
            .collect();
        Ok(Self::from_moments(moments, jerks))
    }

    /// The statistics that follow from the phrases' `moments` and the mean jerk norm of each
    /// ([`mean_jerk_norm`], m/s^3).
    ///
    /// # Panics
    /// Panics if there are no jerks.
    pub fn from_moments(moments: ChannelMoments, jerks: Vec<f64>) -> Self {
        let ChannelMoments {
            mut mean,
            mut std,
            min,
            max,
            frames,
            phrases,
        } = moments;
        // E|v|^2 is the sum over the axes of squared mean plus squared deviation.
        let rms = |channels: std::ops::Range<usize>| {
            channels
                .map(|c| mean[c].powi(2) + std[c].powi(2))
                .sum::<f64>()
                .sqrt()
        };
        let (rms_speed, rms_acceleration) = (rms(VELOCITY), rms(ACCELERATION));
        for deviation in std.iter_mut().filter(|deviation| **deviation < CONSTANT) {
            *deviation = 1.0;
        }
        mean[QUATERNION].fill(0.0);
        std[QUATERNION].fill(1.0);
        (mean[PHASE], std[PHASE]) = (0.5, 0.5);
        Self {
            mean,
            std,
            min,
            max,
            frames,
            phrases,
            rms_speed,
            rms_acceleration,
            jerk_p95: percentile(jerks, 95.0),
        }
    }

    /// Normalises frame-major values `[frames, 25]` in place.
    ///
    /// # Panics
    /// Panics if the length is no multiple of 25.
    pub fn normalize(&self, values: &mut [f32]) {
        self.each(values, normalized);
    }

    /// Brings normalised frame-major values `[frames, 25]` back to the dataset's units, in place.
    ///
    /// # Panics
    /// Panics if the length is no multiple of 25.
    pub fn denormalize(&self, values: &mut [f32]) {
        self.each(values, |value, mean, std| {
            (f64::from(value) * std + mean) as f32
        });
    }

    /// The normalised values of a phrase, channel-major `[25, frames]`: what a network sees.
    pub fn normalize_motion(&self, motion: &Motion) -> Vec<f32> {
        let channels = (0..CHANNELS)
            .flat_map(|channel| self.normalize_channel(motion, channel, 0..motion.frames()));
        channels.collect()
    }

    /// The normalised values of one channel in the frames of `range`, `[range.len()]`.
    ///
    /// # Panics
    /// Panics unless `channel < 25`, or if `range` reaches beyond the last frame.
    pub fn normalize_channel<'a>(
        &self,
        motion: &'a Motion,
        channel: usize,
        range: Range<usize>,
    ) -> impl ExactSizeIterator<Item = f32> + use<'a> {
        let (mean, std) = (self.mean[channel], self.std[channel]);
        let (frames, _) = motion.as_slice().as_chunks::<CHANNELS>();
        let values = frames[range].iter().map(move |frame| frame[channel]);
        values.map(move |value| normalized(value, mean, std))
    }

    /// The phrase of a network's output, normalised channel-major values `[25, frames]`.
    ///
    /// # Panics
    /// Panics if there are not `25 * frames` values or `frames` is zero.
    pub fn denormalize_channel_major(&self, values: &[f32], frames: usize) -> Motion {
        let mut motion =
            Motion::from_channel_major(values, frames).expect("25 values for each of the frames");
        for t in 0..frames {
            self.denormalize(motion.frame_mut(t));
        }
        motion
    }

    /// Widens the ranges to what the phrases reach when they are turned about the vertical by any
    /// angle: horizontal vectors by their length (at most), quaternions to +-1. A model trained on
    /// turned phrases draws motion in all directions, which the phrases' own ranges would clip.
    pub fn widen_ranges_for_yaw(&mut self) {
        for vector in [POSITION, VELOCITY, ACCELERATION, ANGULAR_VELOCITY] {
            let (x, z) = (vector.start, vector.start + 2);
            let reach = |c: usize| self.min[c].abs().max(self.max[c].abs());
            let length = reach(x).hypot(reach(z));
            for channel in [x, z] {
                (self.min[channel], self.max[channel]) = (-length, length);
            }
        }
        for channel in QUATERNION {
            (self.min[channel], self.max[channel]) = (-1.0, 1.0);
        }
    }

    /// Smallest and largest value of each channel in the training phrases in normalised units,
    /// `[25]` each: the bounds for clipping predicted data. The source's bounds of +-1 would cut
    /// real data, which reaches 21 standard deviations in single channels.
    pub fn normalized_range(&self) -> (Vec<f32>, Vec<f32>) {
        let bound = |values: &[f64]| {
            // Rounded like the data, so that the extreme phrase itself stays within.
            let mut bounds: Vec<f32> = values.iter().map(|&value| value as f32).collect();
            self.normalize(&mut bounds);
            bounds
        };
        (bound(&self.min), bound(&self.max))
    }

    fn each(&self, values: &mut [f32], map: impl Fn(f32, f64, f64) -> f32) {
        assert!(
            values.len().is_multiple_of(CHANNELS),
            "whole frames of 25 channels"
        );
        for frame in values.chunks_exact_mut(CHANNELS) {
            for (channel, value) in frame.iter_mut().enumerate() {
                *value = map(*value, self.mean[channel], self.std[channel]);
            }
        }
    }
}

fn normalized(value: f32, mean: f64, std: f64) -> f32 {
    ((f64::from(value) - mean) / std) as f32
}

/// The `percent`-th percentile with linear interpolation between the two nearest of the `values`,
/// of which there is at least one.
fn percentile(mut values: Vec<f64>, percent: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = percent / 100.0 * (values.len() - 1) as f64;
    let below = place.floor() as usize;
    let above = (below + 1).min(values.len() - 1);
    values[below] + (values[above] - values[below]) * place.fract()
}

/// [`TrainingStatistics`] as read, before its lists are known to be usable.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    mean: Vec<f64>,
    std: Vec<f64>,
    min: Vec<f64>,
    max: Vec<f64>,
    frames: usize,
    phrases: usize,
    rms_speed: f64,
    rms_acceleration: f64,
    jerk_p95: f64,
}

impl TryFrom<Stored> for TrainingStatistics {
    type Error = Error;

    fn try_from(stored: Stored) -> Result<Self, Error> {
        let invalid = |reason: String| Err(Error::InvalidStatistics { reason });
        let Stored {
            mean,
            std,
            min,
            max,
            ..
        } = stored;
        for (name, list) in [("mean", &mean), ("std", &std), ("min", &min), ("max", &max)] {
            if list.len() != CHANNELS {
                return invalid(format!("`{name}` has {} of {CHANNELS} values", list.len()));
            }
            if list.iter().any(|value| !value.is_finite()) {
                return invalid(format!("`{name}` holds a value that is not finite"));
            }
        }
        if std.iter().any(|deviation| *deviation <= 0.0) {
            return invalid("`std` holds a value that is not positive".to_string());
        }
        let Stored {
            frames,
            phrases,
            rms_speed,
            rms_acceleration,
            jerk_p95,
            ..
        } = stored;
        Ok(Self {
            mean,
            std,
            min,
            max,
            frames,
            phrases,
            rms_speed,
            rms_acceleration,
            jerk_p95,
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::phrase::STYLE;
    use crate::wandering::wandering;

    fn example() -> (Vec<Motion>, TrainingStatistics) {
        let mut phrases: Vec<Motion> = (0..5).map(|seed| wandering(seed, 20)).collect();
        for motion in &mut phrases {
            for t in 0..motion.frames() {
                motion.frame_mut(t)[STYLE.start] = 0.3;
            }
        }
        let statistics = TrainingStatistics::compute(&phrases).unwrap();
        (phrases, statistics)
    }

    #[test]
    fn normalised_training_phrases_have_zero_mean_and_unit_deviation() {
        let (phrases, statistics) = example();
        let normalized: Vec<Motion> = phrases
            .iter()
            .map(|motion| {
                let mut values = motion.clone().into_vec();
                statistics.normalize(&mut values);
                Motion::new(values).unwrap()
            })
            .collect();
        let moments = ChannelMoments::compute(&normalized).unwrap();
        let constant = STYLE.start;
        for channel in (0..CHANNELS).filter(|c| !QUATERNION.contains(c) && *c != PHASE) {
            let deviation = if channel == constant { 0.0 } else { 1.0 };
            assert!(
                moments.mean[channel].abs() < 1e-6,
                "{channel}: {}",
                moments.mean[channel]
            );
            assert!((moments.std[channel] - deviation).abs() < 1e-6);
        }
        assert_eq!(statistics.std[constant], 1.0);
        for (before, after) in phrases.iter().zip(&normalized) {
            for t in 0..before.frames() {
                assert_eq!(before.frame(t)[QUATERNION], after.frame(t)[QUATERNION]);
                assert_eq!(after.frame(t)[PHASE], 2.0 * before.frame(t)[PHASE] - 1.0);
            }
        }
    }

    #[test]
    fn the_range_holds_the_training_phrases_and_touches_them() {
        let (phrases, statistics) = example();
        let (low, high) = statistics.normalized_range();
        let mut touched = [false; 2 * CHANNELS];
        for motion in &phrases {
            let values = statistics.normalize_motion(motion);
            for (channel, row) in values.chunks(motion.frames()).enumerate() {
                for &value in row {
                    assert!(low[channel] <= value && value <= high[channel], "{channel}");
                    touched[channel] |= value == low[channel];
                    touched[CHANNELS + channel] |= value == high[channel];
                }
            }
        }
        assert!(touched.iter().all(|touch| *touch));
    }

    #[test]
    fn scales_of_real_motion_are_those_of_the_vectors() {
        let mut motion = Motion::new(vec![0.0; 4 * CHANNELS]).unwrap();
        for (t, speed) in [1.0, 1.0, 5.0, 5.0].into_iter().enumerate() {
            motion.set_vector(t, VELOCITY, [0.6 * speed, 0.0, -0.8 * speed]);
            motion.set_vector(t, ACCELERATION, [0.0, 2.0 * t as f64, 0.0]);
        }
        let statistics = TrainingStatistics::compute([&motion]).unwrap();
        assert!((statistics.rms_speed - 13.0f64.sqrt()).abs() < 1e-6);
        assert!((statistics.rms_acceleration - 14.0f64.sqrt()).abs() < 1e-12);
        assert_eq!(statistics.jerk_p95, 60.0);
    }

    #[test]
    fn percentiles_are_interpolated() {
        assert_eq!(percentile(vec![7.0], 95.0), 7.0);
        assert_eq!(percentile(vec![3.0, 1.0, 2.0], 50.0), 2.0);
        assert!((percentile(vec![20.0, 0.0, 10.0], 95.0) - 19.0).abs() < 1e-12);
    }

    #[test]
    fn statistics_survive_storage_and_unusable_ones_are_refused() {
        let (_, statistics) = example();
        let json = serde_json::to_value(&statistics).unwrap();
        let read = |json| serde_json::from_value::<TrainingStatistics>(json);
        assert_eq!(read(json.clone()).unwrap(), statistics);
        let spoil = |key: &str, value: serde_json::Value| {
            let mut json = json.clone();
            json[key] = value;
            read(json).unwrap_err().to_string()
        };
        assert!(spoil("mean", vec![0.0; 24].into()).contains("24 of 25"));
        assert!(spoil("std", vec![0.0; 25].into()).contains("not positive"));
        assert!(spoil("unheard_of", 1.into()).contains("unheard_of"));
    }

    proptest! {
        #[test]
        fn normalising_is_undone(seed: u64, frames in 1usize..30) {
            let (_, statistics) = example();
            let motion = wandering(seed, frames);
            let normalized = statistics.normalize_motion(&motion);
            let back = statistics.denormalize_channel_major(&normalized, frames);
            for (channel, (a, b)) in back.as_slice().iter().zip(motion.as_slice()).enumerate() {
                let scale = statistics.std[channel % CHANNELS] as f32;
                prop_assert!((a - b).abs() <= 1e-6 * (scale * 20.0 + b.abs()));
            }
        }
    }
}
