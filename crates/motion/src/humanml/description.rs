//! A skeleton as stored in files.

use serde::{Deserialize, Serialize};

/// The description of a skeleton, as stored in files. [`Skeleton`](super::Skeleton) is the
/// validated form. Joints are indices. Axes: +x left, +y up, +z forward.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SkeletonDescription {
    /// Name, for messages and files.
    pub name: String,
    /// Frames per second of its clips.
    pub fps: f64,
    /// Names of the joints, `[J]`, the root first.
    pub joint_names: Vec<String>,
    /// Bones as chains. The first chain begins at joint 0, later chains at a joint of an earlier
    /// chain.
    pub chains: Vec<Vec<usize>>,
    /// Directions of bones without rotation, `[J, 3]`: unit vectors, joint 0 unused.
    pub raw_directions: Vec<[f64; 3]>,
    /// Child minus parent in the reference pose, `[J, 3]`, metres, joint 0 unused.
    pub rest_offsets: Vec<[f64; 3]>,
    /// Joints that define the facing direction.
    pub face_joints: FaceJoints,
    /// Pairs of left and right joints; other joints lie in the middle.
    pub mirrored_joints: Vec<[usize; 2]>,
    /// The joints of the feet, in the order of the contact flags.
    pub feet: Feet,
    /// A knee and an ankle: the lengths of their bones measure the body.
    pub leg_joints: [usize; 2],
}

/// Joints that define the facing direction.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FaceJoints {
    /// Right hip.
    pub right_hip: usize,
    /// Left hip.
    pub left_hip: usize,
    /// Right shoulder.
    pub right_shoulder: usize,
    /// Left shoulder.
    pub left_shoulder: usize,
}

/// The joints of the feet: ankle and foot of each side.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Feet {
    /// Of the left foot.
    pub left: [usize; 2],
    /// Of the right foot.
    pub right: [usize; 2],
}
