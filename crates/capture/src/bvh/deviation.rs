//! The joints of a file that was made from a clip, and their distances from the clip's joints.

use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_motion::vector::{length, minus};

use super::Bvh;

/// The joint with the largest distance from its place in a clip.
#[derive(Clone, Debug, PartialEq)]
pub struct Deviation {
    /// Distance, metres.
    pub metres: f64,
    /// Its name.
    pub joint: String,
    /// The frame.
    pub frame: usize,
}

impl Bvh {
    /// The joints of `skeleton` in the file, in metres, as [`Bvh::from_joints`] wrote them. None if one
    /// is missing or not finite.
    pub fn joints_of(&self, skeleton: &Skeleton, units_per_metre: f64) -> Option<Joints> {
        let names = skeleton.description().joint_names.iter();
        let places: Option<Vec<usize>> = names.map(|name| self.joint(name)).collect();
        let places = places?;
        let frames = (0..self.frames()).flat_map(|t| {
            let world = self.world(t);
            let place = |&joint: &usize| world[joint].position.map(|v| v / units_per_metre);
            places.iter().map(place).collect::<Vec<_>>()
        });
        Joints::new(frames.collect(), places.len()).ok()
    }

    /// The largest distance of a joint from the same joint of the `clip` that [`Bvh::from_joints`]
    /// wrote. None if a frame or a joint is missing.
    pub fn deviation(
        &self,
        clip: &Joints,
        skeleton: &Skeleton,
        units_per_metre: f64,
    ) -> Option<Deviation> {
        let found = self.joints_of(skeleton, units_per_metre)?;
        let names = &skeleton.description().joint_names;
        let mut worst: Option<Deviation> = None;
        let places = found.as_slice().iter().zip(clip.as_slice()).enumerate();
        for (index, (found, place)) in places {
            let metres = length(minus(*found, *place));
            if worst.as_ref().is_none_or(|worst| metres > worst.metres) {
                worst = Some(Deviation {
                    metres,
                    joint: names[index % names.len()].clone(),
                    frame: index / names.len(),
                });
            }
        }
        worst.filter(|_| clip.frames() == found.frames())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bone_that_grows_in_a_frame_is_named() {
        let skeleton = Skeleton::humanml3d();
        let rest = &skeleton.description().rest_offsets;
        let mut frame = vec![[0.0, 0.95, 0.0]; rest.len()];
        for [start, end] in skeleton.chains().flatten() {
            frame[end] = [0, 1, 2].map(|axis| frame[start][axis] + rest[end][axis]);
        }
        let mut places: Vec<[f64; 3]> = (0..4).flat_map(|_| frame.clone()).collect();
        let deviation = |places: &[[f64; 3]]| {
            let clip = Joints::new(places.to_vec(), rest.len()).unwrap();
            let bvh = Bvh::from_joints(&clip, &skeleton, 100.0).unwrap();
            bvh.deviation(&clip, &skeleton, 100.0).unwrap()
        };
        assert!(deviation(&places).metres < 1e-6);
        // The left wrist, the end of a chain, is 40 cm further along its bone in one of four frames;
        // the bone is 10 cm too long in the others, and 30 cm too short in this one.
        let (wrist, elbow) = (20, 18);
        let bone = minus(frame[wrist], frame[elbow]);
        let at = 2 * rest.len() + wrist;
        places[at] = [0, 1, 2].map(|axis| frame[wrist][axis] + 0.4 * bone[axis] / length(bone));
        let found = deviation(&places);
        assert!((found.metres - 0.3).abs() < 1e-4, "{found:?}");
        assert_eq!((found.joint.as_str(), found.frame), ("left_wrist", 2));
    }
}
