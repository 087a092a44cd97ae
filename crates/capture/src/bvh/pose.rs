//! Forward kinematics: places and orientations of a hierarchy's joints.

use kinegrad_motion::Quaternion;

use super::{Bvh, Channel, Joint};
use crate::error::{require, require_positive};
use crate::{Error, RootPose, RootTrack, UpAxis};

impl Bvh {
    /// Place and orientation of every joint in frame `t`, `[joints]`, in the file's units and axes.
    ///
    /// # Panics
    /// Panics if `t` is not a frame.
    pub fn world(&self, t: usize) -> Vec<RootPose> {
        let mut world: Vec<RootPose> = Vec::with_capacity(self.joints.len());
        for (joint, local) in self.joints.iter().zip(self.local_poses(t)) {
            world.push(match joint.parent {
                None => local,
                Some(parent) => within(world[parent], local),
            });
        }
        world
    }

    /// Place and orientation of every joint within its parent in frame `t`, `[joints]`, in the file's
    /// units and axes.
    ///
    /// # Panics
    /// Panics if `t` is not a frame.
    pub fn local_poses(&self, t: usize) -> impl Iterator<Item = RootPose> {
        self.joints.iter().map(move |joint| self.local(joint, t))
    }

    /// Place and orientation of a joint within its parent.
    pub(super) fn local(&self, joint: &Joint, t: usize) -> RootPose {
        let values = &self.frame(t)[joint.first_channel..];
        let mut position = joint.offset;
        let mut orientation = Quaternion::IDENTITY;
        for (channel, value) in joint.channels.iter().zip(values) {
            match channel {
                Channel::Position(axis) => position[*axis as usize] = *value,
                Channel::Rotation(axis) => {
                    let mut turn = [0.0; 3];
                    // Two full turns are the same quaternion, sign included.
                    turn[*axis as usize] = (value % 720.0).to_radians();
                    orientation = orientation * Quaternion::from_rotation_vector(turn);
                }
            }
        }
        RootPose {
            position,
            orientation,
        }
    }

    /// The largest angle between the orientations of the trunk in neighboring frames, degrees, and
    /// the frame that the step ends in; `None` for a single frame. The trunk is the first joint of
    /// several children, or the root.
    pub fn largest_turn(&self) -> Option<(usize, f64)> {
        let mut children = vec![0; self.joints.len()];
        for parent in self.joints.iter().filter_map(|joint| joint.parent) {
            children[parent] += 1;
        }
        let trunk = children.iter().position(|&count| count > 1);
        let orientation = |t| self.world_of(trunk.unwrap_or(0), t).orientation;
        let turn = |t: usize| {
            let cosine = orientation(t - 1).dot(orientation(t)).abs();
            (t, 2.0 * cosine.min(1.0).acos().to_degrees())
        };
        (1..self.frames())
            .map(turn)
            .max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// [`world`](Self::world) of one joint, from its ancestors alone.
    fn world_of(&self, joint: usize, t: usize) -> RootPose {
        let mut joint = &self.joints[joint];
        let mut pose = self.local(joint, t);
        while let Some(parent) = joint.parent {
            joint = &self.joints[parent];
            pose = within(self.local(joint, t), pose);
        }
        pose
    }

    /// The track of one joint in metres and y-up, at the file's rate. The identity is the joint in its
    /// rest pose, which must face +z for phrases.
    ///
    /// # Errors
    /// [`Error::Setting`] if `metres_per_unit` is not positive, the joint does not exist or the frame
    /// time is out of the range of rates; [`Error::NoPose`] if a place overflows.
    pub fn joint_track(
        &self,
        joint: usize,
        metres_per_unit: f64,
        up: UpAxis,
    ) -> Result<RootTrack, Error> {
        let allowed = "a positive number: 0.01 for centimetres, 0.0564444 for CMU skeletons";
        require_positive("metres_per_unit", metres_per_unit, allowed)?;
        let allowed = "the index of a joint of the file";
        require(joint < self.joints.len(), "joint", joint, allowed)?;
        let pose = |t| {
            let pose = self.world_of(joint, t);
            let metres = pose.position.map(|value| value * metres_per_unit);
            Some(RootPose {
                position: up.to_y_up(metres),
                orientation: up.turn_to_y_up(pose.orientation),
            })
        };
        let poses = (0..self.frames()).map(pose).collect();
        RootTrack::from_poses(poses, 1.0 / self.frame_time)
    }

    /// [`joint_track`](Self::joint_track) of the root, with the same errors.
    pub fn root_track(&self, metres_per_unit: f64, up: UpAxis) -> Result<RootTrack, Error> {
        self.joint_track(0, metres_per_unit, up)
    }
}

/// A pose relative to `parent`, in the coordinates of `parent`.
fn within(parent: RootPose, local: RootPose) -> RootPose {
    let arm = parent.orientation.rotate(local.position);
    RootPose {
        position: [0, 1, 2].map(|i| parent.position[i] + arm[i]),
        orientation: parent.orientation * local.orientation,
    }
}
