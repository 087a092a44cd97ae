//! A clip for the tests of this folder, with constant bone lengths.

use super::{Joints, Skeleton};
use crate::Quaternion;
use crate::vector::plus;

/// A clip of `frames` frames in which every bone swings about its rest pose while the body walks
/// and turns.
pub fn test_clip(skeleton: &Skeleton, frames: usize) -> Joints {
    let rest = &skeleton.description().rest_offsets;
    let mut values = Vec::with_capacity(frames * rest.len());
    for t in 0..frames {
        let seconds = t as f64 / skeleton.description().fps;
        let heading = Quaternion::from_yaw(0.6 * seconds - 0.4);
        let mut frame = vec![[0.3 * seconds, 0.95, seconds]; rest.len()];
        for [start, end] in skeleton.chains().flatten() {
            let swing = |axis: usize| {
                0.35 * ((2.0 + axis as f64) * seconds + (end * (axis + 2)) as f64).sin()
            };
            let turn = heading * Quaternion::from_rotation_vector([0, 1, 2].map(swing));
            frame[end] = plus(frame[start], turn.rotate(rest[end]));
        }
        values.extend(frame);
    }
    Joints::new(values, rest.len()).expect("finite joints")
}
