//! The phrase: a row-major array `[frames, 25]` of single-precision values.
//!
//! Source: CC-MotionGen, section 2.1 (docs/sources.md, section 1.1).

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::{Error, Quaternion};

/// Channels of one frame.
pub const CHANNELS: usize = 25;

/// Frames per second of every phrase.
pub const FPS: f64 = 30.0;

/// Position x, y, z in metres, +y up.
pub const POSITION: Range<usize> = 0..3;

/// Velocity in metres per second.
pub const VELOCITY: Range<usize> = 3..6;

/// Acceleration in metres per second squared.
pub const ACCELERATION: Range<usize> = 6..9;

/// Orientation as a unit quaternion (w, x, y, z) that takes body to world coordinates.
pub const QUATERNION: Range<usize> = 9..13;

/// Angular velocity in radians per second, world frame.
pub const ANGULAR_VELOCITY: Range<usize> = 13..16;

/// Position in the musical bar, from 0 to 1.
pub const PHASE: usize = 16;

/// Style descriptors, unbounded.
pub const STYLE: Range<usize> = 17..25;

/// The name of a channel: `position.x`, `phase`, `style.0`; `channel.{n}` after the last channel.
pub fn channel_name(channel: usize) -> String {
    let (group, range, parts) = match channel {
        c if POSITION.contains(&c) => ("position", POSITION, "xyz"),
        c if VELOCITY.contains(&c) => ("velocity", VELOCITY, "xyz"),
        c if ACCELERATION.contains(&c) => ("acceleration", ACCELERATION, "xyz"),
        c if QUATERNION.contains(&c) => ("quaternion", QUATERNION, "wxyz"),
        c if ANGULAR_VELOCITY.contains(&c) => ("angular_velocity", ANGULAR_VELOCITY, "xyz"),
        c if STYLE.contains(&c) => ("style", STYLE, "01234567"),
        PHASE => return "phase".to_owned(),
        c => return format!("channel.{c}"),
    };
    format!("{group}.{}", &parts[channel - range.start..][..1])
}

/// A phrase, `[frames, 25]`, at least one frame. Values may be NaN or infinite.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Phrase {
    data: Vec<f32>,
}

impl Phrase {
    /// A phrase from row-major `[frames, 25]` values.
    ///
    /// # Errors
    /// [`Error::NotWholeFrames`] if the length is zero or not a multiple of 25.
    pub fn new(data: Vec<f32>) -> Result<Self, Error> {
        if data.is_empty() || !data.len().is_multiple_of(CHANNELS) {
            return Err(Error::NotWholeFrames {
                values: data.len(),
                channels: CHANNELS,
            });
        }
        Ok(Self { data })
    }

    /// A phrase from channel-major `[25, frames]` values, the layout of the networks.
    ///
    /// # Errors
    /// [`Error::LengthMismatch`]; [`Error::NotWholeFrames`] for no frames.
    pub fn from_channel_major(values: &[f32], frames: usize) -> Result<Self, Error> {
        if values.len() != CHANNELS * frames {
            return Err(Error::LengthMismatch {
                what: "channel-major values",
                expected: CHANNELS * frames,
                found: values.len(),
            });
        }
        let row_major = (0..frames).flat_map(|t| (0..CHANNELS).map(move |c| (t, c)));
        Self::new(row_major.map(|(t, c)| values[c * frames + t]).collect())
    }

    /// The values as channel-major `[25, frames]`.
    pub fn channel_major(&self) -> Vec<f32> {
        let column = |channel| self.data.iter().skip(channel).step_by(CHANNELS);
        (0..CHANNELS).flat_map(column).copied().collect()
    }

    /// Number of frames, at least 1.
    pub fn frames(&self) -> usize {
        self.data.len() / CHANNELS
    }

    /// The 25 channels of frame `t`.
    pub fn frame(&self, t: usize) -> &[f32] {
        &self.data[t * CHANNELS..(t + 1) * CHANNELS]
    }

    /// The mutable 25 channels of frame `t`.
    pub fn frame_mut(&mut self, t: usize) -> &mut [f32] {
        &mut self.data[t * CHANNELS..(t + 1) * CHANNELS]
    }

    /// All values, row-major `[frames, 25]`.
    pub fn as_slice(&self) -> &[f32] {
        &self.data
    }

    /// All values, row-major `[frames, 25]`, without a copy.
    pub fn into_vec(self) -> Vec<f32> {
        self.data
    }

    /// The first three channels of `channels` in frame `t`: `vector(t, VELOCITY)`.
    pub fn vector(&self, t: usize, channels: Range<usize>) -> [f64; 3] {
        let values = &self.frame(t)[channels];
        [0, 1, 2].map(|axis| f64::from(values[axis]))
    }

    /// Writes `vector` into the first three channels of `channels` in frame `t`.
    pub fn set_vector(&mut self, t: usize, channels: Range<usize>, vector: [f64; 3]) {
        let vector = vector.map(|component| component as f32);
        self.frame_mut(t)[channels][..3].copy_from_slice(&vector);
    }

    /// The orientation in frame `t`, as stored (not normalized).
    pub fn quaternion(&self, t: usize) -> Quaternion {
        let values = &self.frame(t)[QUATERNION];
        Quaternion::from([0, 1, 2, 3].map(|part| f64::from(values[part])))
    }

    /// Writes the orientation of frame `t`.
    pub fn set_quaternion(&mut self, t: usize, orientation: Quaternion) {
        let parts = orientation.parts().map(|part| part as f32);
        self.frame_mut(t)[QUATERNION].copy_from_slice(&parts);
    }

    /// The values of one channel, `[frames]`.
    pub fn column(&self, channel: usize) -> Vec<f64> {
        let values = self.data.iter().skip(channel).step_by(CHANNELS);
        values.map(|&value| f64::from(value)).collect()
    }

    /// [`vector`](Self::vector) of all frames.
    pub fn vectors(&self, channels: Range<usize>) -> Vec<[f64; 3]> {
        let frames = 0..self.frames();
        frames.map(|t| self.vector(t, channels.clone())).collect()
    }

    /// The orientations of all frames, as stored.
    pub fn quaternions(&self) -> Vec<Quaternion> {
        (0..self.frames()).map(|t| self.quaternion(t)).collect()
    }

    /// A copy of some frames.
    #[must_use]
    pub fn slice(&self, frames: Range<usize>) -> Self {
        assert!(!frames.is_empty(), "a phrase has at least one frame");
        Self {
            data: self.data[frames.start * CHANNELS..frames.end * CHANNELS].to_vec(),
        }
    }

    /// Frame and channel of the first NaN or infinity, row by row.
    pub fn first_non_finite(&self) -> Option<(usize, usize)> {
        let place = self.data.iter().position(|value| !value.is_finite())?;
        Some((place / CHANNELS, place % CHANNELS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counting(frames: usize) -> Phrase {
        Phrase::new((0..frames * CHANNELS).map(|v| v as f32).collect()).unwrap()
    }

    #[test]
    fn every_channel_has_a_name_of_its_own() {
        let names: std::collections::BTreeSet<String> = (0..CHANNELS).map(channel_name).collect();
        assert_eq!(names.len(), CHANNELS);
        let expected = [
            (0, "position.x"),
            (5, "velocity.z"),
            (7, "acceleration.y"),
            (9, "quaternion.w"),
            (12, "quaternion.z"),
            (13, "angular_velocity.x"),
            (16, "phase"),
            (17, "style.0"),
            (24, "style.7"),
            (25, "channel.25"),
        ];
        for (channel, name) in expected {
            assert_eq!(channel_name(channel), name);
        }
    }

    #[test]
    fn a_phrase_is_whole_frames() {
        for values in [0, 1, 24, 26, 49] {
            let error = Phrase::new(vec![0.0; values]).unwrap_err();
            assert_eq!(
                error,
                Error::NotWholeFrames {
                    values,
                    channels: CHANNELS
                }
            );
        }
        assert_eq!(Phrase::new(vec![0.0; 50]).unwrap().frames(), 2);
    }

    #[test]
    fn channel_major_is_the_transpose_and_comes_back() {
        let motion = counting(3);
        let transposed = motion.channel_major();
        assert_eq!(transposed[..4], [0.0, 25.0, 50.0, 1.0]);
        assert_eq!(Phrase::from_channel_major(&transposed, 3).unwrap(), motion);
        assert!(Phrase::from_channel_major(&transposed, 4).is_err());
        assert!(Phrase::from_channel_major(&[], 0).is_err());
    }

    #[test]
    fn readers_and_writers_name_the_same_channels() {
        let mut motion = counting(2);
        assert_eq!(motion.vector(1, VELOCITY), [28.0, 29.0, 30.0]);
        assert_eq!(
            motion.quaternion(0),
            Quaternion {
                w: 9.0,
                x: 10.0,
                y: 11.0,
                z: 12.0
            }
        );
        motion.set_vector(1, ACCELERATION, [-1.0, -2.0, -3.0]);
        motion.set_quaternion(
            1,
            Quaternion {
                w: -4.0,
                x: -5.0,
                y: -6.0,
                z: -7.0,
            },
        );
        assert_eq!(
            motion.frame(1)[6..13],
            [-1.0, -2.0, -3.0, -4.0, -5.0, -6.0, -7.0]
        );
        assert_eq!(motion.slice(1..2).as_slice(), motion.frame(1));
    }

    #[test]
    fn the_first_non_finite_value_is_named() {
        let mut motion = counting(3);
        assert_eq!(motion.first_non_finite(), None);
        motion.frame_mut(2)[0] = f32::NAN;
        motion.frame_mut(1)[24] = f32::NEG_INFINITY;
        assert_eq!(motion.first_non_finite(), Some((1, 24)));
    }
}
