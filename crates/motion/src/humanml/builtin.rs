//! The skeletons of the two published datasets.

use super::{FaceJoints, Feet, Skeleton, SkeletonDescription};

const LEFT: [f64; 3] = [1.0, 0.0, 0.0];
const RIGHT: [f64; 3] = [-1.0, 0.0, 0.0];
const UP: [f64; 3] = [0.0, 1.0, 0.0];
const DOWN: [f64; 3] = [0.0, -1.0, 0.0];
const FORWARD: [f64; 3] = [0.0, 0.0, 1.0];

/// A joint: name, raw direction, offset in the reference pose in metres.
type Joint = (&'static str, [f64; 3], [f64; 3]);

/// Joints and directions: docs/sources.md, section 3.1. The offsets are this project's own.
const HUMANML3D: [Joint; 22] = [
    ("pelvis", [0.0; 3], [0.0; 3]),
    ("left_hip", LEFT, [0.085, -0.075, 0.0]),
    ("right_hip", RIGHT, [-0.085, -0.075, 0.0]),
    ("spine1", UP, [0.0, 0.11, -0.02]),
    ("left_knee", DOWN, [0.01, -0.39, 0.0]),
    ("right_knee", DOWN, [-0.01, -0.39, 0.0]),
    ("spine2", UP, [0.0, 0.135, 0.01]),
    ("left_ankle", DOWN, [0.0, -0.40, -0.03]),
    ("right_ankle", DOWN, [0.0, -0.40, -0.03]),
    ("spine3", UP, [0.0, 0.06, 0.01]),
    ("left_foot", FORWARD, [0.03, -0.06, 0.13]),
    ("right_foot", FORWARD, [-0.03, -0.06, 0.13]),
    ("neck", UP, [0.0, 0.21, -0.02]),
    ("left_collar", LEFT, [0.075, 0.115, -0.01]),
    ("right_collar", RIGHT, [-0.075, 0.115, -0.01]),
    ("head", FORWARD, [0.0, 0.09, 0.05]),
    ("left_shoulder", DOWN, [0.11, 0.03, -0.01]),
    ("right_shoulder", DOWN, [-0.11, 0.03, -0.01]),
    ("left_elbow", DOWN, [0.25, -0.02, -0.02]),
    ("right_elbow", DOWN, [-0.25, -0.02, -0.02]),
    ("left_wrist", DOWN, [0.25, 0.0, 0.0]),
    ("right_wrist", DOWN, [-0.25, 0.0, 0.0]),
];

/// Left and right are those of the published facing joints and contact flags. The published raw
/// directions of hips and shoulders point to the other side. The directions affect rotations but
/// not positions.
const KIT: [Joint; 21] = [
    ("root", [0.0; 3], [0.0; 3]),
    ("pelvis", UP, [0.0, 0.06, 0.0]),
    ("thorax", UP, [0.0, 0.14, 0.0]),
    ("lower_neck", UP, [0.0, 0.25, 0.0]),
    ("upper_neck", UP, [0.0, 0.08, 0.02]),
    ("right_shoulder", LEFT, [-0.18, -0.03, 0.0]),
    ("right_elbow", DOWN, [-0.28, 0.0, 0.0]),
    ("right_wrist", DOWN, [-0.25, 0.0, 0.0]),
    ("left_shoulder", RIGHT, [0.18, -0.03, 0.0]),
    ("left_elbow", DOWN, [0.28, 0.0, 0.0]),
    ("left_wrist", DOWN, [0.25, 0.0, 0.0]),
    ("right_hip", LEFT, [-0.09, -0.04, 0.0]),
    ("right_knee", DOWN, [0.0, -0.42, 0.0]),
    ("right_ankle", DOWN, [0.0, -0.41, -0.02]),
    ("right_heel", FORWARD, [0.0, -0.06, 0.04]),
    ("right_foot", FORWARD, [0.0, -0.01, 0.12]),
    ("left_hip", RIGHT, [0.09, -0.04, 0.0]),
    ("left_knee", DOWN, [0.0, -0.42, 0.0]),
    ("left_ankle", DOWN, [0.0, -0.41, -0.02]),
    ("left_heel", FORWARD, [0.0, -0.06, 0.04]),
    ("left_foot", FORWARD, [0.0, -0.01, 0.12]),
];

impl Skeleton {
    /// The 22 joints of HumanML3D at 20 frames per second: 263 channels.
    ///
    /// The reference pose is this project's own. The dataset's reference pose comes from its first
    /// clip ([`with_rest_pose`](Self::with_rest_pose)).
    pub fn humanml3d() -> Self {
        built_in(
            &HUMANML3D,
            ["ankle", "foot"],
            SkeletonDescription {
                name: "humanml3d".to_string(),
                fps: 20.0,
                chains: vec![
                    vec![0, 2, 5, 8, 11],
                    vec![0, 1, 4, 7, 10],
                    vec![0, 3, 6, 9, 12, 15],
                    vec![9, 14, 17, 19, 21],
                    vec![9, 13, 16, 18, 20],
                ],
                leg_joints: [5, 8],
                ..SkeletonDescription::default()
            },
        )
    }

    /// The 21 joints of KIT at 12.5 frames per second: 251 channels.
    ///
    /// The reference pose is this project's own, in metres. The dataset's files are in millimetres
    /// and converted when read ([`FeatureLayout::in_metres`]).
    ///
    /// [`FeatureLayout::in_metres`]: super::FeatureLayout::in_metres
    pub fn kit() -> Self {
        built_in(
            &KIT,
            ["heel", "foot"],
            SkeletonDescription {
                name: "kit".to_string(),
                fps: 12.5,
                chains: vec![
                    vec![0, 11, 12, 13, 14, 15],
                    vec![0, 16, 17, 18, 19, 20],
                    vec![0, 1, 2, 3, 4],
                    vec![3, 5, 6, 7],
                    vec![3, 8, 9, 10],
                ],
                leg_joints: [17, 18],
                ..SkeletonDescription::default()
            },
        )
    }
}

/// The skeleton of these joints. Names pair left and right joints and contain `feet`, the two
/// joints of the contact flags.
fn built_in(joints: &[Joint], feet: [&str; 2], description: SkeletonDescription) -> Skeleton {
    let place = |wanted: String| joints.iter().position(|(name, ..)| *name == wanted);
    let left = |part: &str| place(format!("left_{part}")).expect("a left joint");
    let right = |part: &str| place(format!("right_{part}")).expect("a right joint");
    let parts = joints
        .iter()
        .filter_map(|(name, ..)| name.strip_prefix("left_"));
    Skeleton::new(SkeletonDescription {
        joint_names: joints.iter().map(|(name, ..)| name.to_string()).collect(),
        raw_directions: joints.iter().map(|(_, direction, _)| *direction).collect(),
        rest_offsets: joints.iter().map(|(.., offset)| *offset).collect(),
        face_joints: FaceJoints {
            right_hip: right("hip"),
            left_hip: left("hip"),
            right_shoulder: right("shoulder"),
            left_shoulder: left("shoulder"),
        },
        mirrored_joints: parts.map(|part| [left(part), right(part)]).collect(),
        feet: Feet {
            left: feet.map(left),
            right: feet.map(right),
        },
        ..description
    })
    .expect("the built-in descriptions are sound")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_built_in_skeletons_have_the_published_sizes() {
        let (humanml3d, kit) = (Skeleton::humanml3d(), Skeleton::kit());
        assert_eq!(humanml3d.layout().channels(), 263);
        assert_eq!(kit.layout().channels(), 251);
        assert_eq!(humanml3d.parents()[13], Some(9));
        assert_eq!(kit.parents()[8], Some(3));
    }
}
