//! Alignment of the headings of overlapping windows.
//!
//! A model that was trained on randomly rotated phrases samples windows of any heading. The mean of
//! opposite headings is undefined, so a blended dancer spins in the overlap. Windows are therefore
//! rotated about the vertical before [`crate::stitch`] moves and blends them.

use crate::humanml::bone_rotations::to_columns;
use crate::phrase::{ACCELERATION, POSITION, QUATERNION, VELOCITY};
use crate::stitch::{KnownFrames, Layout, Windows};
use crate::{Quaternion, Statistics};

/// The channels of windows and their units.
#[derive(Clone, Copy, Debug)]
pub struct HeadingAlignment<'a> {
    /// The channels.
    pub layout: Layout,
    /// Statistics that normalize the channels; none for physical units.
    pub statistics: Option<&'a Statistics>,
}

impl HeadingAlignment<'_> {
    /// Rotation angles about the vertical, radians, that align windows `[windows, channels,
    /// length]` with `known` frames or with neighboring windows. Without known frames, the first
    /// window keeps its heading.
    pub fn angles(
        &self,
        windows: &Windows,
        values: &[f32],
        known: Option<&KnownFrames>,
    ) -> Vec<f64> {
        let (channels, length) = (self.layout.channels(), windows.length());
        assert_eq!(values.len(), windows.len() * channels * length, "windows");
        let facing = |window: usize, t: usize| {
            let first = window * channels * length + t - windows.starts()[window];
            self.facing(|channel| values[first + channel * length])
        };
        let by_known = |window: usize| {
            let known = known?;
            let frames = windows.of(window).filter(|&t| known.is_known[t]);
            let pairs = frames.map(|t| {
                let there = |channel: usize| known.values[channel * windows.frames() + t];
                (self.facing(there), facing(window, t), 1.0)
            });
            angle(pairs)
        };
        let apart = |window: usize| {
            let shared = windows.starts()[window + 1]..windows.of(window).end;
            let pairs = shared.map(|t| {
                let weight = windows.weight(window, t) * windows.weight(window + 1, t);
                (facing(window, t), facing(window + 1, t), weight)
            });
            angle(pairs).unwrap_or(0.0)
        };
        let mut angles: Vec<Option<f64>> = (0..windows.len()).map(by_known).collect();
        let first = angles.iter().position(Option::is_some).unwrap_or(0);
        let mut angle = angles[first].unwrap_or(0.0);
        for window in (0..first).rev() {
            let next = angles[window + 1].unwrap_or(angle);
            angles[window] = Some(next - apart(window));
        }
        for (window, here) in angles.iter_mut().enumerate().skip(first) {
            if window > first {
                angle += apart(window - 1);
            }
            angle = here.unwrap_or(angle);
            *here = Some(angle);
        }
        angles.into_iter().map(Option::unwrap_or_default).collect()
    }

    /// Rotates each window by its angle.
    pub fn turn(&self, windows: &Windows, values: &mut [f32], angles: &[f64]) {
        let length = windows.length();
        let windows = values.chunks_mut(self.layout.channels() * length);
        for (values, angle) in windows.zip(angles).filter(|(_, angle)| **angle != 0.0) {
            for t in 0..length {
                self.turn_frame(values, length, t, *angle);
            }
        }
    }

    fn turn_frame(&self, values: &mut [f32], length: usize, t: usize, angle: f64) {
        let (sin, cos) = angle.sin_cos();
        for [x, z] in self.horizontal() {
            let [at_x, at_z] = [x, z].map(|c| self.physical(c, values[c * length + t]));
            let turned = [at_x * cos + at_z * sin, at_z * cos - at_x * sin];
            for (channel, value) in [x, z].into_iter().zip(turned) {
                values[channel * length + t] = self.own(channel, value);
            }
        }
        if self.is_quaternion() {
            let turned = Quaternion::from_yaw(angle)
                * self.quaternion(|channel| values[channel * length + t]);
            for (channel, value) in QUATERNION.zip(turned.parts()) {
                values[channel * length + t] = self.own(channel, value);
            }
        }
    }

    fn is_quaternion(&self) -> bool {
        !self.layout.quaternions().is_empty()
    }

    fn quaternion(&self, value: impl Fn(usize) -> f32) -> Quaternion {
        let channels = [0, 1, 2, 3].map(|part| QUATERNION.start + part);
        Quaternion::from(channels.map(|channel| self.physical(channel, value(channel))))
    }

    /// Channels of the horizontal components of vectors, x and z.
    fn horizontal(&self) -> Vec<[usize; 2]> {
        let rotation = self.layout.encoding().angular_velocity_channels();
        let vectors = [POSITION, VELOCITY, ACCELERATION, rotation];
        let mut starts = vectors.map(|vector| vector.start).to_vec();
        if !self.is_quaternion() {
            starts.extend([QUATERNION.start, QUATERNION.start + 3]);
        }
        starts.into_iter().map(|start| [start, start + 2]).collect()
    }

    /// Horizontal components (z, x) of the body's local x and y axes.
    fn facing(&self, value: impl Fn(usize) -> f32) -> [[f64; 2]; 2] {
        let at = |channel: usize| self.physical(channel, value(channel));
        let [x_of_x, _, z_of_x, x_of_y, _, z_of_y] = match self.is_quaternion() {
            true => to_columns(self.quaternion(value)),
            false => std::array::from_fn(|i| at(QUATERNION.start + i)),
        };
        [[z_of_x, x_of_x], [z_of_y, x_of_y]]
    }

    fn physical(&self, channel: usize, value: f32) -> f64 {
        let value = f64::from(value);
        match self.statistics {
            Some(Statistics { mean, std, .. }) => value * std[channel] + mean[channel],
            None => value,
        }
    }

    fn own(&self, channel: usize, value: f64) -> f32 {
        let own = match self.statistics {
            Some(Statistics { mean, std, .. }) => (value - mean[channel]) / std[channel],
            None => value,
        };
        own as f32
    }
}

type Facing = [[f64; 2]; 2];

/// The least-squares rotation angle from the second to the first of each pair; `None` without
/// pairs.
fn angle(pairs: impl Iterator<Item = (Facing, Facing, f64)>) -> Option<f64> {
    let mut sums = None;
    for (here, there, weight) in pairs {
        let (sin, cos) = sums.get_or_insert((0.0, 0.0));
        for ([z, x], [other_z, other_x]) in here.into_iter().zip(there) {
            *sin += weight * (x * other_z - z * other_x);
            *cos += weight * (z * other_z + x * other_x);
        }
    }
    sums.map(|(sin, cos): (f64, f64)| sin.atan2(cos))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random_phrase::random_phrase;
    use crate::{
        ChannelEncoding, OrientationEncoding, PhaseEncoding, Phrase, anchor_floor, rotate_yaw,
    };

    /// The windows of a motion, each anchored at its start and turned by an angle.
    fn cut(windows: &Windows, motion: &Phrase, angles: &[f64]) -> Vec<Phrase> {
        let parts = angles.iter().enumerate().map(|(window, angle)| {
            let mut part = motion.slice(windows.of(window));
            anchor_floor(&mut part);
            rotate_yaw(&mut part, *angle);
            part
        });
        parts.collect()
    }

    fn rows(parts: &[Phrase]) -> Vec<f32> {
        parts.iter().flat_map(Phrase::channel_major).collect()
    }

    fn turned(angle: f64) -> f64 {
        let turns = angle / std::f64::consts::TAU;
        (turns - turns.round()).abs()
    }

    #[test]
    fn windows_that_were_turned_are_turned_back() {
        let (motion, windows) = (random_phrase(3, 61), Windows::new(61, 24));
        let by: Vec<f64> = (0..windows.len()).map(|w| 2.3 * w as f64).collect();
        let parts = cut(&windows, &motion, &by);
        let turning = HeadingAlignment {
            layout: Layout::Phrase,
            statistics: None,
        };
        let mut values = rows(&parts);
        let angles = turning.angles(&windows, &values, None);
        for (angle, by) in angles.iter().zip(&by) {
            assert!(turned(angle + by) < 1e-3, "{angle} {by}");
        }
        turning.turn(&windows, &mut values, &angles);
        let straight = rows(&cut(&windows, &motion, &vec![0.0; by.len()]));
        for (a, b) in values.iter().zip(&straight) {
            assert!((a - b).abs() < 0.02, "{a} {b}");
        }
        // Known frames determine the heading, from their window in both directions.
        let known = KnownFrames {
            is_known: (0..61).map(|t| (25..30).contains(&t)).collect(),
            values: motion.channel_major(),
        };
        let values = rows(&parts);
        let angles = turning.angles(&windows, &values, Some(&known));
        for (angle, by) in angles.iter().zip(&by) {
            assert!(turned(angle + by) < 1e-3, "{angle} {by}");
        }
    }

    #[test]
    fn normalised_encodings_rotate_as_phrases_do() {
        let windows = Windows::new(20, 20);
        let motion = random_phrase(4, 20);
        for orientation in [
            OrientationEncoding::Rotation6d,
            OrientationEncoding::Quaternion,
        ] {
            let encoding = ChannelEncoding {
                phase: PhaseEncoding::Harmonics,
                orientation,
            };
            let channels = encoding.channels();
            let mean = (0..channels).map(|c| 0.1 * c as f64 - 0.7);
            let std = (0..channels).map(|c| 0.5 + 0.03 * c as f64);
            let statistics = Statistics::new(mean.collect(), std.collect(), None).unwrap();
            let own = |motion: &Phrase| statistics.normalize(&encoding.encode(motion.as_slice()));
            let turning = HeadingAlignment {
                layout: Layout::Predicted(encoding),
                statistics: Some(&statistics),
            };
            let mut values = own(&motion);
            turning.turn(&windows, &mut values, &[0.8]);
            let mut expected = motion.clone();
            rotate_yaw(&mut expected, 0.8);
            for (place, (a, b)) in values.iter().zip(own(&expected)).enumerate() {
                assert!((a - b).abs() < 1e-4, "{orientation:?} {place}: {a} {b}");
            }
        }
    }
}
