//! Clipping of the predicted clean motion.

use burn::tensor::{Tensor, TensorData};
use kinegrad_settings::{InvalidSetting, Refused, require};

/// Bounds of the predicted clean motion, in the network's units (normalized motion).
///
/// The source clips to [-1, 1] (CC-MotionGen, sections 3.2.4 and 8.1; docs/sources.md, sections 1.3
/// and 1.9). Some channels of real motion exceed that range by far. Bounds per channel from
/// training data keep real motion unchanged.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum ClipRange {
    /// No bounds.
    #[default]
    None,
    /// Clips every channel to `[-bound, bound]`.
    Symmetric(f32),
    /// Clips channel `c` to `[min[c], max[c]]`.
    PerChannel {
        /// Smallest value of each channel.
        min: Vec<f32>,
        /// Largest value of each channel.
        max: Vec<f32>,
    },
    /// Clips to the inner bounds, with the gradient of the identity (straight-through estimator,
    /// Bengio et al. 2013, <https://arxiv.org/abs/1308.3432>). With plain clipping, a rollout has
    /// zero gradient if its early steps exceed all bounds.
    StraightThrough(Box<ClipRange>),
}

impl ClipRange {
    /// Checks the bounds for motions with `channels` channels.
    ///
    /// # Errors
    /// Fails if the number of bounds is wrong, a minimum exceeds its maximum, or a bound is NaN.
    pub fn validate(&self, channels: usize) -> Result<(), InvalidSetting> {
        match self {
            Self::None => Ok(()),
            Self::StraightThrough(bounds) => bounds.validate(channels),
            Self::Symmetric(bound) => ordered(0, -bound, *bound),
            Self::PerChannel { min, max } => {
                let found = format!("bounds of {} and {} channels", min.len(), max.len());
                let allowed = format!("a minimum and a maximum for each of {channels} channels");
                require(
                    [min.len(), max.len()] == [channels; 2],
                    "clip",
                    found,
                    allowed,
                )
                .hint("the motion has other channels than the bounds were taken from")?;
                let mut bounds = min.iter().zip(max).enumerate();
                bounds.try_for_each(|(channel, (&min, &max))| ordered(channel, min, max))
            }
        }
    }

    /// `x` within the bounds.
    ///
    /// # Shapes
    /// - x, output: `[batch, channels, time]`
    ///
    /// # Errors
    /// The errors of [`ClipRange::validate`].
    pub fn apply(&self, x: Tensor<3>) -> Result<Tensor<3>, InvalidSetting> {
        let shape = x.dims();
        let channels = shape[1];
        self.validate(channels)?;
        Ok(match self {
            Self::None => x,
            Self::Symmetric(bound) => x.clamp(-bound, *bound),
            Self::StraightThrough(bounds) => {
                let value = x.clone().without_autodiff();
                bounds.apply(value.clone())? + (x - value)
            }
            Self::PerChannel { min, max } => {
                let options = (&x.device(), x.dtype());
                let bounds = |values: &[f32]| -> Tensor<3> {
                    let data = TensorData::new(values.to_vec(), [1, channels, 1]);
                    Tensor::<3>::from_data(data, options).expand(shape)
                };
                let (min, max) = (bounds(min), bounds(max));
                x.max_pair(min).min_pair(max)
            }
        })
    }
}

fn ordered(channel: usize, min: f32, max: f32) -> Result<(), InvalidSetting> {
    let found = format!("[{min}, {max}] in channel {channel}");
    let allowed = "a minimum that does not exceed its maximum";
    // The comparison also rejects NaN.
    require(min <= max, "clip", found, allowed)
        .hint("bounds of data that contains NaN look like this")
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;

    fn clipped(clip: &ClipRange) -> Vec<f32> {
        let values = vec![-9.0f32, 0.5, 9.0, -9.0, 0.5, 9.0];
        let x = Tensor::from_data(TensorData::new(values, [1, 2, 3]), &Device::flex());
        clip.apply(x)
            .unwrap()
            .into_data()
            .try_to_vec::<f32>()
            .unwrap()
    }

    #[test]
    fn each_channel_has_its_bounds() {
        assert_eq!(clipped(&ClipRange::None), [-9.0, 0.5, 9.0, -9.0, 0.5, 9.0]);
        assert_eq!(
            clipped(&ClipRange::Symmetric(2.0)),
            [-2.0, 0.5, 2.0, -2.0, 0.5, 2.0]
        );
        let clip = ClipRange::PerChannel {
            min: vec![-1.0, 0.0],
            max: vec![2.0, 0.25],
        };
        assert_eq!(clipped(&clip), [-1.0, 0.5, 2.0, 0.0, 0.25, 0.25]);
    }

    #[test]
    fn bounds_that_cannot_be_are_refused() {
        let clip = |min: &[f32], max: &[f32]| ClipRange::PerChannel {
            min: min.into(),
            max: max.into(),
        };
        let found = |clip: ClipRange| clip.validate(2).unwrap_err().found;
        assert_eq!(
            found(clip(&[0.0], &[1.0, 1.0])),
            "bounds of 1 and 2 channels"
        );
        for bad in [
            clip(&[0.0, 2.0], &[1.0, 1.0]),
            clip(&[0.0, f32::NAN], &[1.0, 1.0]),
        ] {
            assert!(found(bad).ends_with("in channel 1"));
        }
        assert!(ClipRange::Symmetric(-1.0).validate(2).is_err());
        assert!(ClipRange::Symmetric(f32::NAN).validate(2).is_err());
        clip(&[0.0, 1.0], &[1.0, 1.0]).validate(2).unwrap();
    }
}
