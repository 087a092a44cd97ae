//! The features of one clip.

use std::ops::Range;

use super::kinematics::{forward_kinematics, from_columns};
use super::{FeatureError, FeatureLayout, Joints, Root, Skeleton};
use crate::Quaternion;

/// The features of one clip, `[frames, channels]`, single precision as stored, finite.
///
/// Row t speaks of frame t and its change to frame t + 1, so T frames of joints make T - 1 rows.
#[derive(Clone, Debug, PartialEq)]
pub struct Features {
    values: Vec<f32>,
    layout: FeatureLayout,
    root: Root,
}

impl Features {
    /// Features from their values `[frames, channels]`, row by row.
    ///
    /// # Errors
    /// [`FeatureError::NotWholeFrames`] unless they make one or more frames of the layout;
    /// [`FeatureError::NonFinite`] if a value is not finite.
    pub fn new(values: Vec<f32>, layout: FeatureLayout, root: Root) -> Result<Self, FeatureError> {
        let channels = layout.channels();
        if values.is_empty() || !values.len().is_multiple_of(channels) {
            return Err(FeatureError::NotWholeFrames {
                what: "features",
                values: values.len(),
                width: channels,
            });
        }
        if let Some(index) = values.iter().position(|value| !value.is_finite()) {
            return Err(FeatureError::NonFinite {
                what: "features",
                frame: index / channels,
                entry: format!("channel `{}`", layout.channel_name(index % channels)),
            });
        }
        Ok(Self {
            values,
            layout,
            root,
        })
    }

    /// Number of frames, at least 1.
    pub fn frames(&self) -> usize {
        self.values.len() / self.layout.channels()
    }

    /// Which channel says what.
    pub fn layout(&self) -> FeatureLayout {
        self.layout
    }

    /// How the first channels say where the root is.
    pub fn root(&self) -> Root {
        self.root
    }

    /// All values, `[frames, channels]` row by row.
    pub fn as_slice(&self) -> &[f32] {
        &self.values
    }

    /// All values, `[frames, channels]` row by row.
    pub fn into_vec(self) -> Vec<f32> {
        self.values
    }

    /// The channels of frame `t`.
    ///
    /// # Panics
    /// Panics if there is no frame `t`.
    pub fn frame(&self, t: usize) -> &[f32] {
        let channels = self.layout.channels();
        &self.values[t * channels..(t + 1) * channels]
    }

    /// The frames of `range`. With relative root the part begins at x = z = 0 facing +z, with
    /// absolute root it stays where it is.
    ///
    /// # Panics
    /// Panics if `range` is empty or reaches beyond the last frame.
    #[must_use]
    pub fn slice(&self, range: Range<usize>) -> Self {
        assert!(!range.is_empty(), "a clip has at least one frame");
        let channels = self.layout.channels();
        Self {
            values: self.values[range.start * channels..range.end * channels].to_vec(),
            ..*self
        }
    }

    /// Channels 0 to 3, `[frames, 4]`: rotation, x, z, height.
    pub fn root_channels(&self) -> Vec<[f64; 4]> {
        let rows = (0..self.frames()).map(|t| self.frame(t));
        rows.map(|row| [0, 1, 2, 3].map(|i| f64::from(row[i])))
            .collect()
    }

    /// The root's positions (x, height, z), `[frames, 3]`, metres, summed in double precision.
    pub fn root_positions(&self) -> Vec<[f64; 3]> {
        self.root.positions(&self.root_channels())
    }

    /// The root quaternions, world to facing frame, `[frames]`.
    pub fn root_quaternions(&self) -> Vec<Quaternion> {
        self.root.quaternions(&self.root_channels())
    }

    /// The same features with absolute root ([`Root::convert`]).
    #[must_use]
    pub fn to_absolute(&self) -> Self {
        self.with_root(Root::Absolute)
    }

    /// The same features with relative root ([`Root::convert`]): where the way began is lost, and
    /// the last row's change repeats the one before.
    #[must_use]
    pub fn to_relative(&self) -> Self {
        self.with_root(Root::Relative)
    }

    /// The same features with their root read as `root`.
    #[must_use]
    pub fn with_root(&self, root: Root) -> Self {
        let mut values = self.values.clone();
        if root != self.root {
            let converted = self.root.convert(&self.root_channels(), root);
            let rows = values.chunks_exact_mut(self.layout.channels());
            for (row, root) in rows.zip(converted) {
                for (value, converted) in row.iter_mut().zip(root) {
                    *value = converted as f32;
                }
            }
        }
        Self {
            values,
            layout: self.layout,
            root,
        }
    }

    /// The joints by their positions in the features, `[frames, J, 3]`: turned from the facing
    /// frame to the world and moved to the root's place on the ground.
    pub fn joints(&self) -> Joints {
        let count = self.layout.joints();
        let mut places = Vec::with_capacity(self.frames() * count);
        let roots = self.root_positions().into_iter();
        for (t, (root, turn)) in roots.zip(self.root_quaternions()).enumerate() {
            places.push(root);
            let to_world = turn.conjugate();
            let (positions, _) = self.frame(t)[self.layout.positions()].as_chunks::<3>();
            places.extend(positions.iter().map(|position| {
                let [x, y, z] = to_world.rotate(position.map(f64::from));
                [x + root[0], y, z + root[2]]
            }));
        }
        Joints::computed(places, count)
    }

    /// The joints by their rotations in the features, `[frames, J, 3]`: forward kinematics with the
    /// bones of the skeleton's reference pose, from the root's place, the root turned by the root
    /// quaternion itself.
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`] if they are not features of `skeleton`;
    /// [`FeatureError::NonFinite`] if the way is so far that it overflows.
    pub fn joints_from_rotations(&self, skeleton: &Skeleton) -> Result<Joints, FeatureError> {
        skeleton.accept_layout(self.layout)?;
        let mut rotations = Vec::with_capacity(self.frames() * self.layout.joints());
        for (t, root) in self.root_quaternions().into_iter().enumerate() {
            rotations.push(root);
            let (columns, _) = self.frame(t)[self.layout.rotations()].as_chunks::<6>();
            let each = columns.iter().map(|six| from_columns(six.map(f64::from)));
            rotations.extend(each);
        }
        let roots = self.root_positions();
        forward_kinematics(skeleton, &skeleton.offsets(), &roots, &rotations)
    }

    /// The features of the clip reflected at the plane x = 0, left for right; exactly those that
    /// the mirrored joints ([`Joints::mirror`]) have, as the two sides of a [`Skeleton`] are
    /// images of each other.
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`] if they are not features of `skeleton`.
    pub fn mirror(&self, skeleton: &Skeleton) -> Result<Self, FeatureError> {
        /// Signs of a rotation's two columns: a reflected turn keeps its part about x alone.
        const ROTATION: [f32; 6] = [1.0, -1.0, -1.0, -1.0, 1.0, 1.0];
        const VECTOR: [f32; 3] = [-1.0, 1.0, 1.0];
        skeleton.accept_layout(self.layout)?;
        let image = skeleton.mirrored();
        let (layout, channels) = (self.layout, self.layout.channels());
        let mut source: Vec<usize> = (0..channels).collect();
        let mut sign = vec![1.0; channels];
        // Half angle and sideways way change sign in both readings of the root.
        (sign[0], sign[1]) = (-1.0, -1.0);
        let mut reflect = |range: Range<usize>, first_joint: usize, signs: &[f32]| {
            for channel in range.clone() {
                let (joint, part) = (
                    (channel - range.start) / signs.len() + first_joint,
                    (channel - range.start) % signs.len(),
                );
                let other = image[joint] - first_joint;
                source[channel] = range.start + other * signs.len() + part;
                sign[channel] = signs[part];
            }
        };
        reflect(layout.positions(), 1, &VECTOR);
        reflect(layout.rotations(), 1, &ROTATION);
        reflect(layout.velocities(), 0, &VECTOR);
        source[layout.contacts()].rotate_left(2);
        let rows = (0..self.frames()).map(|t| self.frame(t));
        let values = rows.flat_map(|row| source.iter().zip(&sign).map(|(&c, sign)| sign * row[c]));
        Ok(Self {
            values: values.collect(),
            ..*self
        })
    }
}
