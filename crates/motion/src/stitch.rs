//! One motion from overlapping windows.
//!
//! Windows are sampled at the length of the model's training samples. Floor positions are relative
//! to a window's first frame ([`crate::anchor_floor`]); other values are in world coordinates.
//! Windows are rotated ([`crate::heading_alignment`]) and moved on the floor to agree with
//! neighboring windows (least squares over the overlaps). They are blended with squared-sine
//! weights that add up to 1.
//!
//! Known frames do not change. Windows move to the known frames, and the remaining difference fades
//! out in 1/3 s.

#[cfg(test)]
mod tests;

use std::ops::Range;

use crate::banded::{BAND, Cholesky};
use crate::feet::runs;
use crate::phrase::{POSITION, QUATERNION};
use crate::{ChannelEncoding, OrientationEncoding, PhaseEncoding};

/// Channels that are relative to a window's first frame: the position on the floor.
const FLOOR: [usize; 2] = [POSITION.start, POSITION.start + 2];

/// Neighboring windows share at least one in `OVERLAP` of their frames.
const OVERLAP: usize = 3;

/// Weight of known frames relative to overlaps in the positions of windows.
const KNOWN: f64 = 100.0;

/// Frames over which the difference from a known frame fades.
const FADE: usize = 10;

/// Windows of one length that cover a motion. Each window overlaps the next by at least a third.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Windows {
    frames: usize,
    length: usize,
    starts: Vec<usize>,
}

/// The channels of windows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// The 25 channels of a phrase in physical units.
    Phrase,
    /// The normalized channels that a denoiser predicts. A scalar phase is in -1 to 1.
    Predicted(ChannelEncoding),
}

impl Layout {
    pub(crate) fn encoding(self) -> ChannelEncoding {
        match self {
            Self::Phrase => ChannelEncoding::default(),
            Self::Predicted(encoding) => encoding,
        }
    }

    /// Number of channels.
    pub fn channels(self) -> usize {
        self.encoding().channels()
    }

    /// Channels of quaternions, whose signs differ between windows.
    pub(crate) fn quaternions(self) -> Range<usize> {
        match self.encoding().orientation {
            OrientationEncoding::Rotation6d => 0..0,
            _ => QUATERNION,
        }
    }

    /// The channel of a phase that jumps at bar lines, and the values at start and end of a bar.
    fn jumping_phase(self) -> Option<(usize, [f64; 2])> {
        let (encoding, start) = (
            self.encoding(),
            if self == Self::Phrase { 0.0 } else { -1.0 },
        );
        let channel = encoding.phase_channels().start;
        (encoding.phase == PhaseEncoding::Scalar).then_some((channel, [start, 1.0]))
    }
}

/// Known frames of a motion.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownFrames {
    /// True for known frames, `[frames]`.
    pub is_known: Vec<bool>,
    /// `[channels, frames]`. Each run of known frames has one sign of quaternions.
    pub values: Vec<f32>,
}

impl Windows {
    /// Evenly spread windows of `length` frames over `frames` frames. A shorter motion is one
    /// window.
    ///
    /// # Panics
    /// Panics if `frames` or `length` is 0.
    pub fn new(frames: usize, length: usize) -> Self {
        assert!(frames > 0 && length > 0, "windows of at least one frame");
        let length = length.min(frames);
        let gaps = (frames - length).div_ceil(most_apart(length));
        let start = |window: usize| window * (frames - length) / gaps.max(1);
        Self {
            frames,
            length,
            starts: (0..=gaps).map(start).collect(),
        }
    }

    /// Frames of the motion.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Frames of each window.
    pub fn length(&self) -> usize {
        self.length
    }

    /// The first frame of each window.
    pub fn starts(&self) -> &[usize] {
        &self.starts
    }

    /// Number of windows, at least one.
    #[expect(clippy::len_without_is_empty, reason = "there is always a window")]
    pub fn len(&self) -> usize {
        self.starts.len()
    }

    /// The frames of a window.
    pub fn of(&self, window: usize) -> Range<usize> {
        self.starts[window]..self.starts[window] + self.length
    }

    /// Relative weight of frame `t` of the motion in a window.
    pub(crate) fn weight(&self, window: usize, t: usize) -> f64 {
        let phase = (t - self.starts[window]) as f64 + 0.5;
        let sine = (std::f64::consts::PI * phase / self.length as f64).sin();
        sine * sine
    }

    /// The windows that contain frame `t`.
    fn at(&self, t: usize) -> Range<usize> {
        let starts = &self.starts;
        let first = starts.partition_point(|start| start + self.length <= t);
        first..starts.partition_point(|start| *start <= t)
    }

    /// Blends windows `[windows, channels, length]` to one motion `[channels, frames]`. Replaces
    /// each window by its part of the motion, with the window's own position and signs.
    ///
    /// The motion contains the `known` values. Without known values, the first window keeps its
    /// position.
    pub fn stitch(
        &self,
        values: &mut [f32],
        known: Option<&KnownFrames>,
        layout: Layout,
    ) -> Vec<f32> {
        let channels = layout.channels();
        assert_eq!(values.len(), self.len() * channels * self.length, "windows");
        let places = self.places(values, known, channels);
        let mut motion = self.blended(values, &places, layout);
        if let Some(known) = known {
            assert_eq!(known.is_known.len(), self.frames, "known frames");
            assert_eq!(known.values.len(), channels * self.frames, "known values");
            put(&mut motion, known, layout);
        }
        self.take_apart(&motion, values, &places, known, layout);
        motion
    }

    /// Position of each window's first frame on the floor of the motion.
    fn places(
        &self,
        values: &[f32],
        known: Option<&KnownFrames>,
        channels: usize,
    ) -> Vec<[f64; 2]> {
        // The normal equations of `weight |o_next - o - d|^2`, and `|o - d|^2` of known frames.
        let mut normal = vec![[0.0; BAND]; self.len()];
        let mut sides = [vec![0.0; self.len()], vec![0.0; self.len()]];
        let at = |window: usize, channel: usize, t: usize| {
            let place = (window * channels + channel) * self.length + t - self.starts[window];
            f64::from(values[place])
        };
        for next in 1..self.len() {
            let window = next - 1;
            let mut total = 0.0;
            let mut apart = [0.0; 2];
            for t in self.starts[next]..self.of(window).end {
                let weight = self.weight(window, t) * self.weight(next, t);
                total += weight;
                for (apart, channel) in apart.iter_mut().zip(FLOOR) {
                    *apart += weight * (at(window, channel, t) - at(next, channel, t));
                }
            }
            normal[window][0] += total;
            normal[next][0] += total;
            normal[next][1] -= total;
            for (side, apart) in sides.iter_mut().zip(apart) {
                side[next] += apart;
                side[window] -= apart;
            }
        }
        let mut stands = false;
        for window in 0..self.len() {
            let Some(known) = known else { break };
            for t in self.of(window).filter(|&t| known.is_known[t]) {
                stands = true;
                let weight = KNOWN * self.weight(window, t);
                normal[window][0] += weight;
                for (side, channel) in sides.iter_mut().zip(FLOOR) {
                    let there = f64::from(known.values[channel * self.frames + t]);
                    side[window] += weight * (there - at(window, channel, t));
                }
            }
        }
        if !stands {
            normal[0][0] += 1.0;
        }
        let factor = Cholesky::new(normal);
        sides.iter_mut().for_each(|side| factor.solve(side));
        let [x, z] = sides;
        x.into_iter().zip(z).map(|(x, z)| [x, z]).collect()
    }

    fn blended(&self, values: &[f32], places: &[[f64; 2]], layout: Layout) -> Vec<f32> {
        let (channels, quaternions) = (layout.channels(), layout.quaternions());
        let mut motion = vec![0.0; channels * self.frames];
        for t in 0..self.frames {
            let windows = self.at(t);
            let weights: Vec<f64> = windows.clone().map(|w| self.weight(w, t)).collect();
            let all: f64 = weights.iter().sum();
            let frame = |window: usize| {
                let first = window * channels * self.length + t - self.starts[window];
                move |channel: usize| f64::from(values[first + channel * self.length])
            };
            let heaviest = weights.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
            let reference = frame(windows.start + heaviest.map_or(0, |(place, _)| place));
            let mut sum = vec![0.0; channels];
            let phase = layout.jumping_phase();
            for (window, weight) in windows.zip(&weights) {
                let value = frame(window);
                let dot: f64 = quaternions.clone().map(|c| value(c) * reference(c)).sum();
                for (channel, sum) in sum.iter_mut().enumerate() {
                    let floor = FLOOR.iter().position(|floor| *floor == channel);
                    let value = match (floor, phase) {
                        (Some(axis), _) => value(channel) + places[window][axis],
                        _ if quaternions.contains(&channel) && dot < 0.0 => -value(channel),
                        (None, Some((phase, [start, end]))) if channel == phase => {
                            let bar = end - start;
                            let bars = (reference(channel) - value(channel)) / bar;
                            value(channel) + bar * bars.round()
                        }
                        _ => value(channel),
                    };
                    *sum += weight / all * value;
                }
            }
            if let Some((phase, [start, end])) = phase
                && !(start..=end).contains(&sum[phase])
            {
                sum[phase] = start + (sum[phase] - start).rem_euclid(end - start);
            }
            for (channel, sum) in sum.into_iter().enumerate() {
                motion[channel * self.frames + t] = sum as f32;
            }
        }
        motion
    }

    fn take_apart(
        &self,
        motion: &[f32],
        values: &mut [f32],
        places: &[[f64; 2]],
        known: Option<&KnownFrames>,
        layout: Layout,
    ) {
        let (channels, quaternions) = (layout.channels(), layout.quaternions());
        for (window, values) in values.chunks_mut(channels * self.length).enumerate() {
            let start = self.starts[window];
            let signs = self.signs(motion, values, start, known, &quaternions);
            for channel in 0..channels {
                let floor = FLOOR.iter().position(|floor| *floor == channel);
                let moved = floor.map_or(0.0, |axis| places[window][axis]);
                let from = &motion[channel * self.frames + start..][..self.length];
                let into = &mut values[channel * self.length..][..self.length];
                for ((into, from), sign) in into.iter_mut().zip(from).zip(&signs) {
                    *into = match quaternions.contains(&channel) {
                        true => from * sign,
                        false => (f64::from(*from) - moved) as f32,
                    };
                }
            }
        }
    }

    /// Signs between the quaternions of the motion and of a window. All known frames have the same
    /// sign.
    fn signs(
        &self,
        motion: &[f32],
        values: &[f32],
        start: usize,
        known: Option<&KnownFrames>,
        quaternions: &Range<usize>,
    ) -> Vec<f32> {
        let dot = |t: usize| -> f32 {
            let product =
                |c: usize| motion[c * self.frames + start + t] * values[c * self.length + t];
            quaternions.clone().map(product).sum()
        };
        let dots: Vec<f32> = (0..self.length).map(dot).collect();
        let is_known = |t: usize| known.is_some_and(|known| known.is_known[start + t]);
        let known_frames = (0..self.length).filter(|&t| is_known(t));
        let of_known: f32 = known_frames.map(|t| dots[t]).sum();
        let dot = |t: usize| if is_known(t) { of_known } else { dots[t] };
        let sign = |t: usize| if dot(t) < 0.0 { -1.0 } else { 1.0 };
        (0..self.length).map(sign).collect()
    }
}

/// Largest distance between the starts of neighboring windows, frames.
fn most_apart(length: usize) -> usize {
    (length - length.div_ceil(OVERLAP)).max(1)
}

/// Writes known frames into a motion `[channels, frames]` and fades out the difference.
fn put(motion: &mut [f32], known: &KnownFrames, layout: Layout) {
    let (channels, quaternions) = (layout.channels(), layout.quaternions());
    let frames = known.is_known.len();
    let edges = runs(&known.is_known).into_iter();
    for (edge, forwards) in edges.flat_map(|run| [(run.start, false), (run.end - 1, true)]) {
        let reached = (1..=FADE)
            .map_while(|d| match forwards {
                true => Some(edge + d).filter(|t| *t < frames),
                false => edge.checked_sub(d),
            })
            .take_while(|&t| !known.is_known[t]);
        let reached: Vec<usize> = reached.collect();
        let at = |values: &[f32], channel: usize, t: usize| values[channel * frames + t];
        // Quaternions of the opposite sign are negated first.
        for t in reached.iter().copied().chain([edge]) {
            let products = quaternions
                .clone()
                .map(|c| at(motion, c, t) * at(&known.values, c, edge));
            if products.sum::<f32>() < 0.0 {
                for channel in quaternions.clone() {
                    motion[channel * frames + t] *= -1.0;
                }
            }
        }
        let jumping = layout.jumping_phase().map(|(channel, _)| channel);
        for channel in (0..channels).filter(|channel| Some(*channel) != jumping) {
            let rest = at(&known.values, channel, edge) - at(motion, channel, edge);
            for (d, &t) in reached.iter().enumerate() {
                let share = (d + 1) as f32 / (FADE + 1) as f32;
                let fade = 0.5 + 0.5 * (std::f32::consts::PI * share).cos();
                motion[channel * frames + t] += fade * rest;
            }
        }
    }
    for t in (0..frames).filter(|&t| known.is_known[t]) {
        for channel in 0..channels {
            motion[channel * frames + t] = known.values[channel * frames + t];
        }
    }
}
