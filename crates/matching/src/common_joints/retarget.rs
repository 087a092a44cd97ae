//! Motions of one skeleton on the joints and bones of another.

use std::collections::HashMap;

use kinegrad_capture::{Bvh, Joint, RootPose, UpAxis};
use kinegrad_motion::Quaternion;
use kinegrad_motion::rotation::between;
use kinegrad_motion::vector::{dot, length, minus, plus, unit};

use super::furthest_end;
use crate::{Error, Example, feet};

/// Largest angle of two rest poses that is taken for a difference between bodies, degrees. Beyond
/// it, the files have other conventions for the axes of a joint.
const SAME_AXES: f64 = 60.0;
/// Part of the frames that may be below the floor.
const BELOW_FLOOR: f64 = 0.05;
/// Steps of the fit of a rotation to several directions.
const FIT_STEPS: usize = 100;

/// A motion and its joints that correspond to those of the target, by index, in its order.
pub(super) struct Skeleton<'a> {
    example: &'a Example,
    joints: Vec<usize>,
    /// The places of all joints without rotations, in file units.
    rest: Vec<[f64; 3]>,
}

impl<'a> Skeleton<'a> {
    pub fn new(example: &'a Example, joints: Vec<usize>) -> Self {
        let mut rest: Vec<[f64; 3]> = Vec::new();
        for (joint, pose) in example.bvh.joints().iter().zip(example.bvh.local_poses(0)) {
            let above = joint.parent.map_or([0.0; 3], |parent| rest[parent]);
            rest.push(plus(above, pose.position));
        }
        Self {
            example,
            joints,
            rest,
        }
    }

    /// The bone between two joints of the target, without rotations.
    fn bone(&self, from: usize, to: usize) -> [f64; 3] {
        minus(self.rest[self.joints[to]], self.rest[self.joints[from]])
    }

    /// World poses of the joints, `[frames][joints]`.
    fn world(&self) -> impl Iterator<Item = Vec<RootPose>> {
        let bvh = &self.example.bvh;
        (0..bvh.frames()).map(|t| {
            let world = bvh.world(t);
            self.joints.iter().map(|&joint| world[joint]).collect()
        })
    }

    /// The mean rotation of each joint within its parent in the target.
    fn mean_turns(&self, parents: &[Option<usize>]) -> Vec<Quaternion> {
        let none = Quaternion::new(0.0, 0.0, 0.0, 0.0);
        let mut sums = vec![none; parents.len()];
        for world in self.world() {
            for (joint, sum) in sums.iter_mut().enumerate() {
                let own = world[joint].orientation;
                let turn = match parents[joint] {
                    Some(parent) => world[parent].orientation.conjugate() * own,
                    None => own,
                };
                let turn = turn.nearer_to(*sum);
                *sum = Quaternion::new(
                    sum.w + turn.w,
                    sum.x + turn.x,
                    sum.y + turn.y,
                    sum.z + turn.z,
                );
            }
        }
        sums.into_iter().map(Quaternion::normalised).collect()
    }
}

/// The common joints, with the bones of the first example.
pub(super) struct CommonSkeleton {
    /// Joints with their bones as offsets; the root is first.
    joints: Vec<Joint>,
    parents: Vec<Option<usize>>,
    feet: Vec<usize>,
}

impl CommonSkeleton {
    /// The skeleton of some joints of the first example, in file order.
    ///
    /// # Errors
    /// Fails if no joint is above all others.
    pub fn new(first: &Example, common: &[usize]) -> Result<Self, Error> {
        let own = Skeleton::new(first, common.to_vec());
        let all = first.bvh.joints();
        let parents = nearest_above(all, common);
        let mut joints: Vec<Joint> = Vec::with_capacity(common.len());
        for (place, (&joint, parent)) in common.iter().zip(&parents).enumerate() {
            if parent.is_none() && place > 0 {
                let [top, other] = [common[0], joint].map(|joint| &all[joint].name);
                let problem = format!(
                    "no common joint is above all others: `{top}` and `{other}` are the highest"
                );
                let hint =
                    "give the joint above both its name in the other files, option `joint_map`";
                return Err(Error::file(&first.file, problem, hint));
            }
            let offset = parent.map_or([0.0; 3], |parent| own.bone(parent, place));
            let is_leaf = !parents.contains(&Some(place));
            let end = furthest_end(&first.bvh, &own.rest, joint).filter(|_| is_leaf);
            joints.push(Joint::new(all[joint].name.clone(), *parent, offset, end));
        }
        let feet = feet(&joints);
        Ok(Self {
            joints,
            parents,
            feet,
        })
    }

    /// Checks that joints that are below each other are so in `source` as well.
    pub fn must_have_order_of(&self, source: &Skeleton<'_>, first: &Example) -> Result<(), Error> {
        let found = nearest_above(source.example.bvh.joints(), &source.joints);
        for (place, (own, found)) in self.parents.iter().zip(&found).enumerate() {
            if own != found {
                let all = source.example.bvh.joints();
                let name = |place: usize| format!("`{}`", all[source.joints[place]].name);
                let below = found.map_or("no common joint".to_string(), name);
                let own = own.map(|parent| format!("`{}`", self.joints[parent].name));
                let problem = format!(
                    "{} is below {below}, in {} `{}` is below {}",
                    name(place),
                    first.file,
                    self.joints[place].name,
                    own.unwrap_or("no common joint".to_string())
                );
                let hint = format!(
                    "leave it out, or name another joint, with option `joint_map`: `{} = []`",
                    self.joints[place].name
                );
                return Err(Error::file(&source.example.file, problem, hint));
            }
        }
        Ok(())
    }

    /// A motion of the first example's skeleton on the common joints alone.
    pub fn reduce(&self, source: &Skeleton<'_>) -> Result<Bvh, Error> {
        let none = vec![Quaternion::IDENTITY; self.joints.len()];
        self.posed(source, &none, |place| place)
    }

    /// A motion of another skeleton on these joints: with the directions of its bones, its size
    /// scaled to these bones, and its floor at that of `first`.
    pub fn retarget(
        &self,
        source: &Skeleton<'_>,
        first: &Skeleton<'_>,
        up: UpAxis,
    ) -> Result<Bvh, Error> {
        let corrections = self.corrections(source, first);
        let scale = self.scale(source);
        let scaled = |place: [f64; 3]| place.map(|value| scale * value);
        let bvh = self.posed(source, &corrections, scaled)?;
        let rise = floor(&self.reduce(first)?, up) - floor(&bvh, up);
        let axis = match up {
            UpAxis::Y => 1,
            UpAxis::Z => 2,
        };
        self.posed(source, &corrections, |place| {
            let mut place = scaled(place);
            place[axis] += rise;
            place
        })
    }

    /// The motion of `source` with the rotation `corrections` of the rest poses.
    fn posed(
        &self,
        source: &Skeleton<'_>,
        corrections: &[Quaternion],
        place: impl Fn([f64; 3]) -> [f64; 3],
    ) -> Result<Bvh, Error> {
        let (mut roots, mut rotations) = (Vec::new(), Vec::new());
        for world in source.world() {
            roots.push(place(world[0].position));
            let turns = world.iter().zip(corrections);
            let turns: Vec<Quaternion> = turns.map(|(pose, by)| pose.orientation * *by).collect();
            let within = |(own, parent): (&Quaternion, &Option<usize>)| match parent {
                Some(parent) => turns[*parent].conjugate() * *own,
                None => *own,
            };
            rotations.extend(turns.iter().zip(&self.parents).map(within));
        }
        let frame_time = source.example.bvh.frame_time();
        Ok(Bvh::from_rotations(
            &self.joints,
            frame_time,
            &roots,
            &rotations,
        )?)
    }

    /// The ratio of sizes: of the chains above the feet, or of all bones without feet.
    fn scale(&self, source: &Skeleton<'_>) -> f64 {
        let legs = self
            .feet
            .iter()
            .flat_map(|&foot| std::iter::successors(Some(foot), |&joint| self.parents[joint]));
        let legs: Vec<usize> = legs.collect();
        let counted = match legs.is_empty() {
            true => (0..self.joints.len()).collect(),
            false => legs,
        };
        let bones = counted.iter().filter_map(|&to| {
            let from = self.parents[to]?;
            let own = length(self.joints[to].offset);
            Some([own, length(source.bone(from, to))])
        });
        let [own, other] = bones.fold([0.0; 2], plus);
        if own > 0.0 && other > 0.0 {
            own / other
        } else {
            1.0
        }
    }

    /// The rotation of each joint from the rest pose of these bones to that of `source`: its bones
    /// then have the directions of the source's. Joints of several bones and feet are rotated with
    /// the bone above, unless the axes of the files differ: the rotation that fits the directions
    /// best, and a mean rotation as in `first` where directions do not determine it.
    fn corrections(&self, source: &Skeleton<'_>, first: &Skeleton<'_>) -> Vec<Quaternion> {
        let means = [source, first].map(|skeleton| skeleton.mean_turns(&self.parents));
        let mut corrections: Vec<Quaternion> = Vec::with_capacity(self.joints.len());
        let mut differs = vec![false; self.joints.len()];
        for joint in 0..self.joints.len() {
            let parent = self.parents[joint];
            let base = parent.map_or(Quaternion::IDENTITY, |parent| corrections[parent]);
            let children =
                (0..self.joints.len()).filter(|&child| self.parents[child] == Some(joint));
            let bones =
                children.map(|child| (self.joints[child].offset, source.bone(joint, child)));
            let bones: Vec<[[f64; 3]; 2]> = bones
                .filter(|(own, other)| length(*own) > 0.0 && length(*other) > 0.0)
                .map(|(own, other)| [unit(base.rotate(own)), unit(other)])
                .collect();
            let angles = bones
                .iter()
                .map(|[own, other]| dot(*own, *other).clamp(-1.0, 1.0).acos());
            let angle = angles.sum::<f64>().to_degrees() / bones.len().max(1) as f64;
            let is_foot = self.feet.contains(&joint);
            differs[joint] =
                angle > SAME_AXES && !is_foot || parent.is_some_and(|parent| differs[parent]);
            let mut correction = match (&bones[..], parent) {
                (&[[own, other]], _) if !is_foot => between(own, other) * base,
                (bones, _) if angle > SAME_AXES && !is_foot => fitted(bones) * base,
                _ => base,
            };
            if let Some(parent) = parent.filter(|_| differs[joint]) {
                let turned = corrections[parent].conjugate() * means[0][joint] * correction;
                let rest = turned.conjugate() * means[1][joint];
                correction = match &bones[..] {
                    [_] if !is_foot => {
                        let bone = correction.conjugate().rotate(bones[0][1]);
                        correction * twist_about(rest, bone)
                    }
                    [_, _, ..] => correction,
                    _ => correction * rest,
                };
            }
            corrections.push(correction);
        }
        corrections
    }
}

/// The nearest of some joints above each of them, as places among them.
fn nearest_above(all: &[Joint], some: &[usize]) -> Vec<Option<usize>> {
    let places: HashMap<usize, usize> = some.iter().enumerate().map(|(i, &j)| (j, i)).collect();
    // Of each joint, the nearest of them at or above it.
    let mut at: Vec<Option<usize>> = Vec::with_capacity(all.len());
    let mut above = vec![None; some.len()];
    for (index, joint) in all.iter().enumerate() {
        let nearest = joint.parent.and_then(|parent| at[parent]);
        let own = places.get(&index).copied();
        if let Some(place) = own {
            above[place] = nearest;
        }
        at.push(own.or(nearest));
    }
    above
}

/// The rotation of unit vectors, `[from, to]`, that minimises the sum of their squared distances:
/// the eigenvector of the largest eigenvalue of Davenport's matrix, by iteration from the rotation
/// of the first pair.
fn fitted(pairs: &[[[f64; 3]; 2]]) -> Quaternion {
    let [from, to] = pairs[0];
    let mut best = between(from, to);
    for _ in 0..FIT_STEPS {
        let mut sum = best.scale(pairs.len() as f64);
        for &[from, to] in pairs {
            let [from, to] = [from, to].map(|[x, y, z]| Quaternion::new(0.0, x, y, z));
            // The quadratic form of q is to . (q from q*).
            let turned = (to * best * from).scale(-1.0);
            sum = Quaternion::new(
                sum.w + turned.w,
                sum.x + turned.x,
                sum.y + turned.y,
                sum.z + turned.z,
            );
        }
        best = sum.normalised();
    }
    best
}

/// The part of a rotation about a unit vector.
fn twist_about(rotation: Quaternion, axis: [f64; 3]) -> Quaternion {
    let along = dot([rotation.x, rotation.y, rotation.z], axis);
    if rotation.w == 0.0 && along == 0.0 {
        return Quaternion::IDENTITY;
    }
    let [x, y, z] = axis.map(|value| along * value);
    Quaternion::new(rotation.w, x, y, z).normalised()
}

/// The height of the lowest joint, apart from the frames that are lowest.
fn floor(bvh: &Bvh, up: UpAxis) -> f64 {
    let lowest = (0..bvh.frames()).map(|t| {
        let heights = bvh
            .world(t)
            .into_iter()
            .map(|pose| up.to_y_up(pose.position)[1]);
        heights.fold(f64::INFINITY, f64::min)
    });
    let mut lowest: Vec<f64> = lowest.collect();
    lowest.sort_unstable_by(f64::total_cmp);
    lowest[(BELOW_FLOOR * lowest.len() as f64) as usize]
}
