//! How features are normalised: mean and deviation of each channel over a dataset.
//!
//! Deviations are shared within the seven groups of the layout, so that the parts of a position
//! keep their proportions (docs/sources.md, section 3.5).

use serde::{Deserialize, Serialize};

use super::{FeatureError, FeatureLayout, Features, Root};
use crate::moments::{mean_and_deviation, merge_channel};
use crate::statistics::CONSTANT;

/// Mean and deviation of each channel as measured, gathered clip by clip.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureMoments {
    layout: FeatureLayout,
    root: Root,
    mean: Vec<f64>,
    std: Vec<f64>,
    frames: usize,
    clips: usize,
}

impl FeatureMoments {
    /// Measures one clip, every frame weighing the same.
    pub fn measure(clip: &Features) -> Self {
        let (layout, frames) = (clip.layout(), clip.frames());
        let column = |channel: usize| (0..frames).map(move |t| f64::from(clip.frame(t)[channel]));
        let moments = (0..layout.channels()).map(|channel| mean_and_deviation(column(channel)));
        let (mean, std) = moments.unzip();
        Self {
            layout,
            root: clip.root(),
            mean,
            std,
            frames,
            clips: 1,
        }
    }

    /// Takes in the moments of further clips, as if all had been measured together.
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`] for features of another skeleton;
    /// [`FeatureError::WrongRoot`] for another reading of the root.
    pub fn merge(&mut self, other: &Self) -> Result<(), FeatureError> {
        if other.layout != self.layout {
            return Err(FeatureError::LengthMismatch {
                what: "channels of a frame",
                expected: self.layout.channels(),
                found: other.layout.channels(),
            });
        }
        if other.root != self.root {
            return Err(FeatureError::WrongRoot {
                expected: self.root,
                found: other.root,
            });
        }
        let weights = [self.frames as f64, other.frames as f64];
        for channel in 0..self.mean.len() {
            (self.mean[channel], self.std[channel]) = merge_channel(
                weights,
                [self.mean[channel], other.mean[channel]],
                [self.std[channel], other.std[channel]],
            );
        }
        self.frames += other.frames;
        self.clips += other.clips;
        Ok(())
    }

    /// Mean of each channel, `[channels]`.
    pub fn mean(&self) -> &[f64] {
        &self.mean
    }

    /// Standard deviation of each channel (of the population: divided by the number of frames),
    /// `[channels]`.
    pub fn std(&self) -> &[f64] {
        &self.std
    }
}

/// What normalisation of features takes: `(value - mean) / std`.
///
/// Reading refuses lists of unequal length or one that no skeleton has, values that are not
/// finite, and a `std` that is not positive.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(try_from = "Stored", into = "Stored")]
pub struct FeatureStatistics {
    layout: FeatureLayout,
    stored: Stored,
}

/// The stored form of [`FeatureStatistics`].
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    root: Root,
    mean: Vec<f64>,
    std: Vec<f64>,
    frames: usize,
    clips: usize,
}

impl FeatureStatistics {
    /// The statistics of clips, one after the other.
    ///
    /// # Errors
    /// [`FeatureError::TooFewFrames`] if there are no clips; otherwise as
    /// [`FeatureMoments::merge`].
    pub fn compute<'a>(
        clips: impl IntoIterator<Item = &'a Features>,
    ) -> Result<Self, FeatureError> {
        let mut clips = clips.into_iter().map(FeatureMoments::measure);
        let mut moments = clips.next().ok_or(FeatureError::TooFewFrames {
            found: 0,
            needed: 1,
        })?;
        for clip in clips {
            moments.merge(&clip)?;
        }
        Ok(Self::from_moments(&moments))
    }

    /// The statistics that follow from measured moments: the deviation of every channel is the
    /// average of its group's, and 1 where the whole group is constant.
    pub fn from_moments(moments: &FeatureMoments) -> Self {
        let mut std = moments.std.clone();
        for group in moments.layout.groups() {
            let average = std[group.clone()].iter().sum::<f64>() / group.len() as f64;
            std[group].fill(if average < CONSTANT { 1.0 } else { average });
        }
        Self {
            layout: moments.layout,
            stored: Stored {
                root: moments.root,
                mean: moments.mean.clone(),
                std,
                frames: moments.frames,
                clips: moments.clips,
            },
        }
    }

    /// Means and deviations that come with a dataset, used as they are. `root` is the reading of
    /// the features that they were taken from; how many frames those were is not known: 0.
    ///
    /// # Errors
    /// [`FeatureError::InvalidChannels`] if no skeleton has so many channels;
    /// [`FeatureError::InvalidStatistics`] if a value is not finite or a deviation not positive.
    pub fn new(mean: Vec<f64>, std: Vec<f64>, root: Root) -> Result<Self, FeatureError> {
        Stored {
            root,
            mean,
            std,
            frames: 0,
            clips: 0,
        }
        .try_into()
    }

    /// Which channel says what.
    pub fn layout(&self) -> FeatureLayout {
        self.layout
    }

    /// The reading of the root that they belong to.
    pub fn root(&self) -> Root {
        self.stored.root
    }

    /// What normalisation subtracts, `[channels]`.
    pub fn mean(&self) -> &[f64] {
        &self.stored.mean
    }

    /// What normalisation divides by, `[channels]`.
    pub fn std(&self) -> &[f64] {
        &self.stored.std
    }

    /// Number of frames they were computed from; 0 where that is not known.
    pub fn frames(&self) -> usize {
        self.stored.frames
    }

    /// Number of clips they were computed from; 0 where that is not known.
    pub fn clips(&self) -> usize {
        self.stored.clips
    }

    /// The normalised values of a clip, channel-major `[channels, frames]`: what a network sees.
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`] for features of another skeleton;
    /// [`FeatureError::WrongRoot`] for another reading of the root.
    pub fn normalize(&self, features: &Features) -> Result<Vec<f32>, FeatureError> {
        let (expected, found) = (self.layout.channels(), features.layout().channels());
        if expected != found {
            return Err(FeatureError::LengthMismatch {
                what: "channels of a frame",
                expected,
                found,
            });
        }
        if features.root() != self.root() {
            return Err(FeatureError::WrongRoot {
                expected: self.root(),
                found: features.root(),
            });
        }
        let channels = self.mean().iter().zip(self.std()).enumerate();
        Ok(channels
            .flat_map(|(channel, (mean, std))| {
                (0..features.frames()).map(move |t| {
                    let value = f64::from(features.frame(t)[channel]);
                    ((value - mean) / std) as f32
                })
            })
            .collect())
    }

    /// The features of a network's output, normalised channel-major values `[channels, frames]`.
    ///
    /// # Errors
    /// [`FeatureError::NotWholeFrames`] unless the values make one or more whole frames;
    /// [`FeatureError::NonFinite`] if one is not finite.
    pub fn denormalize(&self, values: &[f32]) -> Result<Features, FeatureError> {
        let channels = self.layout.channels();
        let frames = values.len() / channels;
        let mut rows = values.to_vec();
        // A count that makes no whole frames is refused below, as it came.
        if values.len().is_multiple_of(channels) {
            for (t, row) in rows.chunks_exact_mut(channels).enumerate() {
                for (channel, value) in row.iter_mut().enumerate() {
                    let normalized = f64::from(values[channel * frames + t]);
                    *value = (normalized * self.std()[channel] + self.mean()[channel]) as f32;
                }
            }
        }
        Features::new(rows, self.layout, self.root())
    }
}

impl TryFrom<Stored> for FeatureStatistics {
    type Error = FeatureError;

    fn try_from(stored: Stored) -> Result<Self, FeatureError> {
        let layout = FeatureLayout::of_channels(stored.mean.len())?;
        if stored.std.len() != stored.mean.len() {
            return Err(FeatureError::LengthMismatch {
                what: "std",
                expected: stored.mean.len(),
                found: stored.std.len(),
            });
        }
        let refuse = |name: &str, channel: usize, found: f64, allowed: &'static str| {
            FeatureError::InvalidStatistics {
                field: format!("{name}[{channel}]"),
                found: found.to_string(),
                allowed,
            }
        };
        for (channel, mean) in stored.mean.iter().enumerate() {
            if !mean.is_finite() {
                return Err(refuse("mean", channel, *mean, "a finite number"));
            }
        }
        for (channel, std) in stored.std.iter().enumerate() {
            if !(std.is_finite() && *std > 0.0) {
                return Err(refuse("std", channel, *std, "a finite number above 0"));
            }
        }
        Ok(Self { layout, stored })
    }
}

impl From<FeatureStatistics> for Stored {
    fn from(statistics: FeatureStatistics) -> Self {
        statistics.stored
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A clip whose values wander by channel and frame; the contact flags stay 1.
    fn clip(frames: usize, scale: f32) -> Features {
        let layout = FeatureLayout::of_joints(3).unwrap();
        let channels = layout.channels();
        let value = |i: usize| match layout.contacts().contains(&(i % channels)) {
            true => 1.0,
            false => scale * ((i * 7919) % 101) as f32 - 3.0,
        };
        let values = (0..frames * channels).map(value).collect();
        Features::new(values, layout, Root::Relative).unwrap()
    }

    #[test]
    fn merged_clips_are_measured_as_one() {
        let clips = [clip(5, 0.01), clip(40, 1.0), clip(1, -2.0)];
        let whole = clips.iter().flat_map(|clip| clip.as_slice().to_vec());
        let whole = Features::new(whole.collect(), clips[0].layout(), Root::Relative).unwrap();
        let (merged, together) = (
            FeatureStatistics::compute(&clips).unwrap(),
            FeatureStatistics::compute([&whole]).unwrap(),
        );
        assert_eq!((merged.frames(), merged.clips()), (46, 3));
        for channel in 0..whole.layout().channels() {
            assert!((merged.mean()[channel] - together.mean()[channel]).abs() < 1e-12);
            assert!((merged.std()[channel] - together.std()[channel]).abs() < 1e-12);
        }
    }

    #[test]
    fn a_group_shares_its_deviation_and_a_constant_group_has_one() {
        let statistics = FeatureStatistics::compute([&clip(30, 0.3)]).unwrap();
        for group in statistics.layout().groups() {
            let std = &statistics.std()[group];
            assert!(std.iter().all(|value| *value == std[0]));
        }
        assert_eq!(statistics.std()[statistics.layout().contacts()], [1.0; 4]);
    }

    #[test]
    fn a_network_output_becomes_the_clip_again() {
        let clip = clip(12, 0.2);
        let statistics = FeatureStatistics::compute([&clip]).unwrap();
        let normalized = statistics.normalize(&clip).unwrap();
        let back = statistics.denormalize(&normalized).unwrap();
        for (a, b) in back.as_slice().iter().zip(clip.as_slice()) {
            assert!((a - b).abs() < 1e-5);
        }
        // Channel-major: the first channel's frames come first.
        let first = (f64::from(clip.frame(1)[0]) - statistics.mean()[0]) / statistics.std()[0];
        assert_eq!(normalized[1], first as f32);
        assert!(statistics.denormalize(&normalized[1..]).is_err());
        assert!(matches!(
            statistics.normalize(&clip.to_absolute()),
            Err(FeatureError::WrongRoot { .. })
        ));
    }

    #[test]
    fn unusable_statistics_are_refused_and_sound_ones_survive_storage() {
        let statistics = FeatureStatistics::compute([&clip(9, 0.5)]).unwrap();
        let json = serde_json::to_value(&statistics).unwrap();
        let read = |json| serde_json::from_value::<FeatureStatistics>(json);
        assert_eq!(read(json.clone()).unwrap(), statistics);
        let mut spoiled = json;
        spoiled["std"][7] = 0.into();
        let error = read(spoiled).unwrap_err().to_string();
        assert!(error.contains("`std[7]`"), "{error}");
        let new = |mean, std| FeatureStatistics::new(mean, std, Root::Relative);
        assert!(new(vec![0.0; 263], vec![1.0; 263]).is_ok());
        assert!(new(vec![0.0; 263], vec![1.0; 262]).is_err());
        assert!(new(vec![0.0; 264], vec![1.0; 264]).is_err());
        assert!(new(vec![f64::NAN; 263], vec![1.0; 263]).is_err());
    }
}
