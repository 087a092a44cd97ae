//! The channels in which a denoiser predicts a phrase, with continuous phase and orientation.
//!
//! The phases 0.99 and 0.01 are close in a bar but far apart as numbers. The quaternions q and -q
//! are one rotation but add up to zero. Networks that predict means fail on both.
//! [`ChannelEncoding`] replaces the two channels; files keep the 25 channels.
//!
//! ```text
//! network   position velocity acceleration orientation angular velocity    phase    style
//! channels      3        3          3        4 or 6            3        1, 2 or 8     8
//! ```

use std::borrow::Cow;
use std::f64::consts::TAU;
use std::ops::Range;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::augment::mirrored_channels;
use crate::humanml::bone_rotations::to_columns;
use crate::phrase::{ANGULAR_VELOCITY, CHANNELS, PHASE, QUATERNION, STYLE};
use crate::vector::{cross, dot};
use crate::{ChannelMoments, Phrase, Quaternion, Statistics, rotate_yaw};

/// Smallest squared length of a predicted rotation axis, and of the area of two, in normalizations.
pub const LEAST_SQUARE: f64 = 1e-8;

/// Encoding of the phase.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PhaseEncoding {
    /// A number from 0 to 1 (CC-MotionGen), with a jump at each bar line.
    #[default]
    Scalar,
    /// Sine and cosine of the phase angle.
    SinCos,
    /// Sine and cosine of the phase angle and of its multiples up to 4: the first Fourier
    /// coefficients of the distribution of the phase. If a network knows the beat but not the bar
    /// line, it predicts zero in the first pair, and the beat in pair n of a bar of n beats.
    Harmonics,
}

/// Smallest sum of squares of all harmonics that determines a phase.
pub const LEAST_HARMONICS: f64 = 1e-8;

impl PhaseEncoding {
    /// Number of predicted multiples of the phase angle, by sine and cosine.
    pub fn harmonics(self) -> usize {
        match self {
            Self::Scalar => 0,
            Self::SinCos => 1,
            Self::Harmonics => 4,
        }
    }
}

/// The phase, in [0, 1), from sine and cosine of the phase angle and of multiples. The phase `t` of
/// the first pair is corrected by a weighted least-squares step towards the other pairs:
///
/// ```text
/// d_k = (turns of pair k - k t, shortest) / k     w_k = k^2 |pair k|^2
/// turn = t + sum_k w_k d_k / sum_k w_k
/// ```
fn turn_of(pairs: &[f32]) -> f32 {
    let turns = |pair: &[f32]| f64::from(pair[0]).atan2(f64::from(pair[1])) / TAU;
    let first = turns(&pairs[..2]);
    let (mut moved, mut all) = (0.0, LEAST_HARMONICS);
    for (k, pair) in (1..).zip(pairs.chunks_exact(2)) {
        let k = f64::from(k);
        let rest = turns(pair) - k * first;
        let squares = pair.iter().map(|&part| f64::from(part).powi(2));
        let weight = k * k * squares.sum::<f64>();
        moved += weight * (rest - rest.round()) / k;
        all += weight;
    }
    let turn = (first + moved / all).rem_euclid(1.0) as f32;
    // Values just below 1 may round to 1.
    if turn >= 1.0 { 0.0 } else { turn }
}

/// Encoding of the orientation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OrientationEncoding {
    /// The stored quaternion (CC-MotionGen).
    #[default]
    Quaternion,
    /// The quaternion of a sample whose first frame is rotated to face +z. The sign is continuous,
    /// with `w >= 0` in the first frame. All samples then begin in the same direction.
    CanonicalQuaternion,
    /// The first two columns of the rotation matrix, a continuous representation (Zhou et al. 2019,
    /// <https://arxiv.org/abs/1812.07035>).
    #[serde(rename = "rotation_6d")]
    Rotation6d,
}

/// The channels in which a denoiser predicts a phrase.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ChannelEncoding {
    /// Encoding of the phase.
    pub phase: PhaseEncoding,
    /// Encoding of the orientation.
    pub orientation: OrientationEncoding,
}

impl ChannelEncoding {
    /// True if these are the 25 stored channels.
    pub fn are_stored_channels(self) -> bool {
        self == Self::default()
    }

    /// Number of channels.
    pub fn channels(self) -> usize {
        self.style_channels().end
    }

    /// Channels of the orientation.
    pub fn orientation_channels(self) -> Range<usize> {
        let width = match self.orientation {
            OrientationEncoding::Rotation6d => 6,
            _ => 4,
        };
        QUATERNION.start..QUATERNION.start + width
    }

    /// Channels of the angular velocity.
    pub fn angular_velocity_channels(self) -> Range<usize> {
        let start = self.orientation_channels().end;
        start..start + ANGULAR_VELOCITY.len()
    }

    /// Channels of the phase.
    pub fn phase_channels(self) -> Range<usize> {
        let start = self.angular_velocity_channels().end;
        start..start + (2 * self.phase.harmonics()).max(1)
    }

    /// Channels of the style descriptors.
    pub fn style_channels(self) -> Range<usize> {
        let start = self.phase_channels().end;
        start..start + STYLE.len()
    }

    /// The channels that [`crate::mirror`] negates.
    pub fn mirrored_channels(self) -> Vec<usize> {
        let rotation = self.angular_velocity_channels();
        let moved = |channel: usize| match channel {
            c if c < QUATERNION.start => Some(c),
            c if ANGULAR_VELOCITY.contains(&c) => Some(rotation.start + c - ANGULAR_VELOCITY.start),
            c if self.orientation != OrientationEncoding::Rotation6d => Some(c),
            _ => None,
        };
        let mut negated: Vec<usize> = mirrored_channels().into_iter().filter_map(moved).collect();
        if self.orientation == OrientationEncoding::Rotation6d {
            // S R S with S = diag(-1, 1, 1) negates y and z of the first column and x of the
            // second.
            negated.extend([1, 2, 3].map(|offset| QUATERNION.start + offset));
        }
        negated
    }

    /// Encodes `rows` `[frames, 25]` of one sample in the dataset's units as `[frames, channels]`.
    pub fn encode(self, rows: &[f32]) -> Cow<'_, [f32]> {
        if self.are_stored_channels() {
            return Cow::Borrowed(rows);
        }
        let mut motion = Phrase::new(rows.to_vec()).expect("whole frames of 25 channels");
        if self.orientation == OrientationEncoding::CanonicalQuaternion {
            let heading = motion.quaternion(0).yaw();
            rotate_yaw(&mut motion, -heading);
            let units = canonical_signs(motion.quaternions());
            for (t, unit) in units.into_iter().enumerate() {
                motion.set_quaternion(t, unit);
            }
        }
        let mut encoded = Vec::with_capacity(motion.frames() * self.channels());
        for t in 0..motion.frames() {
            let frame = motion.frame(t);
            encoded.extend_from_slice(&frame[..QUATERNION.start]);
            match self.orientation {
                OrientationEncoding::Rotation6d => {
                    let columns = to_columns(motion.quaternion(t).normalised());
                    encoded.extend(columns.map(|value| value as f32));
                }
                _ => encoded.extend_from_slice(&frame[QUATERNION]),
            }
            encoded.extend_from_slice(&frame[ANGULAR_VELOCITY]);
            if self.phase == PhaseEncoding::Scalar {
                encoded.push(frame[PHASE]);
            }
            for k in 1..=self.phase.harmonics() {
                let (sin, cos) = (TAU * k as f64 * f64::from(frame[PHASE])).sin_cos();
                encoded.extend([sin as f32, cos as f32]);
            }
            encoded.extend_from_slice(&frame[STYLE]);
        }
        Cow::Owned(encoded)
    }

    /// Decodes predicted `rows` `[frames, channels]` of one sample to `[frames, 25]`: a phase in
    /// [0, 1), and unit quaternions with continuous sign, the first with `w >= 0`. NaN stays NaN.
    pub fn decode(self, rows: Vec<f32>) -> Vec<f32> {
        if self.are_stored_channels() {
            return rows;
        }
        let frames = rows.chunks_exact(self.channels());
        let orientations = frames.clone().map(|frame| {
            let values = self.orientation_of(frame);
            match self.orientation {
                OrientationEncoding::Rotation6d => nearest_rotation(&values),
                _ => Quaternion::new(values[0], values[1], values[2], values[3]),
            }
        });
        let orientations = match self.orientation {
            OrientationEncoding::Quaternion => orientations.collect(),
            _ => canonical_signs(orientations.collect()),
        };
        let mut decoded = Vec::with_capacity(frames.len() * CHANNELS);
        for (frame, quaternion) in frames.zip(orientations) {
            decoded.extend_from_slice(&frame[..QUATERNION.start]);
            decoded.extend(quaternion.parts().map(|part| part as f32));
            decoded.extend_from_slice(&frame[self.angular_velocity_channels()]);
            let phase = &frame[self.phase_channels()];
            decoded.push(match self.phase {
                PhaseEncoding::Scalar => phase[0],
                _ => turn_of(phase),
            });
            decoded.extend_from_slice(&frame[self.style_channels()]);
        }
        decoded
    }

    /// Confidence of the predicted heading, 0 to 1, `[frames]`: the area spanned by two columns, or
    /// the norm of the quaternion. Both are small for means of different orientations. NaN stays
    /// NaN.
    pub fn confidence(self, rows: &[f32]) -> Vec<f64> {
        let of_frame = |frame: &[f32]| {
            let mut values = self.orientation_of(frame);
            if self.orientation == OrientationEncoding::Rotation6d {
                let [a, b] = pair(&values);
                values = cross(a, b).to_vec();
            }
            let squares = values.iter().map(|part| part * part);
            squares.sum::<f64>().sqrt().min(1.0)
        };
        rows.chunks_exact(self.channels()).map(of_frame).collect()
    }

    fn orientation_of(self, frame: &[f32]) -> Vec<f64> {
        let values = frame[self.orientation_channels()].iter();
        values.map(|&value| f64::from(value)).collect()
    }

    /// Statistics that normalize these channels to zero mean and unit deviation. Quaternions,
    /// rotations, sines and cosines are not changed. A phase of 0 to 1 is mapped to -1 to 1.
    pub fn statistics(self, moments: ChannelMoments) -> Statistics {
        let mut statistics = Statistics::standard(moments);
        let (orientation, phase) = (self.orientation_channels(), self.phase_channels());
        statistics.mean[orientation.clone()].fill(0.0);
        statistics.std[orientation].fill(1.0);
        let (mean, std) = match self.phase {
            PhaseEncoding::Scalar => (0.5, 0.5),
            _ => (0.0, 1.0),
        };
        statistics.mean[phase.clone()].fill(mean);
        statistics.std[phase.clone()].fill(std);
        if let Some([min, max]) = &mut statistics.range
            && self.phase != PhaseEncoding::Scalar
        {
            min[phase.clone()].fill(-1.0);
            max[phase].fill(1.0);
        }
        statistics
    }
}

/// Unit quaternions with continuous sign, the first with `w >= 0`. Values that are not finite are
/// not changed.
fn canonical_signs(mut quaternions: Vec<Quaternion>) -> Vec<Quaternion> {
    let mut before = Quaternion::IDENTITY;
    for quaternion in &mut quaternions {
        if quaternion.norm().is_finite() {
            before = quaternion.normalised().nearer_to(before);
            *quaternion = before;
        }
    }
    quaternions
}

/// The rotation of a matrix with these first two columns, `[6]`, by Gram-Schmidt. The direction of
/// the first column is kept. The quaternion's sign is arbitrary. The result is finite only for
/// finite columns.
pub fn from_columns(columns: &[f64]) -> Quaternion {
    let unit = |v: [f64; 3]| v.map(|part| part / dot(v, v).max(LEAST_SQUARE).sqrt());
    let [a, b] = pair(columns);
    let a = unit(a);
    let along = dot(a, b);
    of_orthonormal(a, unit([0, 1, 2].map(|i| b[i] - along * a[i])))
}

/// The rotation whose first two columns are nearest to these two, `[6]`, in least squares. The
/// quaternion's sign is arbitrary. The result is finite only for finite columns.
///
/// Short columns, such as means of many directions, have little influence. With Gram-Schmidt a body
/// with uncertain heading would fall over, because its side axis is short.
///
/// With `M` the columns, `p = |a|^2`, `q = |b|^2`, `r = a.b` and `s = |a x b|`, the nearest columns
/// are
///
/// ```text
/// M (M^T M)^{-1/2} = M [[q + s, -r], [-r, p + s]] / (s sqrt(p + q + 2 s))
/// ```
pub fn nearest_rotation(columns: &[f64]) -> Quaternion {
    let [a, b] = pair(columns);
    let (p, q, r) = (dot(a, a), dot(b, b), dot(a, b));
    let normal = cross(a, b);
    let s = dot(normal, normal).max(LEAST_SQUARE).sqrt();
    let scale = 1.0 / (s * (p + q + 2.0 * s).sqrt());
    let mixed = |x: f64, y: f64| [0, 1, 2].map(|i| scale * (x * a[i] + y * b[i]));
    of_orthonormal(mixed(q + s, -r), mixed(-r, p + s))
}

/// Two columns of six numbers.
fn pair(columns: &[f64]) -> [[f64; 3]; 2] {
    [0, 3].map(|first| std::array::from_fn(|axis| columns[first + axis]))
}

/// The rotation whose matrix has these first two columns.
fn of_orthonormal(a: [f64; 3], b: [f64; 3]) -> Quaternion {
    if !a.iter().chain(&b).all(|part| part.is_finite()) {
        return Quaternion::from([f64::NAN; 4]);
    }
    let c = cross(a, b);
    // The matrix 4 q q^T. The row with the largest diagonal is q times 4 times that part of q.
    let (wx, wy, wz) = (b[2] - c[1], c[0] - a[2], a[1] - b[0]);
    let (xy, xz, yz) = (a[1] + b[0], c[0] + a[2], b[2] + c[1]);
    let rows = [
        [1.0 + a[0] + b[1] + c[2], wx, wy, wz],
        [wx, 1.0 + a[0] - b[1] - c[2], xy, xz],
        [wy, xy, 1.0 - a[0] + b[1] - c[2], yz],
        [wz, xz, yz, 1.0 - a[0] - b[1] + c[2]],
    ];
    let largest = (0..4).max_by(|&i, &j| rows[i][i].total_cmp(&rows[j][j]));
    Quaternion::from(rows[largest.expect("four rows")]).normalised()
}

#[cfg(test)]
mod tests;
