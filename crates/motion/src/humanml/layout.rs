//! The channel layout of joint features, for any number of joints.
//!
//! Source: HumanML3D (docs/sources.md, section 3.1).

use std::ops::Range;

use kinegrad_settings::{Refused, in_range};
use serde::{Deserialize, Serialize};

use super::FeatureError;

/// Numbers of a joint's position or velocity.
const VECTOR: usize = 3;
/// Numbers of a joint's rotation: the first two columns of the matrix.
const ROTATION: usize = 6;
/// Contact flags: two joints of each foot.
const CONTACTS: usize = 4;

/// The channels of one frame of features of a skeleton with J joints:
///
/// | range (J = 22) | content |
/// |---|---|
/// | 0 | root rotation: half the change of yaw to the next frame, radians, sign reversed; with absolute root half the yaw itself, sign reversed |
/// | 1..3 | root ground velocity (x, z) to the next frame in the next frame's facing frame, metres; with absolute root the place on the ground |
/// | 3 | root height, metres |
/// | 4..67 | positions of joints 1 to J-1 in the facing frame, height above the floor, metres |
/// | 67..193 | rotations of joints 1 to J-1: first, then second column of the matrix |
/// | 193..259 | displacements of joints 0 to J-1 to the next frame in the facing frame, metres |
/// | 259..263 | contact flags: two joints of the left foot, then of the right |
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize)]
pub struct FeatureLayout {
    joints: usize,
}

impl FeatureLayout {
    /// Channels of the root: rotation, ground x, ground z, height.
    pub const ROOT: Range<usize> = 0..4;

    /// The layout of a skeleton with `joints` joints.
    ///
    /// # Errors
    /// [`FeatureError::Setting`] for fewer than two joints.
    pub fn of_joints(joints: usize) -> Result<Self, FeatureError> {
        in_range("joints", joints, 2..).hint("the root and one that it moves")?;
        Ok(Self { joints })
    }

    /// The layout of frames with `channels` channels.
    ///
    /// # Errors
    /// [`FeatureError::InvalidChannels`] if no skeleton has this number of channels.
    pub fn of_channels(channels: usize) -> Result<Self, FeatureError> {
        let joints = channels.saturating_add(1) / 12;
        Self::of_joints(joints)
            .ok()
            .filter(|layout| layout.channels() == channels)
            .ok_or(FeatureError::InvalidChannels { found: channels })
    }

    /// Number of joints, the root included.
    pub fn joints(self) -> usize {
        self.joints
    }

    /// Number of channels: 12 J - 1.
    pub fn channels(self) -> usize {
        self.contacts().end
    }

    /// Channels of the positions of joints 1 to J-1.
    pub fn positions(self) -> Range<usize> {
        follow(Self::ROOT, (self.joints - 1) * VECTOR)
    }

    /// Channels of the rotations of joints 1 to J-1.
    pub fn rotations(self) -> Range<usize> {
        follow(self.positions(), (self.joints - 1) * ROTATION)
    }

    /// Channels of the displacements of joints 0 to J-1.
    pub fn velocities(self) -> Range<usize> {
        follow(self.rotations(), self.joints * VECTOR)
    }

    /// Channels of the contact flags.
    pub fn contacts(self) -> Range<usize> {
        follow(self.velocities(), CONTACTS)
    }

    /// The seven groups that share one deviation in normalization: root rotation, ground, height,
    /// positions, rotations, velocities, contacts (docs/sources.md, section 3.5).
    pub fn groups(self) -> [Range<usize>; 7] {
        [
            0..1,
            1..3,
            3..4,
            self.positions(),
            self.rotations(),
            self.velocities(),
            self.contacts(),
        ]
    }

    /// Joint and published component name of channel `index`; root and contacts have no joint.
    pub(super) fn channel(self, index: usize) -> (Option<usize>, &'static str) {
        assert!(index < self.channels(), "channel {index} does not exist");
        let columns = [
            "rot6d_m00",
            "rot6d_m10",
            "rot6d_m20",
            "rot6d_m01",
            "rot6d_m11",
            "rot6d_m21",
        ];
        let groups: [(_, _, &[&str]); 3] = [
            (self.positions(), 1, &["ric_x", "ric_y", "ric_z"]),
            (self.rotations(), 1, &columns),
            (self.velocities(), 0, &["vel_x", "vel_y", "vel_z"]),
        ];
        for (range, first_joint, components) in groups {
            if range.contains(&index) {
                let (place, width) = (index - range.start, components.len());
                return (Some(first_joint + place / width), components[place % width]);
            }
        }
        let root = ["rot_half_vel_y", "lin_vel_x", "lin_vel_z", "height_y"];
        (None, root.get(index).unwrap_or(&"contact"))
    }

    /// Name of channel `index`: `root.height_y`, `joint_3.ric_x` or `contact_0`.
    pub fn channel_name(self, index: usize) -> String {
        let (joint, component) = self.channel(index);
        match joint {
            Some(joint) => format!("joint_{joint}.{component}"),
            None if self.contacts().contains(&index) => {
                format!("{component}_{}", index - self.contacts().start)
            }
            None => format!("root.{component}"),
        }
    }
}

/// The next `width` channels after `range`.
fn follow(range: Range<usize>, width: usize) -> Range<usize> {
    range.end..range.end + width
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_published_datasets_have_263_and_251_channels() {
        let layout = FeatureLayout::of_joints(22).unwrap();
        assert_eq!(layout.channels(), 263);
        assert_eq!(
            [layout.positions(), layout.rotations(), layout.velocities()],
            [4..67, 67..193, 193..259]
        );
        assert_eq!(FeatureLayout::of_joints(21).unwrap().channels(), 251);
        assert_eq!(layout.channel_name(3), "root.height_y");
        assert_eq!(layout.channel_name(12), "joint_3.ric_z");
        assert_eq!(layout.channel_name(262), "contact_3");
    }

    proptest! {
        #[test]
        fn any_number_of_joints_is_found_again_and_its_groups_adjoin(joints in 2usize..200) {
            let layout = FeatureLayout::of_joints(joints).unwrap();
            let channels = layout.channels();
            prop_assert_eq!(channels, 4 + 3 * (joints - 1) + 6 * (joints - 1) + 3 * joints + 4);
            prop_assert_eq!(FeatureLayout::of_channels(channels), Ok(layout));
            let groups = layout.groups();
            prop_assert_eq!(groups[0].start, 0);
            prop_assert_eq!(groups[6].end, channels);
            for pair in groups.windows(2) {
                prop_assert_eq!(pair[0].end, pair[1].start);
            }
            for other in 1..12 {
                prop_assert!(FeatureLayout::of_channels(channels + other).is_err());
            }
        }
    }
}
