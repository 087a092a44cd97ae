//! Checks that motions have one skeleton and can be written with the channels of the first.

use kinegrad_capture::{Bvh, Channel, Joint, bare_name};
use kinegrad_motion::vector::length;

use super::skeleton::{hangs_alone, position_ranges, thinning};
use super::{Example, MotionMatrix};
use crate::Error;

/// Largest relative difference of frame rates.
const SAME_RATE: f64 = 0.01;
/// Largest difference of a joint offset, as a part of the longest bone. Two people differ by up to a
/// sixth; another unit or rest pose differs by more.
const SAME_BONES: f64 = 0.25;
/// Largest invisible rotation (vector part of a quaternion) and distance (scaled units).
const UNSEEN: f64 = 1e-3;

impl MotionMatrix {
    /// Checks skeleton and frame rate.
    pub(super) fn must_match(&self, example: &Example) -> Result<(), Error> {
        let (own, other) = (self.bvh.joints(), example.bvh.joints());
        let hint = "motions of one skeleton can be matched: the same joints in the same order";
        for (index, joint) in other.iter().enumerate() {
            let name = bare_name(&joint.name);
            let same = |own: &Joint| bare_name(&own.name) == name && own.parent == joint.parent;
            if !own.get(index).is_some_and(same) {
                let expected = match own.get(index) {
                    Some(own) => format!("`{}`{}", own.name, below(&self.bvh, own.parent)),
                    None => "no more joints".to_string(),
                };
                let place = below(&example.bvh, joint.parent);
                let (number, name, file) = (index + 1, &joint.name, &self.file);
                let problem = format!("joint {number} is `{name}`{place}, in {file} {expected}");
                return Err(Error::file(&example.file, problem, hint));
            }
        }
        if let Some(missing) = own.get(other.len()) {
            let problem = format!("has no joint `{}`, which {} has", missing.name, self.file);
            return Err(Error::file(&example.file, problem, hint));
        }
        let (_, frame_time) = thinning(&example.bvh);
        if (frame_time / self.frame_time - 1.0).abs() > SAME_RATE {
            let [found, own] = [frame_time, self.frame_time].map(|time| 1.0 / time);
            let problem = format!("{found:.4} frames a second, in {} {own:.4}", self.file);
            let hint = "examples have one frame rate, 30 or the same: resample the file";
            return Err(Error::file(&example.file, problem, hint));
        }
        Ok(())
    }

    /// Checks sizes and directions of bones. The root joint and its ancestors have no bones.
    pub(super) fn must_match_bones(&self, example: &Example) -> Result<(), Error> {
        let (own, other) = (bones(&self.bvh), bones(&example.bvh));
        let has_bone =
            |joint: &usize| *joint > 0 && *joint != self.root_joint && !self.is_ancestor(*joint);
        let joints: Vec<usize> = (0..own.len()).filter(has_bone).collect();
        let both = joints.iter().flat_map(|&joint| [own[joint], other[joint]]);
        let longest = both.flatten().map(length).fold(0.0, f64::max);
        for joint in joints {
            let (Some(own), Some(other)) = (own[joint], other[joint]) else {
                continue;
            };
            let apart = length([0, 1, 2].map(|axis| own[axis] - other[axis]));
            if apart > SAME_BONES * longest {
                let name = &self.joints()[joint].name;
                let [found, expected] = [other, own].map(length);
                let elsewhere = (found - expected).abs() < 0.5 * apart;
                let points = ["", " and points elsewhere"][usize::from(elsewhere)];
                let problem = format!(
                    "the bone to `{name}` is {found:.4} long{points}, in {} {expected:.4}",
                    self.file
                );
                let hint = "motions of one body can be matched, in one unit and with one rest pose: \
                            scale or retarget the file";
                return Err(Error::file(&example.file, problem, hint));
            }
        }
        Ok(())
    }

    /// Checks that the first example has channels for every joint that moves.
    pub(super) fn must_have_channels(&self, example: &Example) -> Result<(), Error> {
        let ranges = position_ranges(&example.bvh);
        for (joint, moving) in example.bvh.joints().iter().enumerate() {
            if ranges[joint] * self.scale < UNSEEN {
                continue;
            }
            let writer = match self.is_ancestor(joint) {
                true => self.root_joint,
                false => joint,
            };
            let writer = &self.joints()[writer];
            let is_missing = |channel: &Channel| {
                matches!(channel, Channel::Position(_)) && !writer.channels.contains(channel)
            };
            if moving.channels.iter().any(is_missing) {
                let problem = format!(
                    "has no position channels for `{}`, and {} moves `{}`",
                    writer.name, example.file, moving.name
                );
                let hint = "the new motion has the channels of the first example: name a file first \
                            that has them";
                return Err(Error::file(&self.file, problem, hint));
            }
        }
        Ok(())
    }

    /// Checks that no ancestor of the root joint rotates or moves; otherwise the root trajectory is
    /// not relative to the ground. `option`: the option that needs the check.
    pub(crate) fn must_have_upright_root<'a>(
        &self,
        motions: impl IntoIterator<Item = &'a Example>,
        option: &str,
    ) -> Result<(), Error> {
        let parent = self.joints()[self.root_joint].parent;
        let Some(parent) = parent.filter(|_| self.ancestors.is_empty()) else {
            return Ok(());
        };
        for motion in motions {
            let stands = |t: usize| {
                let pose = motion.bvh.world(t)[parent];
                let turn = pose.orientation;
                let moved = [0, 1, 2].map(|axis| pose.position[axis] - self.base[axis]);
                length([turn.x, turn.y, turn.z]) < UNSEEN && length(moved) * self.scale < UNSEEN
            };
            if !(0..motion.bvh.frames()).all(stands) {
                let names = [self.root_joint, parent].map(|joint| &self.joints()[joint].name);
                let [own, above] = names;
                let problem = format!("`{own}` travels within `{above}`, which turns or moves");
                let need = "needs a joint that travels over the ground: leave it out";
                let hint = format!("{option} {need}");
                return Err(Error::file(&motion.file, problem, hint));
            }
        }
        Ok(())
    }
}

/// The offset of each joint. `None` where the position changes: the offset is then not a bone, as
/// for hips that move below a root.
fn bones(bvh: &Bvh) -> Vec<Option<[f64; 3]>> {
    let (still, ranges, alone) = (bvh.locals(0), position_ranges(bvh), hangs_alone(bvh));
    let joints = bvh.joints().iter().zip(still).zip(ranges).enumerate();
    let bone = joints.map(|(index, ((joint, pose), range))| match range > 0.0 {
        false => Some(pose.position),
        true => Some(joint.offset)
            .filter(|&offset| length(offset) > 0.0 && !(alone[index] && joint.parent.is_some())),
    });
    bone.collect()
}

/// ` below `PARENT``, for messages.
fn below(bvh: &Bvh, parent: Option<usize>) -> String {
    parent.map_or(String::new(), |parent| {
        format!(" below `{}`", bvh.joints()[parent].name)
    })
}
