//! Validation of a skeleton's description.

use super::{FeatureError, Feet, SkeletonDescription};
use crate::vector::length;

/// Tolerance of the length of raw directions.
const UNIT: f64 = 1e-6;

/// The parent of each joint by the chains, which must reach every joint once.
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
        let known = chain.len() >= 2 && chain.iter().all(|joint| *joint < joints);
        require(known, "at least two indices of `joint_names`")?;
        require(
            chain[0] == 0 || parents[chain[0]].is_some(),
            "a chain that begins at joint 0 or at a joint of an earlier chain",
        )?;
        for pair in chain.windows(2) {
            require(
                pair[1] != 0 && parents[pair[1]].is_none(),
                "after its first joint, joints that no chain has reached yet",
            )?;
            parents[pair[1]] = Some(pair[0]);
        }
    }
    let missed = (1..joints).find(|joint| parents[*joint].is_none());
    let found = format!("without joint {}", missed.unwrap_or_default());
    let allowed = "chains that reach every joint";
    require(description, missed.is_none(), "chains", found, allowed)?;
    Ok(parents)
}

/// Everything but the chains.
pub(super) fn the_rest(description: &SkeletonDescription) -> Result<(), FeatureError> {
    let joints = description.joint_names.len();
    let require =
        |sound, field: &str, found, allowed| require(description, sound, field, found, allowed);

    let fps = description.fps;
    let found = fps.to_string();
    require(
        fps.is_finite() && fps > 0.0,
        "fps",
        found,
        "a positive number",
    )?;
    let found = format!("a list of {joints}");
    require(joints >= 2, "joint_names", found, "at least two names")?;
    for (joint, name) in description.joint_names.iter().enumerate() {
        let first = description.joint_names[..joint].iter().all(|n| n != name);
        let bad = |c: char| c.is_control() || c == '{' || c == '}';
        require(
            first && !name.trim().is_empty() && !name.contains(bad),
            &format!("joint_names[{joint}]"),
            format!("`{}`", name.escape_debug()),
            "a name of one line without braces that no other joint has",
        )?;
    }

    for (field, list) in [
        ("raw_directions", &description.raw_directions),
        ("rest_offsets", &description.rest_offsets),
    ] {
        let found = format!("a list of {} for {joints} joints", list.len());
        require(list.len() == joints, field, found, "one entry a joint")?;
    }
    for joint in 1..joints {
        let direction = description.raw_directions[joint];
        require(
            (length(direction) - 1.0).abs() <= UNIT,
            &format!("raw_directions[{joint}]"),
            format!("{direction:?}"),
            "a vector of length 1",
        )?;
        let offset = description.rest_offsets[joint];
        require(
            length(offset).is_finite() && length(offset) > 0.0,
            &format!("rest_offsets[{joint}]"),
            format!("{offset:?}"),
            "a finite vector in metres that is not zero",
        )?;
    }

    let face = description.face_joints;
    let feet = description.feet;
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
    let directions = &description.raw_directions;
    let mut image: Vec<usize> = (0..directions.len()).collect();
    for (index, &[left, right]) in description.mirrored_joints.iter().enumerate() {
        let free = |joint: usize| 0 < joint && joint < image.len() && image[joint] == joint;
        require(
            description,
            left != right && free(left) && free(right),
            &format!("mirrored_joints[{index}]"),
            format!("{:?}", [left, right]),
            "two indices of `joint_names` above 0 that no other pair has",
        )?;
        image.swap(left, right);
    }
    for joint in 1..directions.len() {
        let ([x, y, z], other) = (directions[joint], directions[image[joint]]);
        require(
            description,
            length([0, 1, 2].map(|i| [-x, y, z][i] - other[i])) <= UNIT,
            &format!("raw_directions[{joint}]"),
            format!("{:?}", directions[joint]),
            "the mirror image, x negated, of that of the joint paired in `mirrored_joints`, and \
             x = 0 for a joint without a pair",
        )?;
    }
    let Feet { left, right } = description.feet;
    require(
        description,
        left.map(|joint| image[joint]) == right,
        "feet.right",
        format!("{right:?}"),
        "the joints paired in `mirrored_joints` with those of `feet.left`, in their order",
    )
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
