//! What a synthesis must keep to: fixed channels and key frames, at every level.

use crate::Frames;

/// What a synthesis must keep to.
#[derive(Clone, Debug, PartialEq)]
pub enum Held {
    /// Channels that follow a given motion.
    Channels {
        /// The channels.
        channels: Vec<usize>,
        /// The motion they are taken from, `[frames, channels]` with all channels; the new motion
        /// is as long.
        motion: Frames,
    },
    /// A frame whose channels have given values.
    Keyframe {
        /// When, as a part of the motion's length: frame t of n is (t + 0.5) / n.
        at: f64,
        /// The channels.
        channels: Vec<usize>,
        /// Their values, as many.
        values: Vec<f32>,
        /// Frames before and after it that bend towards it.
        reach: usize,
    },
}

impl Held {
    /// Makes the motion of a level, `[frames, channels]`, keep to it.
    ///
    /// Channels are set. A key frame is met exactly, and what it moves the frame by is added to its
    /// neighbours with a weight that falls off to 0 with no corner within its reach.
    ///
    /// # Panics
    /// Panics if the channels are not there.
    pub fn hold(&self, frames: &mut Frames) {
        match self {
            Self::Channels { channels, motion } => {
                let motion = motion.columns(channels).resampled(frames.frames());
                for t in 0..frames.frames() {
                    let row = frames.frame_mut(t);
                    for (&channel, &value) in channels.iter().zip(motion.frame(t)) {
                        row[channel] = value;
                    }
                }
            }
            Self::Keyframe {
                at,
                channels,
                values,
                reach,
            } => {
                let last = frames.frames() - 1;
                let t = (at * frames.frames() as f64 - 0.5).round().max(0.0) as usize;
                let t = t.min(last);
                let present = frames.frame(t);
                let pairs = channels.iter().zip(values);
                let moved: Vec<f32> = pairs.map(|(&c, value)| value - present[c]).collect();
                for near in t.saturating_sub(*reach)..=(t + reach).min(last) {
                    let weight = falloff(near.abs_diff(t), *reach);
                    let row = frames.frame_mut(near);
                    for (&channel, by) in channels.iter().zip(&moved) {
                        row[channel] += weight * by;
                    }
                }
                let row = frames.frame_mut(t);
                for (&channel, &value) in channels.iter().zip(values) {
                    row[channel] = value;
                }
            }
        }
    }
}

/// 1 at a key frame and 0 beyond its reach, flat at both.
fn falloff(distance: usize, reach: usize) -> f32 {
    let part = distance as f32 / (reach + 1) as f32;
    1.0 - part * part * part * (10.0 - part * (15.0 - 6.0 * part))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_frame_is_met_and_its_neighbours_bend() {
        let mut frames = Frames::zeros(21, 2);
        let key = Held::Keyframe {
            at: 10.5 / 21.0,
            channels: vec![1],
            values: vec![2.0],
            reach: 4,
        };
        key.hold(&mut frames);
        let second: Vec<f32> = (0..21).map(|t| frames.frame(t)[1]).collect();
        assert_eq!(second[10], 2.0);
        assert!(second[6..=10].is_sorted() && second[9] > 1.5 && second[7] > 0.0);
        assert_eq!((second[5], second[15]), (0.0, 0.0));
        assert!((0..21).all(|t| frames.frame(t)[0] == 0.0));
    }

    #[test]
    fn held_channels_are_those_of_the_motion() {
        let motion = Frames::new(2, (0..20).map(|value| value as f32).collect());
        let mut frames = Frames::zeros(10, 2);
        let held = Held::Channels {
            channels: vec![0],
            motion: motion.clone(),
        };
        held.hold(&mut frames);
        for t in 0..10 {
            assert_eq!(frames.frame(t), [motion.frame(t)[0], 0.0]);
        }
        let mut coarse = Frames::zeros(5, 2);
        held.hold(&mut coarse);
        assert_eq!(coarse.frame(1)[0], 5.0);
    }
}
