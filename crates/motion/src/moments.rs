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
        let column = |channel: usize| {
            let rows = phrases.iter().map(|motion| motion.as_slice().iter());
            let values = rows.flat_map(move |values| values.skip(channel).step_by(CHANNELS));
            values.map(|&value| f64::from(value))
        };
        let each = |of: &dyn Fn(usize) -> f64| (0..CHANNELS).map(of).collect();
        let (mean, std) = (0..CHANNELS).map(|c| mean_and_deviation(column(c))).unzip();
        Ok(Self {
            mean,
            std,
            min: each(&|c| column(c).fold(f64::INFINITY, f64::min)),
            max: each(&|c| column(c).fold(f64::NEG_INFINITY, f64::max)),
            frames,
            phrases: phrases.len(),
        })
    }

    /// Takes in the moments of further phrases, as if all had been measured together.
    pub fn merge(&mut self, other: &Self) {
        let frames = [self.frames as f64, other.frames as f64];
        for channel in 0..CHANNELS {
            (self.mean[channel], self.std[channel]) = merge_channel(
                frames,
                [self.mean[channel], other.mean[channel]],
                [self.std[channel], other.std[channel]],
            );
            self.min[channel] = self.min[channel].min(other.min[channel]);
            self.max[channel] = self.max[channel].max(other.max[channel]);
        }
        self.frames += other.frames;
        self.phrases += other.phrases;
    }
}

/// Mean and standard deviation of values (of the population: divided by their number).
pub(crate) fn mean_and_deviation(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    // A second pass: the difference of two sums of squares would lose the small deviations.
    let squares = values.map(|value| (value - mean).powi(2));
    (mean, (squares.sum::<f64>() / count).sqrt())
}

/// Mean and standard deviation of two samples together, from the size, mean and deviation of each
/// (Chan, Golub and LeVeque 1979).
pub(crate) fn merge_channel([n, m]: [f64; 2], mean: [f64; 2], std: [f64; 2]) -> (f64, f64) {
    let total = n + m;
    let apart = mean[1] - mean[0];
    let squares = n * std[0].powi(2) + m * std[1].powi(2) + apart.powi(2) * n * m / total;
    (mean[0] + apart * m / total, (squares / total).sqrt())
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

    #[test]
    fn merged_moments_are_those_of_all_phrases_together() {
        let motion = |frames: usize, scale: f32| {
            let values = (0..frames * CHANNELS).map(|i| scale * ((i * 7919) % 101) as f32 - 3.0);
            Motion::new(values.collect()).expect("whole frames")
        };
        let phrases = [motion(5, 0.01), motion(40, 1.0), motion(1, -2.0)];
        let together = ChannelMoments::compute(&phrases).expect("finite numbers");
        let mut merged = ChannelMoments::compute([&phrases[0]]).expect("finite numbers");
        for phrase in &phrases[1..] {
            merged.merge(&ChannelMoments::compute([phrase]).expect("finite numbers"));
        }
        for channel in 0..CHANNELS {
            assert!((merged.mean[channel] - together.mean[channel]).abs() < 1e-12);
            assert!((merged.std[channel] - together.std[channel]).abs() < 1e-12);
        }
        assert_eq!((&merged.min, &merged.max), (&together.min, &together.max));
        assert_eq!((merged.frames, merged.phrases), (46, 3));
    }
}
