//! Parts of a clip as clips of their own.
//!
//! Positions, velocities and contacts are in the facing frame and do not change. Rotations are the
//! shortest rotations from raw to world directions, so they depend on the heading
//! ([`super::bone_rotations`]).

use std::ops::Range;

use super::bone_rotations::{from_columns, to_columns};
use super::{FeatureError, Features, Root, Skeleton};
use crate::Quaternion;
use crate::rotation::between;
use crate::vector::minus;

impl Features {
    /// The frames of `range` as if extraction started there. The frames are moved and rotated: the
    /// first is at x = z = 0 and faces +z. A range that already begins there does not change.
    ///
    /// # Errors
    /// [`FeatureError::LengthMismatch`] for features of another skeleton.
    pub fn crop(&self, skeleton: &Skeleton, range: Range<usize>) -> Result<Self, FeatureError> {
        skeleton.accept_layout(self.layout())?;
        let part = self.slice(range.clone());
        let facing = &self.root_quaternions()[range.clone()];
        let start = facing[0];
        let mut values = part.as_slice().to_vec();
        let layout = self.layout();
        let rows = values.chunks_exact_mut(layout.channels());
        if self.root() == Root::Absolute {
            let channels = part.root_channels();
            let [first_angle, first_x, first_z, _] = channels[0];
            for (row, [angle, x, z, _]) in rows.zip(channels) {
                let [x, _, z] = start.rotate(minus([x, 0.0, z], [first_x, 0.0, first_z]));
                (row[0], row[1], row[2]) = ((angle - first_angle) as f32, x as f32, z as f32);
            }
        }
        // If the start faces +z, nothing changes, not even by rounding.
        if start != Quaternion::IDENTITY {
            let rows = values.chunks_exact_mut(layout.channels());
            for (row, &facing) in rows.zip(facing) {
                turn_rotations(skeleton, &mut row[layout.rotations()], facing, start);
            }
        }
        Self::new(values, layout, self.root())
    }
}

/// Rotates the columns of one frame, six per joint except the root, into the world rotated by
/// `start`. `facing` is the root quaternion.
fn turn_rotations(skeleton: &Skeleton, columns: &mut [f32], facing: Quaternion, start: Quaternion) {
    let raw = &skeleton.description().raw_directions;
    let (columns, _) = columns.as_chunks_mut::<6>();
    let turned_facing = facing * start.conjugate();
    for chain in skeleton.chains() {
        // The parent bones in the old and the new world.
        let (mut above, mut turned_above) = (facing, turned_facing);
        for [_, end] in chain {
            let columns = &mut columns[end - 1];
            above = above * from_columns(columns.map(f64::from));
            let bone = between(raw[end], start.rotate(above.rotate(raw[end])));
            *columns = to_columns(turned_above.conjugate() * bone).map(|value| value as f32);
            turned_above = bone;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::walk::{Course, joints as walk};
    use super::super::{Extraction, Heading, Joints};
    use super::*;

    fn largest(a: &[f32], b: &[f32]) -> f32 {
        assert_eq!(a.len(), b.len());
        let pairs = a.iter().zip(b);
        pairs.fold(0.0, |most: f32, (a, b)| most.max((a - b).abs()))
    }

    /// A turning walk with a rotated and moved start.
    fn turning(skeleton: &Skeleton) -> Joints {
        let course = Course {
            speed: Box::new(|t| 0.9 + 0.2 * t.sin()),
            turning: Box::new(|t| 0.8 + 0.5 * (1.7 * t).cos()),
        };
        let turn = Quaternion::from_yaw(-1.9);
        let places = walk(&course, skeleton, 61).into_iter().map(|place| {
            let [x, y, z] = turn.rotate(place);
            [x - 2.0, y, z + 0.7]
        });
        Joints::new(places.collect(), skeleton.joints()).unwrap()
    }

    /// Features with the raw heading and without rescaling.
    fn extracted(skeleton: &Skeleton, joints: &Joints) -> Features {
        let extraction = Extraction {
            rescale: false,
            heading: Heading::Raw,
            ..Extraction::default()
        };
        extraction.features(skeleton, joints).unwrap()
    }

    #[test]
    fn a_part_equals_the_features_of_its_joints() {
        let skeleton = Skeleton::humanml3d();
        let joints = turning(&skeleton);
        let clip = extracted(&skeleton, &joints);
        let floor = |joints: &[[f64; 3]]| {
            let heights = joints.iter().map(|place| place[1]);
            heights.fold(f64::INFINITY, f64::min)
        };
        for range in [0..60, 13..41, 30..60, 59..60] {
            let places = &joints.as_slice()[range.start * 22..(range.end + 1) * 22];
            let part = Joints::new(places.to_vec(), 22).unwrap();
            let expected = extracted(&skeleton, &part);
            assert!((floor(places) - floor(joints.as_slice())).abs() < 1e-9);
            for root in [Root::Relative, Root::Absolute] {
                let expected = expected.with_root(root);
                let clip = clip.with_root(root);
                let found = clip.crop(&skeleton, range.clone()).unwrap();
                let apart = largest(found.as_slice(), expected.as_slice());
                assert!(apart < 1e-4, "{range:?} {root}: {apart}");
                // The part's rotations and positions give the same joints.
                let places = found.joints_from_rotations(&skeleton).unwrap().to_f32();
                let apart = largest(&places, &found.joints().to_f32());
                assert!(apart < 1e-4, "{range:?} {root}: {apart}");
                // A slice does not rotate the rotations.
                let cut = clip.slice(range.clone());
                if range.start > 0 {
                    let rotations = |features: &Features| features.frame(0)[67..193].to_vec();
                    assert!(largest(&rotations(&cut), &rotations(&found)) > 0.1);
                } else {
                    assert_eq!(found, cut);
                }
            }
        }
    }

    #[test]
    fn an_absolute_clip_is_turned_and_moved_to_its_start() {
        let skeleton = Skeleton::humanml3d();
        let clip = extracted(&skeleton, &turning(&skeleton));
        let absolute = clip.to_absolute();
        let found = absolute.crop(&skeleton, 20..33).unwrap();
        assert_eq!(found.frame(0)[..3], [0.0; 3]);
        let relative = clip.crop(&skeleton, 20..33).unwrap().to_absolute();
        assert!(largest(found.as_slice(), relative.as_slice()) < 1e-5);
        // A part of a part is a part of the clip.
        let twice = absolute.crop(&skeleton, 7..40).unwrap();
        let twice = twice.crop(&skeleton, 13..26).unwrap();
        assert!(largest(found.as_slice(), twice.as_slice()) < 1e-5);
        assert!(clip.crop(&Skeleton::kit(), 20..33).is_err());
    }
}
