//! Motions of any skeleton as matrices, and back to BVH.
//!
//! A frame contains, in this order:
//! - the local rotation of each joint as six numbers ([`rotation6d`](crate::rotation6d));
//! - the local position of each joint, except the root joint, whose position changes;
//! - the contact of each foot, in the first of six channels;
//! - optionally the change of heading; root rotation and displacement are then relative to the
//!   heading;
//! - the root trajectory: absolute height and horizontal displacement from the frame before.
//!
//! Lengths are scaled by 1 / ceil(largest component of an offset). Source: GenMM;
//! docs/sources/genmm.md.

use kinegrad_capture::{Axis, Bvh, RootPose, UpAxis};
use kinegrad_motion::Quaternion;
use kinegrad_motion::vector::length;

use crate::{Error, Frames, displacements, rotation6d};

mod compatibility;
mod root_trajectory;
mod root_warp;
mod skeleton;

use skeleton::{ancestors, common_root_joint, position_ranges, scale};
pub(crate) use skeleton::{thinning, travelling_joint};

/// Channels of a rotation.
const ROTATION: usize = 6;
/// Speed in scaled units a frame below which a foot is in contact.
const CONTACT: f64 = 0.018;
/// Largest change of a position due to rounding, in scaled units.
const STILL: f64 = 1e-5;

/// An example motion.
#[derive(Clone, Debug)]
pub struct Example {
    /// Its file, for messages.
    pub file: String,
    /// The motion.
    pub bvh: Bvh,
}

/// Options of a [`MotionMatrix`].
#[derive(Clone, Debug, Default)]
pub struct MatrixOptions {
    /// The axis that points up in the files.
    pub up: UpAxis,
    /// Indices of the joints whose ground contact is matched as well.
    pub contacts: Vec<usize>,
    /// Makes the root relative to its heading, so that a walk north equals a walk east. The
    /// published program uses world coordinates.
    pub heading: bool,
}

/// The layout of the motions of one skeleton as matrices.
#[derive(Clone, Debug)]
pub struct MotionMatrix {
    /// File of the first example, for messages.
    pub(crate) file: String,
    bvh: Bvh,
    pub(crate) up: Axis,
    scale: f64,
    frame_time: f64,
    /// The joint whose trajectory carries the body.
    pub(crate) root_joint: usize,
    /// Joints above the root joint, if they have no other descendants.
    ancestors: Vec<usize>,
    /// Position of the unrotated ancestors in a new motion.
    base: [f64; 3],
    /// The joints whose position changes, in order.
    translated: Vec<usize>,
    /// Indices of the joints whose contact is matched, in order.
    pub(crate) contacts: Vec<usize>,
    /// Heading of the first frame of the first example, in radians; none in world coordinates.
    heading: Option<f64>,
    start: [f64; 3],
}

impl MotionMatrix {
    /// The layout for examples of one skeleton. Motions of 59 frames a second and more are
    /// downsampled by powers of two.
    ///
    /// # Errors
    /// Fails without examples; if joints, bones or frame rates differ; if the first example lacks
    /// channels for the motion of another; if all bones have length 0.
    pub fn new(examples: &[Example], options: MatrixOptions) -> Result<Self, Error> {
        Self::with(examples, &[], options)
    }

    /// [`new`](Self::new), with the same errors, with further motions as sources of parts or poses.
    /// All motions determine the root joint and the joints whose position changes.
    pub fn with(
        examples: &[Example],
        others: &[&Example],
        options: MatrixOptions,
    ) -> Result<Self, Error> {
        let Some(first) = examples.first() else {
            let problem = "none found";
            return Err(Error::file("no example", problem, "name a BVH file"));
        };
        let (_, frame_time) = thinning(&first.bvh);
        let mut contacts = options.contacts;
        contacts.sort_unstable();
        let mut layout = Self {
            file: first.file.clone(),
            bvh: first.bvh.clone(),
            up: match options.up {
                UpAxis::Y => Axis::Y,
                UpAxis::Z => Axis::Z,
            },
            scale: 1.0,
            frame_time,
            root_joint: 0,
            ancestors: Vec::new(),
            base: [0.0; 3],
            translated: Vec::new(),
            contacts,
            heading: None,
            start: [0.0; 3],
        };
        let motions = || examples.iter().chain(others.iter().copied());
        let mut all = Vec::new();
        for motion in motions() {
            layout.must_match(motion)?;
            all.push(position_ranges(&motion.bvh));
        }
        let range = |joint: usize| all.iter().map(|ranges| ranges[joint]).fold(0.0, f64::max);
        let ranges: Vec<f64> = (0..layout.bvh.joints().len()).map(range).collect();
        layout.root_joint = common_root_joint(&layout.bvh, &all, &ranges);
        layout.ancestors = ancestors(&layout.bvh, layout.root_joint);
        layout.scale = scale(first, layout.root_joint)?;
        layout.base = match layout.joints()[layout.root_joint].parent {
            Some(parent) if layout.ancestors.is_empty() => layout.bvh.world(0)[parent].position,
            _ => layout.ancestors.iter().fold([0.0; 3], |sum, &joint| {
                let offset = layout.joints()[joint].offset;
                [0, 1, 2].map(|i| sum[i] + offset[i])
            }),
        };
        for motion in motions() {
            layout.must_match_bones(motion)?;
            layout.must_have_channels(motion)?;
        }
        if options.heading {
            layout.must_have_upright_root(motions(), "option `heading`")?;
        }
        let shifts = |joint: &usize| ranges[*joint] * layout.scale > STILL;
        let carries = |joint: &usize| *joint == layout.root_joint || layout.is_ancestor(*joint);
        let translated = (0..ranges.len()).filter(|joint| shifts(joint) && !carries(joint));
        layout.translated = translated.collect();
        layout.heading = options.heading.then_some(0.0);
        layout.start_like(&first.bvh);
        Ok(layout)
    }

    /// True if motions are relative to the heading.
    pub fn is_relative(&self) -> bool {
        self.heading.is_some()
    }

    /// True for the joints above the root joint that have no other descendants. They are the first
    /// joints of the file.
    fn is_ancestor(&self, joint: usize) -> bool {
        joint < self.ancestors.len()
    }

    /// True for the root joint, and for the highest joint of each figure that moves relative to it.
    pub(crate) fn carries_body(&self, joint: usize) -> bool {
        let own = &self.joints()[joint];
        let is_figure = own.parent == Some(self.root_joint) && own.offset == [0.0; 3];
        joint == self.root_joint || is_figure && self.translated.binary_search(&joint).is_ok()
    }

    /// The joints, in file order.
    pub fn joints(&self) -> &[kinegrad_capture::Joint] {
        self.bvh.joints()
    }

    /// Seconds between frames after downsampling.
    pub fn frame_time(&self) -> f64 {
        self.frame_time
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        let joints = ROTATION * (self.joints().len() + self.contacts.len());
        joints + 3 * self.translated.len() + usize::from(self.heading.is_some()) + 3
    }

    /// Channels of a joint: rotation, position if it changes, contact. The root trajectory is in
    /// [`root_channels`](Self::root_channels).
    pub fn channels_of(&self, joint: usize) -> Vec<usize> {
        let mut channels: Vec<usize> = self.rotation_of(joint).collect();
        let places = ROTATION * self.joints().len();
        if let Ok(place) = self.translated.binary_search(&joint) {
            channels.extend(places + 3 * place..places + 3 * place + 3);
        }
        let contacts = places + 3 * self.translated.len();
        if let Ok(place) = self.contacts.binary_search(&joint) {
            let first = contacts + ROTATION * place;
            channels.extend(first..first + ROTATION);
        }
        channels
    }

    /// Channels of a joint's rotation.
    pub fn rotation_of(&self, joint: usize) -> std::ops::Range<usize> {
        ROTATION * joint..ROTATION * (joint + 1)
    }

    /// Channels of the root trajectory: the change of heading in radians, if motions are relative
    /// to the heading, then x, y and z.
    pub fn root_channels(&self) -> std::ops::Range<usize> {
        self.channels() - 3 - usize::from(self.heading.is_some())..self.channels()
    }

    /// The channel of the root height.
    pub fn height(&self) -> usize {
        self.channels() - 3 + self.up as usize
    }

    /// Local poses, with the motion of the ancestors moved into the root joint: in some files the
    /// hips travel, in others of the same skeleton the node above the hips.
    fn locals(&self, bvh: &Bvh, t: usize) -> Vec<RootPose> {
        let mut poses = bvh.locals(t);
        if self.ancestors.is_empty() {
            return poses;
        }
        for &joint in &self.ancestors {
            poses[joint] = self.upright(joint);
        }
        let world = bvh.world(t)[self.root_joint];
        poses[self.root_joint] = RootPose {
            position: [0, 1, 2].map(|axis| world.position[axis] - self.base[axis]),
            orientation: world.orientation,
        };
        poses
    }

    /// The pose of an ancestor in new motions, without rotation: trajectory and heading are then
    /// relative to the ground.
    fn upright(&self, joint: usize) -> RootPose {
        RootPose {
            position: self.joints()[joint].offset,
            orientation: Quaternion::IDENTITY,
        }
    }

    /// The matrix of an example, `[frames, channels]`, after downsampling.
    ///
    /// # Errors
    /// Fails for another skeleton or frame rate, and numbers beyond single precision.
    pub fn to_frames(&self, example: &Example) -> Result<Frames, Error> {
        self.must_match(example)?;
        let bvh = &example.bvh;
        let (every, _) = thinning(bvh);
        let times: Vec<usize> = (0..bvh.frames()).step_by(every).collect();
        let mut poses: Vec<Vec<RootPose>> = times.iter().map(|&t| self.locals(bvh, t)).collect();
        let start = poses[0][self.root_joint].position;
        let trajectory = poses.iter().map(|pose| {
            let place = pose[self.root_joint].position;
            [0, 1, 2].map(|axis| match axis == self.up as usize {
                true => place[axis] * self.scale,
                false => (place[axis] - start[axis]) * self.scale,
            })
        });
        let mut trajectory = displacements(&trajectory.collect::<Vec<_>>(), Some(self.up));
        let turns = self.heading;
        let turns = turns.map(|_| self.to_heading_frame(&mut poses, &mut trajectory));
        let contacts = self.contacts_of(bvh, &times);
        let mut values: Vec<f32> = Vec::with_capacity(times.len() * self.channels());
        for (t, pose) in poses.iter().enumerate() {
            for joint in pose {
                let rotation = rotation6d::from_quaternion(joint.orientation);
                values.extend(rotation.map(|value| value as f32));
            }
            for &joint in &self.translated {
                let place = pose[joint].position;
                values.extend(place.map(|value| (value * self.scale) as f32));
            }
            for contact in &contacts {
                values.extend([if contact[t] { 1.0 } else { 0.0 }, 0.0, 0.0, 0.0, 0.0, 0.0]);
            }
            values.extend(turns.as_ref().map(|turns| turns[t] as f32));
            values.extend(trajectory[t].map(|value| value as f32));
        }
        if !values.iter().all(|value| value.is_finite()) {
            let hint = "lengths are scaled by the longest bone: check the positions";
            let problem = "has positions too large for single precision";
            return Err(Error::file(&example.file, problem, hint));
        }
        Ok(Frames::new(self.channels(), values))
    }

    /// A matrix, `[frames, channels]`, as a motion with the joints, channels, units and start of the
    /// first example.
    ///
    /// # Errors
    /// Fails if a value is not finite. Panics if the channels differ.
    pub fn to_bvh(&self, frames: &Frames) -> Result<Bvh, Error> {
        assert_eq!(frames.channels(), self.channels());
        let joints = self.joints().len();
        let mut still = self.bvh.locals(0);
        for &joint in &self.ancestors {
            still[joint] = self.upright(joint);
        }
        let trajectory = self.root_trajectory(frames);
        let mut locals = Vec::with_capacity(frames.frames() * joints);
        for (t, (place, heading)) in trajectory.into_iter().enumerate() {
            let frame = frames.frame(t);
            let value = |index: usize| f64::from(frame[index]);
            for (joint, still) in still.iter().enumerate() {
                let six = std::array::from_fn(|i| value(ROTATION * joint + i));
                locals.push(RootPose {
                    position: still.position,
                    orientation: rotation6d::to_quaternion(six),
                });
            }
            let own = &mut locals[t * joints..];
            for (index, &joint) in self.translated.iter().enumerate() {
                let first = ROTATION * joints + 3 * index;
                own[joint].position = [0, 1, 2].map(|axis| value(first + axis) / self.scale);
            }
            let root_joint = &mut own[self.root_joint];
            root_joint.position = place;
            root_joint.orientation = self.heading_rotation(heading) * root_joint.orientation;
        }
        Ok(self.bvh.reposed(self.frame_time, &locals)?)
    }

    /// The contact of each contact joint in the frames `times`, `[contacts][times]`.
    fn contacts_of(&self, bvh: &Bvh, times: &[usize]) -> Vec<Vec<bool>> {
        if self.contacts.is_empty() {
            return Vec::new();
        }
        let world: Vec<Vec<RootPose>> = times.iter().map(|&t| bvh.world(t)).collect();
        let moved = |joint: usize, t: usize| {
            let (now, before) = (world[t][joint].position, world[t - 1][joint].position);
            length([0, 1, 2].map(|axis| now[axis] - before[axis])) * self.scale
        };
        let rests = |joint: usize| {
            let rests = |t: usize| t > 0 && moved(joint, t) < CONTACT;
            (0..times.len()).map(rests).collect()
        };
        self.contacts.iter().map(|&joint| rests(joint)).collect()
    }
}

#[cfg(test)]
pub(crate) mod tests;

#[cfg(test)]
mod compatibility_tests;
