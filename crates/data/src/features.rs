//! The 163 audio features of a frame (CC-MotionGen, sections 4.1 and 4.3), as stored.

use std::ops::Range;

use kinegrad_audio::Features;

use crate::magnitude::{first_unusable, is_usable};

/// The arrays of `features.npz` in the order in which they are stacked, with their rows.
pub const FEATURES: [(&str, usize); 6] = [
    ("mel", 128),
    ("chroma", 12),
    ("mfcc", 20),
    ("rms", 1),
    ("spectral_centroid", 1),
    ("onset_strength", 1),
];

/// Audio features of one frame.
pub const AUDIO_CHANNELS: usize = 163;

/// Channel of the onset strength, the last.
const ONSET_STRENGTH: usize = AUDIO_CHANNELS - 1;

/// Name of an audio channel: `mel[17]`, `rms`.
///
/// # Panics
/// Panics unless `channel < 163`.
pub fn audio_channel_name(channel: usize) -> String {
    let mut row = channel;
    for (name, rows) in FEATURES {
        if row < rows {
            return if rows == 1 {
                name.to_owned()
            } else {
                format!("{name}[{row}]")
            };
        }
        row -= rows;
    }
    panic!("audio channel {channel} of {AUDIO_CHANNELS}")
}

/// Audio features of a stretch of music at 30 frames per second: `[163, frames]`, channel-major.
#[derive(Clone, Debug, PartialEq)]
pub struct AudioFeatures {
    frames: usize,
    values: Vec<f32>,
}

impl From<&Features> for AudioFeatures {
    /// A whole song's features, as a dataset stores them.
    fn from(features: &Features) -> Self {
        Self {
            frames: features.frames(),
            values: features.stacked().to_vec(),
        }
    }
}

impl AudioFeatures {
    /// Features from `[163, frames]` values, channel-major; `None` for another number of values.
    pub fn new(frames: usize, values: Vec<f32>) -> Option<Self> {
        (values.len() == AUDIO_CHANNELS * frames).then_some(Self { frames, values })
    }

    /// Silence, and the null condition of classifier-free guidance: `[163, frames]` zeros.
    pub fn zeros(frames: usize) -> Self {
        Self {
            frames,
            values: vec![0.0; AUDIO_CHANNELS * frames],
        }
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// All values, `[163, frames]`, channel-major.
    pub fn as_slice(&self) -> &[f32] {
        &self.values
    }

    /// One channel over time, `[frames]`.
    ///
    /// # Panics
    /// Panics unless `channel < 163`.
    pub fn channel(&self, channel: usize) -> &[f32] {
        &self.values[channel * self.frames..][..self.frames]
    }

    /// How strongly notes begin, over time, `[frames]`.
    pub fn onset_strength(&self) -> &[f32] {
        self.channel(ONSET_STRENGTH)
    }

    /// One channel over time, `[frames]`, for writing.
    pub(crate) fn channel_mut(&mut self, channel: usize) -> &mut [f32] {
        &mut self.values[channel * self.frames..][..self.frames]
    }

    /// The frames of `range`, `[163, range.len()]`.
    ///
    /// # Panics
    /// Panics if `range` reaches beyond the last frame.
    pub fn slice(&self, range: Range<usize>) -> Self {
        let mut values = Vec::with_capacity(AUDIO_CHANNELS * range.len());
        for channel in 0..AUDIO_CHANNELS {
            values.extend_from_slice(&self.channel(channel)[range.clone()]);
        }
        Self {
            frames: range.len(),
            values,
        }
    }

    /// Frame and channel of the first value, in time, that is NaN, infinite or too large.
    pub(crate) fn first_unusable(&self) -> Option<(usize, usize)> {
        first_unusable(&self.values)?;
        let values = self.values.iter().enumerate();
        let bad = values.filter(|&(_, &value)| !is_usable(value));
        bad.map(|(place, _)| (place % self.frames, place / self.frames))
            .min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_named_in_the_stacking_order() {
        assert_eq!(
            FEATURES.iter().map(|(_, rows)| rows).sum::<usize>(),
            AUDIO_CHANNELS
        );
        for (channel, name) in [
            (0, "mel[0]"),
            (127, "mel[127]"),
            (128, "chroma[0]"),
            (140, "mfcc[0]"),
            (159, "mfcc[19]"),
            (160, "rms"),
            (161, "spectral_centroid"),
            (162, "onset_strength"),
        ] {
            assert_eq!(audio_channel_name(channel), name);
        }
    }

    #[test]
    fn the_onset_strength_is_the_channel_of_that_name() {
        assert_eq!(audio_channel_name(ONSET_STRENGTH), "onset_strength");
    }

    #[test]
    fn a_slice_keeps_every_channel_in_its_place() {
        let values: Vec<f32> = (0..AUDIO_CHANNELS * 5).map(|i| i as f32).collect();
        let cut = AudioFeatures::new(5, values).unwrap().slice(2..4);
        assert_eq!(cut.frames(), 2);
        assert_eq!(cut.channel(0), [2.0, 3.0]);
        assert_eq!(cut.channel(162), [812.0, 813.0]);
        assert!(AudioFeatures::new(5, vec![0.0; 5]).is_none());
    }

    #[test]
    fn the_first_bad_value_in_time_is_found() {
        let mut features = AudioFeatures::zeros(6);
        assert_eq!(features.first_unusable(), None);
        features.channel_mut(3)[4] = f32::NAN;
        features.channel_mut(100)[2] = f32::INFINITY;
        assert_eq!(features.first_unusable(), Some((2, 100)));
    }
}
