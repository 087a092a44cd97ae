//! Constraints of a synthesis, applied at every level: fixed channels and key frames.

use crate::Frames;

mod keyframes;

/// A constraint of a synthesis.
#[derive(Clone, Debug, PartialEq)]
pub enum Constraint {
    /// Channels that follow another motion.
    Channels {
        /// The channels.
        channels: Vec<usize>,
        /// The motion, `[frames, channels]` with all channels, as long as the new motion.
        motion: Frames,
    },
    /// A frame with fixed values.
    Keyframe {
        /// Time as a part of the motion: frame t of n is (t + 0.5) / n.
        at: f64,
        /// The channels.
        channels: Vec<usize>,
        /// The source motion, `[frames, channels]` of these channels alone.
        source: Frames,
        /// The frame of the source.
        from: usize,
        /// Frames of the new motion.
        frames: usize,
        /// Frames before and after the key frame that are blended towards the source.
        reach: usize,
    },
}

impl Constraint {
    /// The frame at time `at` in a motion of `frames` frames.
    pub(crate) fn frame(at: f64, frames: usize) -> usize {
        let t = (at * frames as f64 - 0.5).round().max(0.0) as usize;
        t.min(frames - 1)
    }

    /// Applies `constraints` to the motion of a level, `[frames, channels]`.
    ///
    /// Key frames are exact, or averaged if they fall into one frame of a coarse level. Frames
    /// around a key frame blend into the source, whose patches then match at every level. The
    /// weight falls to 0 within the reach or before the next key frame of the channel. Fixed
    /// channels are set last. `is_loop`: the last frame is followed by the first. Returns true for
    /// each blended frame; without key frames, the list is empty.
    ///
    /// # Panics
    /// If a channel does not exist.
    pub fn apply_all(constraints: &[Self], frames: &mut Frames, is_loop: bool) -> Vec<bool> {
        let bent = keyframes::apply(constraints, frames, is_loop);
        for constraint in constraints {
            if let Self::Channels { channels, motion } = constraint {
                let motion = motion.columns(channels).resampled(frames.frames());
                for t in 0..frames.frames() {
                    let row = frames.frame_mut(t);
                    for (&channel, &value) in channels.iter().zip(motion.frame(t)) {
                        row[channel] = value;
                    }
                }
            }
        }
        bent
    }
}

#[cfg(test)]
mod tests {
    use super::keyframes::falloff;
    use super::*;

    #[test]
    fn a_key_frame_is_exact_and_its_neighbours_bend() {
        let mut frames = Frames::zeros(21, 2);
        let key = Constraint::Keyframe {
            at: 10.5 / 21.0,
            channels: vec![1],
            source: Frames::new(1, vec![5.0, 3.0, 2.0, 3.0, 5.0, 7.0]),
            from: 2,
            frames: 21,
            reach: 4,
        };
        Constraint::apply_all(std::slice::from_ref(&key), &mut frames, false);
        let second: Vec<f32> = (0..21).map(|t| frames.frame(t)[1]).collect();
        assert_eq!(second[10], 2.0);
        // The neighbours blend into the source, which is constant beyond its ends.
        assert_eq!(second[9], 3.0 * falloff(1, 4));
        assert_eq!(second[7], 5.0 * falloff(3, 4));
        assert_eq!(second[12], 5.0 * falloff(2, 4));
        assert_eq!((second[3], second[17]), (0.0, 0.0));
        assert!((0..21).all(|t| frames.frame(t)[0] == 0.0));
        // At a level of a third of the frames the source is three times as fast and the blend a
        // third as long.
        let mut coarse = Frames::zeros(7, 2);
        Constraint::apply_all(&[key], &mut coarse, false);
        let second: Vec<f32> = (0..7).map(|t| coarse.frame(t)[1]).collect();
        assert_eq!((second[3], second[4]), (2.0, 7.0 * falloff(1, 2)));
    }

    #[test]
    fn constrained_channels_are_those_of_the_motion() {
        let motion = Frames::new(2, (0..20).map(|value| value as f32).collect());
        let mut frames = Frames::zeros(10, 2);
        let constraint = Constraint::Channels {
            channels: vec![0],
            motion: motion.clone(),
        };
        Constraint::apply_all(std::slice::from_ref(&constraint), &mut frames, false);
        for t in 0..10 {
            assert_eq!(frames.frame(t), [motion.frame(t)[0], 0.0]);
        }
        let mut coarse = Frames::zeros(5, 2);
        Constraint::apply_all(&[constraint], &mut coarse, false);
        assert_eq!(coarse.frame(1)[0], 5.0);
    }

    /// A key frame of channel 0 (and 1, if `both`) with a constant value.
    fn still(frame: usize, of: usize, both: bool, value: f32, reach: usize) -> Constraint {
        let channels = if both { vec![0, 1] } else { vec![0] };
        Constraint::Keyframe {
            at: (frame as f64 + 0.5) / of as f64,
            source: Frames::new(channels.len(), vec![value; channels.len()]),
            channels,
            from: 0,
            frames: of,
            reach,
        }
    }

    #[test]
    fn close_key_frames_are_all_exact() {
        for reach in [0, 3, 12, 60] {
            let keys = [
                still(20, 60, false, 1.0, reach),
                still(26, 60, true, 5.0, reach),
                still(21, 60, false, -2.0, reach),
                still(40, 60, true, 3.0, reach),
            ];
            let mut frames = Frames::zeros(60, 2);
            Constraint::apply_all(&keys, &mut frames, false);
            let found = [20, 21, 26, 40].map(|t| frames.frame(t)[0]);
            assert_eq!(found, [1.0, -2.0, 5.0, 3.0], "{reach}");
            assert_eq!([26, 40].map(|t| frames.frame(t)[1]), [5.0, 3.0]);
            // Frames between two key frames that reach each other blend only these two.
            if reach > 20 {
                assert!((30..36).all(|t| (3.0..=5.0).contains(&frames.frame(t)[1])));
            }
        }
        // One frame of a coarse level has the mean of two key frames.
        let keys = [still(20, 60, false, 1.0, 5), still(21, 60, false, 3.0, 5)];
        let mut coarse = Frames::zeros(6, 2);
        Constraint::apply_all(&keys, &mut coarse, false);
        assert_eq!(coarse.frame(2)[0], 2.0);
    }

    #[test]
    fn a_key_frame_of_a_loop_bends_frames_on_both_sides_of_the_seam() {
        let mut frames = Frames::zeros(40, 2);
        let key = still(1, 40, false, 2.0, 6);
        Constraint::apply_all(std::slice::from_ref(&key), &mut frames, true);
        for away in 1..6 {
            let [behind, before] = [1 + away, (41 - away) % 40].map(|t| frames.frame(t)[0]);
            assert!(behind > 0.0 && behind == before, "{away}");
        }
        let mut open = Frames::zeros(40, 2);
        Constraint::apply_all(&[key], &mut open, false);
        assert_eq!(open.frame(39)[0], 0.0);
    }
}
