//! What a synthesis must keep to: fixed channels and key frames, at every level.

use crate::Frames;

/// Frames of a level that bend towards a key frame at least: about half a patch, so that patches of
/// its source match there from the coarsest level on.
const LEAST_REACH: usize = 6;

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
        /// The motion that the values are from, `[frames, channels]` of these channels alone.
        source: Frames,
        /// The frame of it that is taken.
        from: usize,
        /// Frames of the new motion.
        frames: usize,
        /// Of those the ones before and after it that bend towards it.
        reach: usize,
    },
}

impl Held {
    /// The frame of `frames` that is at the part `at` of a motion's length.
    pub(crate) fn frame(at: f64, frames: usize) -> usize {
        let t = (at * frames as f64 - 0.5).round().max(0.0) as usize;
        t.min(frames - 1)
    }

    /// Makes the motion of a level, `[frames, channels]`, keep to it.
    ///
    /// Channels are set. A key frame is met exactly, and its neighbours go over to those that it has
    /// in its source, with a weight that falls off to 0 with no corner within its reach: so it is
    /// passed as the source passes it, and patches of the source match it at every level.
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
                source,
                from,
                frames: finest,
                reach,
            } => {
                let level = frames.frames();
                let t = Self::frame(*at, level);
                // Frames of the source between two of this level.
                let pace = (*finest as f64 / level as f64).max(1.0);
                let reach = ((*reach as f64 / pace).ceil() as usize).max(LEAST_REACH);
                for near in t.saturating_sub(reach)..=(t + reach).min(level - 1) {
                    let away = pace * (near as f64 - t as f64);
                    let pose = source.read(*from as f64 + away);
                    let weight = falloff(near.abs_diff(t), reach);
                    let row = frames.frame_mut(near);
                    for (&channel, value) in channels.iter().zip(pose) {
                        row[channel] = (1.0 - weight) * row[channel] + weight * value;
                    }
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
            source: Frames::new(1, vec![5.0, 3.0, 2.0, 3.0, 5.0, 7.0]),
            from: 2,
            frames: 21,
            reach: 4,
        };
        key.hold(&mut frames);
        let second: Vec<f32> = (0..21).map(|t| frames.frame(t)[1]).collect();
        assert_eq!(second[10], 2.0);
        // The neighbours are those of the source, weighted, and held at its ends.
        assert_eq!(second[9], 3.0 * falloff(1, 6));
        assert_eq!(second[7], 5.0 * falloff(3, 6));
        assert_eq!(second[12], 5.0 * falloff(2, 6));
        assert_eq!((second[3], second[17]), (0.0, 0.0));
        assert!((0..21).all(|t| frames.frame(t)[0] == 0.0));
        // At a level of a third of the frames the source goes three times as fast.
        let mut coarse = Frames::zeros(7, 2);
        key.hold(&mut coarse);
        let second: Vec<f32> = (0..7).map(|t| coarse.frame(t)[1]).collect();
        assert_eq!((second[3], second[4]), (2.0, 7.0 * falloff(1, 6)));
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
