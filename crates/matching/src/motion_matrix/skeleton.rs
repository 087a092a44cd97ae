//! Frame rate, size and root joint of a file.

use kinegrad_capture::{Bvh, Channel};

use kinegrad_motion::vector::length;

use super::Example;
use crate::Error;

/// Frame time in seconds below which every second frame is dropped.
const THINNED_BELOW: f64 = 0.017;
/// Largest downsampling factor.
const MOST_THINNED: usize = 1 << 20;

/// The downsampling factor and the frame time after it.
pub(crate) fn thinning(bvh: &Bvh) -> (usize, f64) {
    let mut every = 1;
    while bvh.frame_time() * (every as f64) < THINNED_BELOW && every < MOST_THINNED {
        every *= 2;
    }
    (every, bvh.frame_time() * every as f64)
}

/// The joint that moves most among the joints that carry the body: the first joints of the
/// hierarchy, and joints with most of the body below that move further than the longest bone. In a
/// chain without branches, the lowest joint that moves at least half as far is taken. `ranges`: the
/// range of each joint within its parent.
pub(super) fn root_joint(bvh: &Bvh, ranges: &[f64]) -> usize {
    let joints = bvh.joints();
    // A sliding collar bone does not carry the body, nor does a back that sways behind a pelvis.
    let mut below = vec![1; joints.len()];
    for joint in (0..joints.len()).rev() {
        if let Some(parent) = joints[joint].parent {
            below[parent] += below[joint];
        }
    }
    let bones = joints.iter().map(|joint| length(joint.offset));
    let [first, second] = bones
        .enumerate()
        .skip(1)
        .fold([(0, 0.0); 2], |[first, second], bone| {
            match bone.1 > first.1 {
                true => [bone, first],
                false if bone.1 > second.1 => [first, bone],
                false => [first, second],
            }
        });
    let longest = |without: usize| {
        if without == first.0 {
            second.1
        } else {
            first.1
        }
    };
    let alone = hangs_alone(bvh);
    let carrying = |joint: &usize| {
        alone[*joint] || 2 * below[*joint] > joints.len() && ranges[*joint] > longest(*joint)
    };
    let candidates = (0..joints.len()).filter(carrying);
    let most = candidates.clone().map(|j| ranges[j]).fold(0.0, f64::max);
    let mut joint = candidates.clone().find(|&j| ranges[j] == most).unwrap_or(0);
    // The first child of a joint follows it.
    let has_next = |joint: usize| {
        let child = joint + 1;
        joints
            .get(child)
            .is_some_and(|child| child.parent == Some(joint))
            && alone[child]
            && carrying(&child)
            && ranges[child] > 0.5 * most
    };
    while has_next(joint) {
        joint += 1;
    }
    joint
}

/// [`root_joint`] of one motion.
pub(crate) fn travelling_joint(bvh: &Bvh) -> usize {
    root_joint(bvh, &position_ranges(bvh))
}

/// [`root_joint`] of several motions with the ranges `all`, `[motions][joints]`, and `ranges` over
/// all motions. In a chain without branches, the lowest root joint has the whole trajectory.
pub(super) fn common_root_joint(bvh: &Bvh, all: &[Vec<f64>], ranges: &[f64]) -> usize {
    let own = all.iter().map(|ranges| root_joint(bvh, ranges));
    own.fold(root_joint(bvh, ranges), |joint, own| {
        match ancestors(bvh, own).contains(&joint) {
            true => own,
            false => joint,
        }
    })
}

/// The ancestors of a joint, its parent first; empty if an ancestor has another child.
pub(super) fn ancestors(bvh: &Bvh, joint: usize) -> Vec<usize> {
    let joints = bvh.joints();
    match hangs_alone(bvh)[joint] {
        true => {
            std::iter::successors(joints[joint].parent, |&parent| joints[parent].parent).collect()
        }
        false => Vec::new(),
    }
}

/// True for each joint whose ancestors have one child each.
pub(super) fn hangs_alone(bvh: &Bvh) -> Vec<bool> {
    let joints = bvh.joints();
    let mut children = vec![0; joints.len()];
    for parent in joints.iter().filter_map(|joint| joint.parent) {
        children[parent] += 1;
    }
    let mut alone = vec![true; joints.len()];
    for (index, joint) in joints.iter().enumerate() {
        alone[index] = joint
            .parent
            .is_none_or(|parent| alone[parent] && children[parent] == 1);
    }
    alone
}

/// The scale factor of lengths. The offset of the root joint is not a bone, but the published
/// program counts the offset of joint 0.
pub(super) fn scale(example: &Example, root_joint: usize) -> Result<f64, Error> {
    let joints = example.bvh.joints().iter().enumerate();
    let bones = joints.filter(|&(index, _)| index == 0 || index != root_joint);
    let offsets = bones.flat_map(|(_, joint)| {
        let ends = joint.end_sites.iter().copied();
        ends.chain([joint.offset])
    });
    let largest = offsets.flatten().fold(0.0f64, |most, v| most.max(v.abs()));
    if largest == 0.0 || !largest.ceil().is_finite() {
        let problem = "every bone has the length 0, allowed: at least one OFFSET that is not 0";
        let hint = "motions are scaled by the longest bone: export the skeleton with its offsets";
        return Err(Error::file(&example.file, problem, hint));
    }
    Ok(1.0 / largest.ceil())
}

/// The range of each joint's position within its parent, in file units: the largest over the axes.
pub(super) fn position_ranges(bvh: &Bvh) -> Vec<f64> {
    let mut travel = vec![0.0; bvh.joints().len()];
    let mut first = 0;
    for (joint, travel) in bvh.joints().iter().zip(&mut travel) {
        for (place, channel) in joint.channels.iter().enumerate() {
            if matches!(channel, Channel::Position(_)) {
                let values = (0..bvh.frames()).map(|t| bvh.frame(t)[first + place]);
                let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |range, v| {
                    (range.0.min(v), range.1.max(v))
                });
                *travel = f64::max(*travel, high - low);
            }
        }
        first += joint.channels.len();
    }
    travel
}
