//! Validation of a skeleton's description.

use super::{FeatureError, Feet, SkeletonDescription};
use crate::vector::{length, minus};

/// Tolerance of the length of raw directions.
const UNIT: f64 = 1e-6;

/// The parent of each joint. The chains must reach every joint once.
pub(super) fn parents(
    description: &SkeletonDescription,
) -> Result<Vec<Option<usize>>, FeatureError> {
    let joints = description.joint_names.len();
    let mut parents: Vec<Option<usize>> = vec![None; joints];
    for (index, chain) in description.chains.iter().enumerate() {
        let require = |sound, allowed| {
            let field = format!("chains[{index}]");
            require(description, sound, &field, format!("{chain:?}"), allowed)
        };
        let inside = chain.len() >= 2 && chain.iter().all(|joint| *joint < joints);
        require(inside, "at least two indices of `joint_names`")?;
        let begins = chain[0] == 0 || parents[chain[0]].is_some();
        let allowed = "a chain that begins at joint 0 or at a joint of an earlier chain";
        require(begins, allowed)?;
        let allowed = "after its first joint, joints that no chain has reached yet";
        for pair in chain.windows(2) {
            require(pair[1] != 0 && parents[pair[1]].is_none(), allowed)?;
            parents[pair[1]] = Some(pair[0]);
        }
    }
    let missed = (1..joints).find(|joint| parents[*joint].is_none());
    let found = format!("without joint {}", missed.unwrap_or_default());
    let allowed = "chains that reach every joint";
    require(description, missed.is_none(), "chains", found, allowed)?;
    Ok(parents)
}

/// Checks everything except the chains.
pub(super) fn the_rest(description: &SkeletonDescription) -> Result<(), FeatureError> {
    let joints = description.joint_names.len();
    let require =
        |sound, field: &str, found, allowed| require(description, sound, field, found, allowed);

    let (fps, allowed) = (description.fps, "a positive number");
    let positive = fps.is_finite() && fps > 0.0;
    require(positive, "fps", fps.to_string(), allowed)?;
    let found = format!("a list of {joints}");
    require(joints >= 2, "joint_names", found, "at least two names")?;
    for (joint, name) in description.joint_names.iter().enumerate() {
        let first = description.joint_names[..joint].iter().all(|n| n != name);
        let bad = |c: char| c.is_control() || c == '{' || c == '}';
        let valid = first && !name.trim().is_empty() && !name.contains(bad);
        let field = format!("joint_names[{joint}]");
        let found = format!("`{}`", name.escape_debug());
        let allowed = "a name of one line without braces that no other joint has";
        require(valid, &field, found, allowed)?;
    }

    let (directions, offsets) = (&description.raw_directions, &description.rest_offsets);
    for (field, list) in [("raw_directions", directions), ("rest_offsets", offsets)] {
        let found = format!("a list of {} for {joints} joints", list.len());
        require(list.len() == joints, field, found, "one entry a joint")?;
    }
    for joint in 1..joints {
        let (direction, offset) = (directions[joint], offsets[joint]);
        let (field, found) = (format!("raw_directions[{joint}]"), format!("{direction:?}"));
        let unit = (length(direction) - 1.0).abs() <= UNIT;
        require(unit, &field, found, "a vector of length 1")?;
        let (field, found) = (format!("rest_offsets[{joint}]"), format!("{offset:?}"));
        let positive = length(offset).is_finite() && length(offset) > 0.0;
        let allowed = "a finite vector in metres that is not zero";
        require(positive, &field, found, allowed)?;
    }

    let (face, feet) = (description.face_joints, description.feet);
    let legs = description.leg_joints;
    for (field, joint) in [
        ("face_joints.right_hip", face.right_hip),
        ("face_joints.left_hip", face.left_hip),
        ("face_joints.right_shoulder", face.right_shoulder),
        ("face_joints.left_shoulder", face.left_shoulder),
        ("feet.left[0]", feet.left[0]),
        ("feet.left[1]", feet.left[1]),
        ("feet.right[0]", feet.right[0]),
        ("feet.right[1]", feet.right[1]),
        ("leg_joints[0]", legs[0]),
        ("leg_joints[1]", legs[1]),
    ] {
        let found = joint.to_string();
        let inside = 0 < joint && joint < joints;
        require(inside, field, found, "an index of `joint_names` above 0")?;
    }
    mirrored(description)
}

/// The two sides must be mirror images, as mirroring of features requires.
fn mirrored(description: &SkeletonDescription) -> Result<(), FeatureError> {
    let require =
        |sound, field: &str, found, allowed| require(description, sound, field, found, allowed);
    let directions = &description.raw_directions;
    let mut image: Vec<usize> = (0..directions.len()).collect();
    for (index, &[left, right]) in description.mirrored_joints.iter().enumerate() {
        let free = |joint: usize| 0 < joint && joint < image.len() && image[joint] == joint;
        let valid = left != right && free(left) && free(right);
        let field = format!("mirrored_joints[{index}]");
        let allowed = "two indices of `joint_names` above 0 that no other pair has";
        require(valid, &field, format!("{:?}", [left, right]), allowed)?;
        image.swap(left, right);
    }
    for joint in 1..directions.len() {
        let ([x, y, z], other) = (directions[joint], directions[image[joint]]);
        let symmetric = length(minus([-x, y, z], other)) <= UNIT;
        let field = format!("raw_directions[{joint}]");
        let allowed = "the mirror image, x negated, of that of the joint paired in \
                       `mirrored_joints`, and x = 0 for a joint without a pair";
        require(
            symmetric,
            &field,
            format!("{:?}", directions[joint]),
            allowed,
        )?;
    }
    let Feet { left, right } = description.feet;
    let paired = left.map(|joint| image[joint]) == right;
    let allowed =
        "the joints paired in `mirrored_joints` with those of `feet.left`, in their order";
    require(paired, "feet.right", format!("{right:?}"), allowed)
}

fn require(
    description: &SkeletonDescription,
    sound: bool,
    field: &str,
    found: String,
    allowed: &'static str,
) -> Result<(), FeatureError> {
    match sound {
        true => Ok(()),
        false => Err(FeatureError::InvalidSkeleton {
            skeleton: description.name.clone(),
            field: field.to_string(),
            found,
            allowed,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Skeleton;
    use super::*;

    #[test]
    fn mistakes_in_a_description_are_named() {
        type Spoil = fn(&mut SkeletonDescription);
        let cases: [(Spoil, &str); 14] = [
            (|s| s.fps = 0.0, "`fps` of the skeleton `humanml3d` is 0"),
            (
                |s| s.joint_names[3] = "pelvis".to_string(),
                "`joint_names[3]`",
            ),
            (|s| s.joint_names[3] = "a{".to_string(), "`joint_names[3]`"),
            (|s| s.chains[2][1] = 22, "`chains[2]`"),
            (|s| s.chains[2][1] = 1, "`chains[2]`"),
            (|s| s.chains.swap(2, 3), "`chains[2]`"),
            (|s| s.chains.truncate(4), "without joint 13"),
            (
                |s| s.raw_directions[5] = [0.0, -2.0, 0.0],
                "`raw_directions[5]`",
            ),
            (
                |s| s.raw_directions[5] = [0.0, 0.0, 1.0],
                "`raw_directions[4]`",
            ),
            (
                |s| s.rest_offsets.truncate(21),
                "`rest_offsets` of the skeleton",
            ),
            (|s| s.rest_offsets[21] = [0.0; 3], "`rest_offsets[21]`"),
            (|s| s.face_joints.left_hip = 22, "`face_joints.left_hip`"),
            (|s| s.mirrored_joints[1] = [1, 4], "`mirrored_joints[1]`"),
            (|s| s.feet.right = [11, 8], "`feet.right`"),
        ];
        for (spoil, message) in cases {
            let mut description = Skeleton::humanml3d().description().clone();
            spoil(&mut description);
            let error = Skeleton::new(description).unwrap_err().to_string();
            assert!(error.contains(message), "{error} instead of {message}");
        }
    }

    #[test]
    fn a_skeleton_is_stored_as_its_description() {
        for skeleton in [Skeleton::humanml3d(), Skeleton::kit()] {
            let json = serde_json::to_value(&skeleton).unwrap();
            assert_eq!(
                serde_json::from_value::<Skeleton>(json.clone()).unwrap(),
                skeleton
            );
            let mut spoiled = json;
            spoiled["leg_joints"][0] = 99.into();
            let error = serde_json::from_value::<Skeleton>(spoiled).unwrap_err();
            assert!(error.to_string().contains("leg_joints[0]"), "{error}");
        }
    }
}
