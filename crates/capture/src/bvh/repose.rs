//! Other motions of a file's own hierarchy.

use super::{Axis, Bvh, Channel, Joint, euler};
use crate::error::{require, require_positive};
use crate::{Error, RootPose};

impl Bvh {
    /// Like [`world`](Self::world), but relative to the parents.
    ///
    /// # Panics
    /// Panics if `t` is not a frame.
    pub fn locals(&self, t: usize) -> Vec<RootPose> {
        let joints = self.joints.iter();
        joints.map(|joint| self.local(joint, t)).collect()
    }

    /// The same joints and channels with the motion `locals`, `[frames, joints]` row by row, as
    /// [`locals`](Self::locals) returns them. Positions and rotations without a channel are dropped.
    /// Angles are unwrapped from frame to frame, the first from this file's first frame.
    ///
    /// # Errors
    /// [`Error::Setting`] for a frame time that is not positive, an empty motion, an incomplete
    /// frame, or a value that is not finite.
    pub fn reposed(&self, frame_time: f64, locals: &[RootPose]) -> Result<Self, Error> {
        let allowed = "a positive number of seconds: 0.05 for 20 frames per second";
        require_positive("frame_time", frame_time, allowed)?;
        let joints = self.joints.len();
        let complete = !locals.is_empty() && locals.len().is_multiple_of(joints);
        let found = format!("a list of {} for {joints} joints", locals.len());
        require(
            complete,
            "locals",
            found,
            "one pose for each joint and frame",
        )?;
        let numbers = |pose: &RootPose| pose.position.into_iter().chain([pose.orientation.norm()]);
        let finite = locals.iter().flat_map(numbers).all(f64::is_finite);
        require(finite, "locals", "not finite", "finite numbers")?;
        let mut values: Vec<f64> = Vec::with_capacity(locals.len() / joints * self.channels);
        let mut before = self.frame(0).to_vec();
        for frame in locals.chunks_exact(joints) {
            for (joint, pose) in self.joints.iter().zip(frame) {
                let range = joint.first_channel..joint.first_channel + joint.channels.len();
                write(joint, pose, &mut before[range]);
            }
            values.extend(&before);
        }
        Ok(Self {
            frame_time,
            values,
            frames_beyond: 0,
            milliseconds: None,
            ..self.clone()
        })
    }
}

/// Writes a pose over the joint's channels of the frame before.
fn write(joint: &Joint, pose: &RootPose, channels: &mut [f64]) {
    let mut turns: Vec<(Axis, usize)> = Vec::with_capacity(3);
    for (place, channel) in joint.channels.iter().enumerate() {
        match channel {
            Channel::Position(axis) => channels[place] = pose.position[*axis as usize],
            Channel::Rotation(axis) => turns.push((*axis, place)),
        }
    }
    if turns.is_empty() {
        return;
    }
    let mut axes: Vec<Axis> = turns.iter().map(|(axis, _)| *axis).collect();
    for axis in [Axis::X, Axis::Y, Axis::Z] {
        if !axes.contains(&axis) {
            axes.push(axis);
        }
    }
    let axes = [axes[0], axes[1], axes[2]];
    let mut before = [0.0; 3];
    for (before, (_, place)) in before.iter_mut().zip(&turns) {
        *before = channels[*place];
    }
    let angles = euler::degrees(pose.orientation, axes, before);
    for ((_, place), angle) in turns.into_iter().zip(angles) {
        channels[place] = angle;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "HIERARCHY\nROOT a\n{\nOFFSET 0 3 0\n\
        CHANNELS 6 Zrotation Yrotation Xrotation Xposition Yposition Zposition\n\
        JOINT b\n{\nOFFSET 1 0 0\nCHANNELS 1 Yrotation\n\
        JOINT c\n{\nOFFSET 0 1 0\nCHANNELS 6 Xposition Yposition Zposition Yrotation Xrotation \
        Zrotation\nEnd Site\n{\nOFFSET 0 1 0\n}\n}\n}\n}\nMOTION\nFrames: 2\nFrame Time: 0.01\n\
        10 200 30 1 2 3 40 0.1 0.9 0 5 6 7\n14 190 20 1 2 4 50 0.1 1.1 0 -5 89 7\n";

    #[test]
    fn a_motion_is_written_in_its_own_channels() {
        let read = Bvh::parse(TEXT.as_bytes(), "a.bvh").unwrap();
        let locals = [read.locals(0), read.locals(1)].concat();
        let back = read.reposed(0.02, &locals).unwrap();
        assert_eq!(back.joints(), read.joints());
        assert_eq!(back.frame_time(), 0.02);
        for t in 0..2 {
            for (found, value) in back.frame(t).iter().zip(read.frame(t)) {
                assert!((found - value).abs() < 1e-9, "{found} {value}");
            }
        }
        let reversed = [read.locals(1), read.locals(0), read.locals(1)].concat();
        assert_eq!(read.reposed(0.02, &reversed).unwrap().frames(), 3);
        let error = read.reposed(0.02, &locals[1..]).unwrap_err().to_string();
        assert!(error.contains("a list of 5 for 3 joints"), "{error}");
        assert!(read.reposed(0.0, &locals).is_err() && read.reposed(0.02, &[]).is_err());
    }
}
