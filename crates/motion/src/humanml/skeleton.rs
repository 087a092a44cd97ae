//! The joint tree of features, as data.

use serde::{Deserialize, Serialize};

use super::{FeatureError, FeatureLayout, Feet, SkeletonDescription};
use crate::feet::Leg;
use crate::vector::{length, minus};

/// A valid skeleton, from a [`SkeletonDescription`] (also its stored form) or built in.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(try_from = "SkeletonDescription", into = "SkeletonDescription")]
pub struct Skeleton {
    description: SkeletonDescription,
    parents: Vec<Option<usize>>,
    layout: FeatureLayout,
}

impl Skeleton {
    /// Checks a description.
    ///
    /// # Errors
    /// [`FeatureError::InvalidSkeleton`] names the contradictory field.
    pub fn new(description: SkeletonDescription) -> Result<Self, FeatureError> {
        let parents = super::validate::parents(&description)?;
        super::validate::the_rest(&description)?;
        let layout = FeatureLayout::of_joints(parents.len())?;
        Ok(Self {
            description,
            parents,
            layout,
        })
    }

    /// The same skeleton with the bones of a reference pose: `joints`, `[J, 3]`, metres.
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`]; [`FeatureError::InvalidSkeleton`] for a bone of length 0.
    pub fn with_rest_pose(&self, joints: &[[f64; 3]]) -> Result<Self, FeatureError> {
        let what = "joints of the reference pose";
        FeatureError::unless_equal(what, self.joints(), joints.len())?;
        let offset = |(joint, parent): (usize, &Option<usize>)| match parent {
            None => [0.0; 3],
            Some(parent) => minus(joints[joint], joints[*parent]),
        };
        let rest_offsets = self.parents.iter().enumerate().map(offset).collect();
        Self::new(SkeletonDescription {
            rest_offsets,
            ..self.description.clone()
        })
    }

    /// The same skeleton with clips of `fps` frames per second.
    ///
    /// # Panics
    /// Unless `fps` is a positive number.
    #[must_use]
    pub fn at_rate(mut self, fps: f64) -> Self {
        assert!(fps.is_finite() && fps > 0.0, "{fps} frames per second");
        self.description.fps = fps;
        self
    }

    /// The description.
    pub fn description(&self) -> &SkeletonDescription {
        &self.description
    }

    /// Number of joints, the root included.
    pub fn joints(&self) -> usize {
        self.parents.len()
    }

    /// The parent of each joint, `[J]`; none for the root.
    pub fn parents(&self) -> &[Option<usize>] {
        &self.parents
    }

    /// The layout of its features.
    pub fn layout(&self) -> FeatureLayout {
        self.layout
    }

    /// Bones by chain: parent and child.
    pub fn chains(&self) -> impl Iterator<Item = impl Iterator<Item = [usize; 2]>> {
        let pairs = |chain: &'_ [usize]| [chain[0], chain[1]];
        let chains = self.description.chains.iter();
        chains.map(move |chain| chain.windows(2).map(pairs))
    }

    /// The joints of the contact flags.
    pub fn contact_joints(&self) -> [usize; 4] {
        let Feet { left, right } = self.description.feet;
        [left[0], left[1], right[0], right[1]]
    }

    /// The left and right leg, from hip to toe. A leg without knee and ankle is omitted.
    pub fn legs(&self) -> Vec<Leg> {
        let (hips, feet) = (&self.description.face_joints, &self.description.feet);
        let sides = [(hips.left_hip, feet.left), (hips.right_hip, feet.right)];
        let leg = |(hip, [_, sole]): (usize, [usize; 2])| {
            let above = std::iter::successors(Some(sole), |&joint| self.parents[joint]);
            let mut below: Vec<usize> = above.collect();
            below.truncate(below.iter().position(|&joint| joint == hip)?);
            let mut below = below.into_iter().rev();
            Some(Leg {
                hip,
                knee: below.next()?,
                ankle: below.next()?,
                sole,
            })
        };
        sides.into_iter().filter_map(leg).collect()
    }

    /// The mirror image of each joint, `[J]`.
    pub fn mirrored(&self) -> Vec<usize> {
        let mut mirrored: Vec<usize> = (0..self.joints()).collect();
        for &[left, right] in &self.description.mirrored_joints {
            mirrored.swap(left, right);
        }
        mirrored
    }

    /// Raw directions with the reference bones' lengths, `[J, 3]`, metres.
    pub fn offsets(&self) -> Vec<[f64; 3]> {
        let lengths = self.description.rest_offsets.iter().map(|o| length(*o));
        self.offsets_of_lengths(lengths)
    }

    /// Raw directions with the bone lengths of one frame of a clip.
    pub fn offsets_of_frame(&self, frame: &[[f64; 3]]) -> Vec<[f64; 3]> {
        assert_eq!(frame.len(), self.joints(), "a place for each joint");
        let bone = |(joint, parent): (usize, &Option<usize>)| {
            let start = parent.map_or([0.0; 3], |parent| frame[parent]);
            length(minus(frame[joint], start))
        };
        self.offsets_of_lengths(self.parents.iter().enumerate().map(bone))
    }

    fn offsets_of_lengths(&self, lengths: impl Iterator<Item = f64>) -> Vec<[f64; 3]> {
        let bones = self.description.raw_directions.iter().zip(lengths);
        let offsets = bones.map(|(direction, length)| direction.map(|value| value * length));
        let mut offsets: Vec<[f64; 3]> = offsets.collect();
        offsets[0] = [0.0; 3];
        offsets
    }

    /// Name of channel `index` of the features, such as `root.height_y` or `left_hip.ric_x`.
    pub fn channel_name(&self, index: usize) -> String {
        let (joint, component) = self.layout.channel(index);
        let contact = index.checked_sub(self.layout.contacts().start);
        let joint = joint.or_else(|| Some(self.contact_joints()[contact?]));
        let of = joint.map_or("root", |joint| &self.description.joint_names[joint]);
        format!("{of}.{component}")
    }

    /// Rejects features of another skeleton.
    pub(super) fn accept_layout(&self, layout: FeatureLayout) -> Result<(), FeatureError> {
        let (expected, found) = (self.layout.channels(), layout.channels());
        FeatureError::unless_equal("channels of a frame", expected, found)
    }
}

impl TryFrom<SkeletonDescription> for Skeleton {
    type Error = FeatureError;

    fn try_from(description: SkeletonDescription) -> Result<Self, FeatureError> {
        Self::new(description)
    }
}

impl From<Skeleton> for SkeletonDescription {
    fn from(skeleton: Skeleton) -> Self {
        skeleton.description
    }
}
