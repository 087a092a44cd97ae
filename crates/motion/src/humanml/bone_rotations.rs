//! Rotations of bones from joint positions, and back.
//!
//! The rotation of joint b rotates the bone that *ends* at b. In the published data every chain
//! begins at the root quaternion, which maps world to body. Bone rotations map body to world: the
//! first contains the heading twice. Source: HumanML3D (docs/sources.md, section 3.2).

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::{FeatureError, Joints, Skeleton};
use crate::Quaternion;
use crate::rotation::between;
use crate::vector::{minus, plus, unit};

/// Standard deviation of the heading filter, frames.
const HEADING_DEVIATION: f64 = 20.0;
/// Reach of the heading filter, frames.
const HEADING_REACH: usize = 80;

/// Heading of the root quaternion.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Heading {
    /// The heading of each frame, available in real time.
    Raw,
    /// Filtered over time with a Gaussian of 20 frames that reaches 80 frames ahead.
    #[default]
    Smoothed,
}

/// Signs of the vectors across hips and shoulders in their sum.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Across {
    /// Both from left to right.
    Consistent,
    /// Shoulders from left to right, hips from right to left, as in the published dataset.
    Published,
}

/// The horizontal facing direction of one frame's joints, of any length.
pub fn forward(skeleton: &Skeleton, frame: &[[f64; 3]], across: Across) -> [f64; 3] {
    let face = skeleton.description().face_joints;
    let hips = match across {
        Across::Consistent => minus(frame[face.right_hip], frame[face.left_hip]),
        Across::Published => minus(frame[face.left_hip], frame[face.right_hip]),
    };
    let shoulders = minus(frame[face.right_shoulder], frame[face.left_shoulder]);
    let [x, _, z] = unit(plus(hips, shoulders));
    // The cross product of +y and the sum.
    [z, 0.0, -x]
}

/// The horizontal facing direction, `[frames, 3]`, unit vectors, with the published signs.
///
/// # Errors
/// [`FeatureError::LengthMismatch`] if they are not joints of `skeleton`.
pub fn facing(
    skeleton: &Skeleton,
    joints: &Joints,
    heading: Heading,
) -> Result<Vec<[f64; 3]>, FeatureError> {
    joints.must_be_of(skeleton)?;
    let of_frame = |t| forward(skeleton, joints.frame(t), Across::Published);
    let raw: Vec<[f64; 3]> = (0..joints.frames()).map(of_frame).collect();
    let directions = match heading {
        Heading::Raw => raw,
        Heading::Smoothed => smooth(&raw),
    };
    Ok(directions.into_iter().map(unit).collect())
}

/// Vectors filtered over time, with repeated ends.
fn smooth(vectors: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let reach = HEADING_REACH as i64;
    let weight = |offset: i64| (-0.5 * (offset as f64 / HEADING_DEVIATION).powi(2)).exp();
    let weights: Vec<f64> = (-reach..=reach).map(weight).collect();
    let total: f64 = weights.iter().sum();
    let last = vectors.len() as i64 - 1;
    let mean = |t: i64| {
        (-reach..=reach)
            .zip(&weights)
            .fold([0.0; 3], |sum, (offset, weight)| {
                let vector = vectors[(t + offset).clamp(0, last) as usize];
                plus(sum, vector.map(|value| value * weight / total))
            })
    };
    (0..=last).map(mean).collect()
}

/// Rotations of all joints, `[frames, J]`: the root quaternion, then the rotations of the bones
/// that end at joints 1 to J-1. The root quaternion maps world to facing frame and is the identity
/// in the first frame.
///
/// # Errors
/// [`FeatureError::LengthMismatch`] if they are not joints of `skeleton`.
pub fn inverse_kinematics(
    skeleton: &Skeleton,
    joints: &Joints,
    heading: Heading,
) -> Result<Vec<Quaternion>, FeatureError> {
    let facing = facing(skeleton, joints, heading)?;
    let root = |(t, facing): (usize, [f64; 3])| match t {
        0 => Quaternion::IDENTITY,
        _ => between(facing, [0.0, 0.0, 1.0]),
    };
    let roots = facing.into_iter().enumerate().map(root);
    let of_frame = |(t, root)| rotations_of_frame(skeleton, joints.frame(t), root);
    Ok(roots.enumerate().flat_map(of_frame).collect())
}

/// The rotations of the joints of one frame, `[J]`, with the root quaternion `root`.
pub(super) fn rotations_of_frame(
    skeleton: &Skeleton,
    frame: &[[f64; 3]],
    root: Quaternion,
) -> Vec<Quaternion> {
    let raw = &skeleton.description().raw_directions;
    let mut rotations = vec![root; skeleton.joints()];
    for chain in skeleton.chains() {
        let mut above = root;
        for [start, end] in chain {
            let bone = between(raw[end], minus(frame[end], frame[start]));
            rotations[end] = above.conjugate() * bone;
            above = above * rotations[end];
        }
    }
    rotations
}

/// The root quaternion of a single frame: world to facing frame.
pub(super) fn raw_root(skeleton: &Skeleton, frame: &[[f64; 3]]) -> Quaternion {
    let facing = unit(forward(skeleton, frame, Across::Published));
    between(facing, [0.0, 0.0, 1.0])
}

/// The joints of rotations `[frames, J]`, with bones `[J, 3]` and root positions `[frames, 3]`.
///
/// # Errors
/// [`FeatureError::LengthMismatch`]; [`FeatureError::NonFinite`] if the joints are not finite.
pub fn forward_kinematics(
    skeleton: &Skeleton,
    offsets: &[[f64; 3]],
    roots: &[[f64; 3]],
    rotations: &[Quaternion],
) -> Result<Joints, FeatureError> {
    let count = skeleton.joints();
    FeatureError::unless_equal("offsets", count, offsets.len())?;
    FeatureError::unless_equal("rotations", roots.len() * count, rotations.len())?;
    let mut places = vec![[0.0; 3]; rotations.len()];
    let rows = places.chunks_exact_mut(count);
    for ((row, root), rotations) in rows.zip(roots).zip(rotations.chunks_exact(count)) {
        row[0] = *root;
        for chain in skeleton.chains() {
            let mut turn = rotations[0];
            for [start, end] in chain {
                turn = turn * rotations[end];
                row[end] = plus(row[start], turn.rotate(offsets[end]));
            }
        }
    }
    Joints::new(places, count)
}

/// The first two columns of the rotation matrix.
pub fn to_columns(rotation: Quaternion) -> [f64; 6] {
    let [a, b, c] = rotation.rotate([1.0, 0.0, 0.0]);
    let [d, e, f] = rotation.rotate([0.0, 1.0, 0.0]);
    [a, b, c, d, e, f]
}

/// The rotation of a matrix with these first two columns, made orthonormal: the first is
/// normalized, the third is along first x second. The identity if the columns span no plane.
pub fn from_columns([a, b, c, d, e, f]: [f64; 6]) -> Quaternion {
    let first = Vector3::new(a, b, c);
    let third = first.cross(&Vector3::new(d, e, f));
    let (Some(first), Some(third)) = (first.try_normalize(0.0), third.try_normalize(0.0)) else {
        return Quaternion::IDENTITY;
    };
    let matrix = Matrix3::from_columns(&[first, third.cross(&first), third]);
    let turn = Rotation3::from_matrix_unchecked(matrix);
    let turn = UnitQuaternion::from_rotation_matrix(&turn);
    Quaternion::new(turn.w, turn.i, turn.j, turn.k)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::vector::length;

    fn vector() -> impl Strategy<Value = [f64; 3]> {
        proptest::array::uniform3(-2.0..2.0f64)
    }

    #[test]
    fn columns_without_a_plane_do_not_turn() {
        assert_eq!(from_columns([0.0; 6]), Quaternion::IDENTITY);
        let parallel = [1.0, 0.0, 0.0, 2.0, 0.0, 0.0];
        assert_eq!(from_columns(parallel), Quaternion::IDENTITY);
    }

    proptest! {
        #[test]
        fn a_rotation_returns_from_its_columns(turn in vector(), stretch in 0.1..3.0f64) {
            let rotation = Quaternion::from_rotation_vector(turn);
            let columns = to_columns(rotation).map(|value| value * stretch);
            let back = from_columns(columns);
            prop_assert!((back.dot(rotation).abs() - 1.0).abs() < 1e-9);
        }

        #[test]
        fn rotations_of_joints_give_the_joints(
            places in proptest::collection::vec(vector(), 2 * 22),
        ) {
            let skeleton = Skeleton::humanml3d();
            let joints = Joints::new(places, 22).unwrap();
            for heading in [Heading::Raw, Heading::Smoothed] {
                let rotations = inverse_kinematics(&skeleton, &joints, heading).unwrap();
                for t in 0..2 {
                    let frame = joints.frame(t);
                    let back = forward_kinematics(
                        &skeleton,
                        &skeleton.offsets_of_frame(frame),
                        &frame[..1],
                        &rotations[t * 22..(t + 1) * 22],
                    )
                    .unwrap();
                    for (a, b) in back.frame(0).iter().zip(frame) {
                        prop_assert!(length(minus(*a, *b)) < 1e-7);
                    }
                }
            }
        }
    }
}
