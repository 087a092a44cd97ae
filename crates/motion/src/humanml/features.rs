//! The features of one clip.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::bone_rotations::{forward_kinematics, from_columns};
use super::{FeatureError, FeatureLayout, Joints, Root, Skeleton};
use crate::Quaternion;

/// The features of one clip, `[frames, channels]`, single precision, finite. Row t describes frame
/// t and its step to frame t + 1, so T frames of joints give T - 1 rows.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Features {
    values: Vec<f32>,
    layout: FeatureLayout,
    root: Root,
}

impl Features {
    /// Features from their values `[frames, channels]`, row by row.
    ///
    /// # Errors
    /// [`FeatureError::NotWholeFrames`]; [`FeatureError::NonFinite`] if a value is not finite.
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

    /// The channel layout.
    pub fn layout(&self) -> FeatureLayout {
        self.layout
    }

    /// Representation of the root.
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
    pub fn frame(&self, t: usize) -> &[f32] {
        let channels = self.layout.channels();
        &self.values[t * channels..(t + 1) * channels]
    }

    /// The rows of `range` unchanged. With relative root the part begins at x = z = 0 facing +z,
    /// but the rotations keep the old heading. [`crop`](Self::crop) also rotates the rotations.
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
        let of_frame = |t| [0, 1, 2, 3].map(|i| f64::from(self.frame(t)[i]));
        (0..self.frames()).map(of_frame).collect()
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

    /// The same features with relative root, the last step repeated ([`Root::convert`]).
    #[must_use]
    pub fn to_relative(&self) -> Self {
        self.with_root(Root::Relative)
    }

    /// The same features with their root read as `root`.
    #[must_use]
    pub fn with_root(&self, root: Root) -> Self {
        let mut values = self.values.clone();
        let converted = self.root.convert(&self.root_channels(), root);
        let rows = values.chunks_exact_mut(self.layout.channels());
        for (row, root) in rows.zip(converted) {
            row[FeatureLayout::ROOT].copy_from_slice(&root.map(|value| value as f32));
        }
        Self {
            values,
            root,
            ..*self
        }
    }

    /// The clip whose root leaves frame `last` with the step by which it came: all later frames are
    /// moved over the ground. Unchanged without a frame before and after `last`.
    #[must_use]
    pub fn continued_after(&self, last: usize) -> Self {
        if last == 0 || last + 1 >= self.frames() {
            return self.clone();
        }
        let mut moved = self.to_absolute();
        let at = |t: usize, axis: usize| moved.frame(t)[axis];
        let shift =
            [1, 2].map(|axis| 2.0 * at(last, axis) - at(last - 1, axis) - at(last + 1, axis));
        let rows = moved.values.chunks_exact_mut(moved.layout.channels());
        for row in rows.skip(last + 1) {
            row[1] += shift[0];
            row[2] += shift[1];
        }
        moved.with_root(self.root)
    }

    /// The joints by the positions in the features, `[frames, J, 3]`.
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

    /// The joints from the rotations, `[frames, J, 3]`, with the bones of the reference pose.
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`]; [`FeatureError::NonFinite`] if positions overflow.
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

    /// The features of the clip reflected at the plane x = 0, as by [`Joints::mirror`].
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`] for features of another skeleton.
    pub fn mirror(&self, skeleton: &Skeleton) -> Result<Self, FeatureError> {
        /// Signs of a rotation's two columns.
        const ROTATION: [f32; 6] = [1.0, -1.0, -1.0, -1.0, 1.0, 1.0];
        const VECTOR: [f32; 3] = [-1.0, 1.0, 1.0];
        skeleton.accept_layout(self.layout)?;
        let image = skeleton.mirrored();
        let (layout, channels) = (self.layout, self.layout.channels());
        let mut source: Vec<usize> = (0..channels).collect();
        let mut sign = vec![1.0; channels];
        // The half angle and the sideways step change sign in both root representations.
        (sign[0], sign[1]) = (-1.0, -1.0);
        let mut reflect = |range: Range<usize>, first_joint: usize, signs: &[f32]| {
            for channel in range.clone() {
                let (place, width) = (channel - range.start, signs.len());
                let other = image[place / width + first_joint] - first_joint;
                source[channel] = range.start + other * width + place % width;
                sign[channel] = signs[place % width];
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{Extraction, test_clip};
    use super::*;

    #[test]
    fn a_clip_is_continued_with_the_step_before() {
        let layout = FeatureLayout::of_joints(22).unwrap();
        let mut values = vec![0.0; 6 * layout.channels()];
        let rows = values.chunks_exact_mut(layout.channels());
        for (row, z) in rows.zip([0.0, 1.0, 2.0, 7.0, 7.5, 8.5]) {
            row[2] = z;
        }
        let clip = Features::new(values, layout, Root::Absolute).unwrap();
        let places = |clip: &Features| -> Vec<f64> {
            let positions = clip.root_positions().into_iter();
            positions.map(|[_, _, z]| z).collect()
        };
        let moved = clip.continued_after(2);
        assert_eq!(places(&moved), [0.0, 1.0, 2.0, 3.0, 3.5, 4.5]);
        let relative = clip.to_relative().continued_after(2);
        let mut far = places(&relative).into_iter().zip(places(&moved));
        assert!(far.all(|(a, b)| (a - b).abs() < 1e-5));
        for last in [0, 5, 6] {
            assert_eq!(clip.continued_after(last), clip);
        }
    }

    /// Relative features like those of a real clip: small changes, other channels equal to their
    /// index.
    fn relative(frames: usize) -> impl Strategy<Value = Features> {
        let row = (-0.2f32..0.2, -0.1f32..0.1, -0.1f32..0.1, 0.5f32..1.5);
        proptest::collection::vec(row, 1..=frames).prop_map(|rows| {
            let layout = FeatureLayout::of_joints(3).unwrap();
            let rest = (4..layout.channels()).map(|channel| 0.01 * channel as f32);
            let values = rows
                .into_iter()
                .flat_map(|(rotation, x, z, y)| [rotation, x, z, y].into_iter().chain(rest.clone()))
                .collect();
            Features::new(values, layout, Root::Relative).unwrap()
        })
    }

    fn apart(a: &Features, b: &Features) -> f32 {
        let pairs = a.as_slice().iter().zip(b.as_slice());
        pairs.fold(0.0, |largest: f32, (a, b)| largest.max((a - b).abs()))
    }

    #[test]
    fn spoiled_values_are_refused_with_their_place() {
        let layout = FeatureLayout::of_joints(2).unwrap();
        let new = |values| Features::new(values, layout, Root::Relative);
        assert!(matches!(
            new(vec![0.0; 24]),
            Err(FeatureError::NotWholeFrames { values: 24, .. })
        ));
        let mut values = vec![0.0; 46];
        values[26] = f32::NAN;
        let error = new(values).unwrap_err().to_string();
        assert!(
            error.contains("frame 1") && error.contains("`root.height_y`"),
            "{error}"
        );
    }

    #[test]
    fn a_part_of_an_absolute_clip_stays_where_it_is() {
        let skeleton = Skeleton::humanml3d();
        let clip = Extraction::default()
            .features(&skeleton, &test_clip(&skeleton, 20))
            .unwrap();
        let absolute = clip.to_absolute();
        let part = absolute.slice(5..9);
        assert_eq!(
            part.joints().as_slice(),
            &absolute.joints().as_slice()[5 * 22..9 * 22]
        );
        let [x, y, z] = clip.slice(5..9).root_positions()[0];
        assert_eq!((x, z), (0.0, 0.0));
        assert_eq!(y, absolute.root_positions()[5][1]);
    }

    #[test]
    fn mirrored_features_are_those_of_mirrored_joints() {
        let extraction = Extraction {
            rescale: false,
            ..Extraction::default()
        };
        for skeleton in [Skeleton::humanml3d(), Skeleton::kit()] {
            let joints = test_clip(&skeleton, 30);
            let features = extraction.features(&skeleton, &joints).unwrap();
            let mirrored = joints.mirror(&skeleton).unwrap();
            assert_eq!(mirrored.mirror(&skeleton).unwrap(), joints);
            let expected = extraction.features(&skeleton, &mirrored).unwrap();
            let found = features.mirror(&skeleton).unwrap();
            assert!(apart(&found, &expected) < 1e-6);
            assert!(apart(&found, &features) > 0.1);
            assert_eq!(found.mirror(&skeleton).unwrap(), features);
        }
    }

    #[test]
    fn features_of_any_skeleton_lead_back_to_its_joints() {
        for skeleton in [Skeleton::humanml3d(), Skeleton::kit()] {
            let joints = test_clip(&skeleton, 30);
            let joints = super::super::extract::canonicalize(&skeleton, &joints).unwrap();
            let features = Extraction::default().features(&skeleton, &joints).unwrap();
            for found in [
                features.joints(),
                features.joints_from_rotations(&skeleton).unwrap(),
            ] {
                let pairs = found.as_slice().iter().zip(joints.as_slice());
                for (a, b) in pairs.flat_map(|(a, b)| a.iter().zip(b)) {
                    assert!((a - b).abs() < 1e-5);
                }
            }
        }
    }

    proptest! {
        #[test]
        fn relative_features_return_from_absolute_ones(relative in relative(196)) {
            let back = relative.to_absolute().to_relative();
            let last = relative.frames() - 1;
            if last > 0 {
                prop_assert!(apart(&back.slice(0..last), &relative.slice(0..last)) < 1e-4);
            }
            // The change in the last row is not determined; the other channels are.
            prop_assert_eq!(&back.frame(last)[3..], &relative.frame(last)[3..]);
        }
    }
}
