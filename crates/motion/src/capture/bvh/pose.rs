//! Forward kinematics: where the joints of a hierarchy are.

use super::{Bvh, Channel, Joint};
use crate::Quaternion;
use crate::capture::{CaptureError, RootPose, RootTrack, UpAxis};

impl Bvh {
    /// Place and orientation of every joint in frame `t`, `[joints]`, in the file's own units and
    /// axes.
    ///
    /// # Panics
    /// Panics if there is no frame `t`.
    pub fn world(&self, t: usize) -> Vec<RootPose> {
        let mut world: Vec<RootPose> = Vec::with_capacity(self.joints.len());
        for joint in &self.joints {
            let local = self.local(joint, t);
            world.push(match joint.parent {
                None => local,
                Some(parent) => within(world[parent], local),
            });
        }
        world
    }

    /// Place and orientation of a joint within its parent.
    fn local(&self, joint: &Joint, t: usize) -> RootPose {
        let values = &self.frame(t)[joint.first_channel..];
        let mut position = joint.offset;
        let mut orientation = Quaternion::IDENTITY;
        for (channel, value) in joint.channels.iter().zip(values) {
            match channel {
                Channel::Position(axis) => position[axis.index()] = *value,
                Channel::Rotation(axis) => {
                    let mut turn = [0.0; 3];
                    // Two full turns are the same quaternion, sign included.
                    turn[axis.index()] = (value % 720.0).to_radians();
                    orientation = orientation * Quaternion::from_rotation_vector(turn);
                }
            }
        }
        RootPose {
            position,
            orientation,
        }
    }

    /// [`world`](Self::world) of one joint, by way of its ancestors alone.
    fn world_of(&self, joint: usize, t: usize) -> RootPose {
        let mut joint = &self.joints[joint];
        let mut pose = self.local(joint, t);
        while let Some(parent) = joint.parent {
            joint = &self.joints[parent];
            pose = within(self.local(joint, t), pose);
        }
        pose
    }

    /// The way of one joint through the take, in metres and y-up, at the file's own rate.
    ///
    /// The orientation is that of the file: the identity is the joint in its rest pose, which
    /// faces +z in files that follow the convention of the phrases.
    ///
    /// # Errors
    /// [`CaptureError::InvalidSetting`] if `metres_per_unit` is not positive, there is no such
    /// joint or the frame time is out of the range of rates; [`CaptureError::NonFinite`] if a
    /// number of the file is so large that the place overflows.
    pub fn joint_track(
        &self,
        joint: usize,
        metres_per_unit: f64,
        up: UpAxis,
    ) -> Result<RootTrack, CaptureError> {
        if !(metres_per_unit.is_finite() && metres_per_unit > 0.0) {
            return Err(CaptureError::InvalidSetting {
                key: "metres_per_unit",
                found: metres_per_unit.to_string(),
                allowed: "a positive number: 0.01 for centimetres, 0.0564444 for CMU skeletons",
            });
        }
        if joint >= self.joints.len() {
            return Err(CaptureError::InvalidSetting {
                key: "joint",
                found: joint.to_string(),
                allowed: "the index of a joint of the file",
            });
        }
        let poses = (0..self.frames()).map(|t| self.world_of(joint, t));
        let (positions, orientations) = poses
            .map(|pose| {
                let metres = pose.position.map(|value| value * metres_per_unit);
                (up.to_y_up(metres), up.turn_to_y_up(pose.orientation))
            })
            .unzip();
        RootTrack::new(positions, orientations, 1.0 / self.frame_time)
    }

    /// [`joint_track`](Self::joint_track) of the root.
    ///
    /// # Errors
    /// As there.
    pub fn root_track(&self, metres_per_unit: f64, up: UpAxis) -> Result<RootTrack, CaptureError> {
        self.joint_track(0, metres_per_unit, up)
    }
}

/// A pose given within `parent`, in the frame that `parent` is given in.
fn within(parent: RootPose, local: RootPose) -> RootPose {
    let arm = parent.orientation.rotate(local.position);
    RootPose {
        position: [0, 1, 2].map(|i| parent.position[i] + arm[i]),
        orientation: parent.orientation * local.orientation,
    }
}
