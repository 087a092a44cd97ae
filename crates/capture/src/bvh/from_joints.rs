//! Converting joint positions to a BVH skeleton.

use kinegrad_motion::Quaternion;
use kinegrad_motion::humanml::bone_rotations::{Across, forward};
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_motion::rotation::between;
use kinegrad_motion::vector::{length, minus};

use super::{Bvh, Joint};
use crate::Error;
use crate::error::require_positive;

/// Length of the End Site at the end of a chain, as a fraction of the last bone.
const END: f64 = 0.25;

impl Bvh {
    /// A clip of `skeleton`'s joints as a file, with `units_per_metre`: 100 for centimetres.
    ///
    /// The rest pose is the skeleton's reference pose, with the mean length of each bone in the
    /// clip. The root has the body's heading; every other bone takes the smallest rotation from its
    /// parent's orientation. A BVH joint rotates all of its bones alike, so each bone at a branch
    /// begins with an additional joint in the same place, such as `pelvis_to_left_hip`.
    ///
    /// # Errors
    /// [`Error::Features`] for joints of another skeleton; [`Error::Setting`] if `units_per_metre`
    /// is not positive, BVH cannot contain a name, or values overflow.
    pub fn from_joints(
        clip: &Joints,
        skeleton: &Skeleton,
        units_per_metre: f64,
    ) -> Result<Self, Error> {
        clip.must_be_of(skeleton)?;
        let allowed = "a positive number: 1 for metres, 100 for centimetres";
        require_positive("units_per_metre", units_per_metre, allowed)?;
        let writer = BvhWriter::new(skeleton, clip, units_per_metre);
        let frames = || (0..clip.frames()).map(|t| clip.frame(t));
        let rotations = frames().flat_map(|frame| writer.rotations(skeleton, frame));
        let rotations: Vec<Quaternion> = rotations.collect();
        let roots = frames().map(|frame| frame[0].map(|value| value * units_per_metre));
        let roots: Vec<[f64; 3]> = roots.collect();
        let frame_time = 1.0 / skeleton.description().fps;
        Self::from_rotations(&writer.joints, frame_time, &roots, &rotations)
    }
}

/// The hierarchy of a BVH file and the joints that rotate its bones.
struct BvhWriter {
    joints: Vec<Joint>,
    /// The bones in an order that begins with the root's.
    bones: Vec<Bone>,
}

/// A bone between two joints of the skeleton, and the joint of the file that rotates it.
struct Bone {
    start: usize,
    end: usize,
    turned_by: usize,
}

impl BvhWriter {
    fn new(skeleton: &Skeleton, clip: &Joints, units_per_metre: f64) -> Self {
        let names = &skeleton.description().joint_names;
        let children = |joint: usize| {
            let parents = skeleton.parents().iter();
            parents.filter(|parent| **parent == Some(joint)).count()
        };
        let mut joints = vec![Joint::new(names[0].clone(), None, [0.0; 3], None)];
        // The file index of each joint of the skeleton.
        let mut place = vec![0; skeleton.joints()];
        let mut bones = Vec::new();
        for [start, end] in skeleton.chains().flatten() {
            let mut turned_by = place[start];
            if children(start) > 1 {
                let name = format!("{}_to_{}", names[start], names[end]);
                joints.push(Joint::new(name, Some(turned_by), [0.0; 3], None));
                turned_by = joints.len() - 1;
            }
            let rest = skeleton.description().rest_offsets[end];
            let bone = |t: usize| length(minus(clip.frame(t)[end], clip.frame(t)[start]));
            let mean = (0..clip.frames()).map(bone).sum::<f64>() / clip.frames() as f64;
            let offset = rest.map(|value| value / length(rest) * mean * units_per_metre);
            let end_site = (children(end) == 0).then(|| offset.map(|value| value * END));
            place[end] = joints.len();
            let name = names[end].clone();
            joints.push(Joint::new(name, Some(turned_by), offset, end_site));
            bones.push(Bone {
                start,
                end,
                turned_by,
            });
        }
        Self { joints, bones }
    }

    /// The rotations of one frame within the parents, one for each joint of the file.
    fn rotations(&self, skeleton: &Skeleton, frame: &[[f64; 3]]) -> Vec<Quaternion> {
        let [x, _, z] = forward(skeleton, frame, Across::Consistent);
        let heading = Quaternion::from_yaw(x.atan2(z));
        let mut rotations = vec![Quaternion::IDENTITY; self.joints.len()];
        rotations[0] = heading;
        // The world rotation of the bone that ends at each joint of the skeleton.
        let mut world = vec![heading; frame.len()];
        for bone in &self.bones {
            let rest = skeleton.description().rest_offsets[bone.end];
            let direction = minus(frame[bone.end], frame[bone.start]);
            let above = world[bone.start];
            let turn = between(rest, above.conjugate().rotate(direction));
            world[bone.end] = above * turn;
            rotations[bone.turned_by] = rotations[bone.turned_by] * turn;
        }
        rotations
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A clip in which every bone keeps its length and swings by its own angles, while the body
    /// walks and turns.
    fn moving(skeleton: &Skeleton, frames: usize) -> Joints {
        let rest = &skeleton.description().rest_offsets;
        let mut places = Vec::new();
        for t in 0..frames {
            let seconds = t as f64 / skeleton.description().fps;
            let mut frame = vec![[0.3 * seconds, 0.95, seconds]; rest.len()];
            for [start, end] in skeleton.chains().flatten() {
                let swing =
                    [0, 1, 2].map(|axis| 0.35 * (3.0 * seconds + (end + axis) as f64).sin());
                let turn = Quaternion::from_yaw(0.6 * seconds - 0.4)
                    * Quaternion::from_rotation_vector(swing);
                let bone = turn.rotate(rest[end]);
                frame[end] = [0, 1, 2].map(|axis| frame[start][axis] + bone[axis]);
            }
            places.extend(frame);
        }
        Joints::new(places, rest.len()).unwrap()
    }

    #[test]
    fn a_written_clip_is_read_back_at_its_joints() {
        for skeleton in [Skeleton::humanml3d(), Skeleton::kit()] {
            let clip = moving(&skeleton, 30);
            for scale in [1.0, 100.0] {
                let text = Bvh::from_joints(&clip, &skeleton, scale).unwrap().to_text();
                let read = Bvh::parse(text.as_bytes(), "clip.bvh").unwrap();
                assert_eq!(read.frames(), clip.frames());
                assert!((1.0 / read.frame_time() - skeleton.description().fps).abs() < 1e-9);
                for (index, name) in skeleton.description().joint_names.iter().enumerate() {
                    let joint = read.joint(name).expect("every joint is in the file");
                    for t in 0..clip.frames() {
                        let found = read.world(t)[joint].position.map(|value| value / scale);
                        let apart = length(minus(found, clip.frame(t)[index]));
                        assert!(apart < 1e-5, "{name} of frame {t} is {apart} m off");
                    }
                }
            }
        }
    }

    #[test]
    fn a_scale_that_is_not_positive_is_refused() {
        let skeleton = Skeleton::humanml3d();
        let error = Bvh::from_joints(&moving(&skeleton, 2), &skeleton, 0.0).unwrap_err();
        assert!(error.to_string().contains("`units_per_metre` is 0"));
    }
}
