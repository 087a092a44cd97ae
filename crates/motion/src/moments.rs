//! What the channels of some phrases look like: range, mean and standard deviation as measured.

use serde::{Deserialize, Serialize};

use crate::{CHANNELS, Error, Motion, channel_name};

/// Range, mean and standard deviation of each channel, as measured, in the dataset's units.
///
/// [`TrainingStatistics`](crate::TrainingStatistics) holds the mean and deviation that
/// normalisation uses instead, which differ for the quaternion, the phase and constant channels.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelMoments {
    /// Mean of each channel, `[25]`.
    pub mean: Vec<f64>,
    /// Standard deviation of each channel (of the population: divided by the number of frames),
    /// `[25]`.
    pub std: Vec<f64>,
    /// Smallest value of each channel, `[25]`.
    pub min: Vec<f64>,
    /// Largest value of each channel, `[25]`.
    pub max: Vec<f64>,
    /// Number of frames of all phrases together.
    pub frames: usize,
    /// Number of phrases.
    pub phrases: usize,
}

impl ChannelMoments {
    /// Measures phrases without padding, every frame weighing the same.
    ///
    /// # Errors
    /// [`Error::NoPhrases`] if there are none; [`Error::NonFinite`] if a value is not finite.
    pub fn compute<'a>(phrases: impl IntoIterator<Item = &'a Motion>) -> Result<Self, Error> {
        let phrases: Vec<&Motion> = phrases.into_iter().collect();
        if phrases.is_empty() {
            return Err(Error::NoPhrases);
        }
        for (phrase, motion) in phrases.iter().enumerate() {
            if let Some((frame, channel)) = motion.first_non_finite() {
                return Err(Error::NonFinite {
                    phrase,
                    frame,
                    channel: channel_name(channel),
                });
            }
        }
        let frames: usize = phrases.iter().map(|motion| motion.frames()).sum();
        let each_frame = || {
            phrases
                .iter()
                .flat_map(|motion| motion.as_slice().chunks(CHANNELS))
        };

        let mut mean = vec![0.0; CHANNELS];
        let mut min = vec![f64::INFINITY; CHANNELS];
        let mut max = vec![f64::NEG_INFINITY; CHANNELS];
        for frame in each_frame() {
            for (channel, &value) in frame.iter().enumerate() {
                let value = f64::from(value);
                mean[channel] += value;
                min[channel] = min[channel].min(value);
                max[channel] = max[channel].max(value);
            }
        }
        mean.iter_mut().for_each(|sum| *sum /= frames as f64);

        // A second pass: the difference of two sums of squares would lose the small deviations.
        let mut std = vec![0.0; CHANNELS];
        for frame in each_frame() {
            for (channel, &value) in frame.iter().enumerate() {
                std[channel] += (f64::from(value) - mean[channel]).powi(2);
            }
        }
        std.iter_mut()
            .for_each(|sum| *sum = (*sum / frames as f64).sqrt());
        Ok(Self {
            mean,
            std,
            min,
            max,
            frames,
            phrases: phrases.len(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn phrase(values: &[f32]) -> Motion {
        Motion::new(values.iter().flat_map(|&v| [v; CHANNELS]).collect()).unwrap()
    }

    #[test]
    fn every_frame_weighs_the_same() {
        let (long, short) = (phrase(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0]), phrase(&[9.0]));
        let moments = ChannelMoments::compute([&long, &short]).unwrap();
        assert_eq!((moments.frames, moments.phrases), (8, 2));
        for channel in 0..CHANNELS {
            assert_eq!(moments.mean[channel], 5.0);
            assert_eq!(moments.std[channel], 2.0);
            assert_eq!((moments.min[channel], moments.max[channel]), (2.0, 9.0));
        }
    }

    #[test]
    fn no_phrases_and_bad_phrases_are_errors() {
        assert_eq!(ChannelMoments::compute([]), Err(Error::NoPhrases));
        let (good, mut bad) = (phrase(&[1.0]), phrase(&[1.0, 2.0]));
        bad.frame_mut(1)[16] = f32::NAN;
        let error = ChannelMoments::compute([&good, &bad]).unwrap_err();
        assert_eq!(
            error,
            Error::NonFinite {
                phrase: 1,
                frame: 1,
                channel: "phase".to_string()
            }
        );
    }
}
