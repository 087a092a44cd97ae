//! Motions of any skeleton as matrices, and back to BVH.
//!
//! A frame is, in this order: six numbers of each joint's rotation within its parent
//! ([`rotation6d`](crate::rotation6d)); the place within the parent of every other joint whose
//! place changes; the contact of each foot in the first of six channels; and the way of the joint
//! that travels, its height as it is and its horizontal place as the displacement from the frame
//! before. On request that joint's rotation and displacement are seen from its heading, and the
//! turn of the heading since the frame before stands in front of the way. Lengths are scaled by 1 /
//! ceil(largest component of an offset). Source: GenMM; docs/sources/genmm.md.

use kinegrad_capture::{Axis, Bvh, RootPose, UpAxis};
use kinegrad_motion::Quaternion;
use kinegrad_motion::rotation::length;

use crate::{Error, Frames, displacements, rotation6d};

mod compatibility;
mod foot_locking;
mod root_trajectory;
mod root_warp;
mod skeleton;

use skeleton::{ancestors, common_root_joint, position_ranges, scale, thinning};

/// Channels of a rotation.
const ROTATION: usize = 6;
/// Distance between two frames, in scaled units, below which a foot is in contact.
const CONTACT: f64 = 0.018;
/// Change of a place, in scaled units, that is no more than the rounding of a file.
const STILL: f64 = 1e-5;

/// A motion to learn from.
#[derive(Clone, Debug)]
pub struct Example {
    /// Its file, for messages.
    pub file: String,
    /// The motion.
    pub bvh: Bvh,
}

/// What of a motion is matched, and how it is seen.
#[derive(Clone, Debug, Default)]
pub struct MatrixOptions {
    /// The axis that points up in the files.
    pub up: UpAxis,
    /// Joints, by their indices, whose contact with the ground is matched as well.
    pub contacts: Vec<usize>,
    /// Whether the body is seen from its heading: a walk to the north is then like one to the east.
    /// The published program sees it from outside.
    pub heading: bool,
}

/// How the motions of one skeleton are matrices.
#[derive(Clone, Debug)]
pub struct MotionMatrix {
    file: String,
    bvh: Bvh,
    up: Axis,
    scale: f64,
    frame_time: f64,
    root_joint: usize,
    /// Joints above the one that travels, where nothing else hangs on them.
    ancestors: Vec<usize>,
    /// Where what carries the joint that travels stands in a new motion, with no turn.
    base: [f64; 3],
    translated: Vec<usize>,
    contacts: Vec<usize>,
    /// Heading of the first example's first frame, in radians; none if motions are seen from
    /// outside.
    heading: Option<f64>,
    start: [f64; 3],
}

impl MotionMatrix {
    /// The layout of the examples, which have one skeleton. Motions of 59 frames a second and more
    /// are thinned to every second frame, as often as needed.
    ///
    /// # Errors
    /// If there are no examples, their joints, bones or frame rates differ, the first has no channels
    /// for what moves in another, or no bone has a length.
    pub fn new(examples: &[Example], options: MatrixOptions) -> Result<Self, Error> {
        Self::with(examples, &[], options)
    }

    /// [`new`](Self::new), for other motions beside the examples too, of which parts or poses are
    /// taken: what travels and what changes its place is what does so in any of them.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with(
        examples: &[Example],
        others: &[&Example],
        options: MatrixOptions,
    ) -> Result<Self, Error> {
        let Some(first) = examples.first() else {
            return Err(Error::file(
                "no example",
                "none is given",
                "name a BVH file",
            ));
        };
        let (_, frame_time) = thinning(&first.bvh);
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
            contacts: options.contacts,
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
        let parent = layout.joints()[layout.root_joint].parent;
        layout.base = match (layout.ancestors.is_empty(), parent) {
            (true, None) => [0.0; 3],
            (true, Some(parent)) => layout.bvh.world(0)[parent].position,
            (false, _) => {
                let offsets = layout
                    .ancestors
                    .iter()
                    .map(|&joint| layout.joints()[joint].offset);
                offsets.fold([0.0; 3], |sum, offset| {
                    [0, 1, 2].map(|i| sum[i] + offset[i])
                })
            }
        };
        for motion in motions() {
            layout.must_match_bones(motion)?;
            layout.must_have_channels(motion)?;
        }
        if options.heading {
            layout.must_have_upright_root(motions(), "`--heading`")?;
        }
        let shifts = |joint: &usize| ranges[*joint] * layout.scale > STILL;
        let carries =
            |joint: &usize| *joint == layout.root_joint || layout.ancestors.contains(joint);
        layout.translated = (0..ranges.len())
            .filter(|joint| shifts(joint) && !carries(joint))
            .collect();
        let pose = layout.locals(&first.bvh, 0)[layout.root_joint];
        layout.start = pose.position;
        layout.heading = options.heading.then(|| layout.heading_of(pose.orientation));
        Ok(layout)
    }

    /// The joints, as in the file.
    pub fn joints(&self) -> &[kinegrad_capture::Joint] {
        self.bvh.joints()
    }

    /// Seconds from one frame to the next, after thinning.
    pub fn frame_time(&self) -> f64 {
        self.frame_time
    }

    /// The joint whose way is followed.
    pub fn root_joint(&self) -> usize {
        self.root_joint
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        let joints = ROTATION * (self.joints().len() + self.contacts.len());
        joints + 3 * self.translated.len() + usize::from(self.heading.is_some()) + 3
    }

    /// Channels of a joint: its rotation, its place if that changes, its contact. The way of the
    /// joint that travels is in [`way`](Self::way).
    pub fn channels_of(&self, joint: usize) -> Vec<usize> {
        let mut channels: Vec<usize> = self.rotation_of(joint).collect();
        let places = ROTATION * self.joints().len();
        if let Some(place) = self
            .translated
            .iter()
            .position(|&translated| translated == joint)
        {
            channels.extend(places + 3 * place..places + 3 * place + 3);
        }
        let contacts = places + 3 * self.translated.len();
        if let Some(place) = self.contacts.iter().position(|&contact| contact == joint) {
            let first = contacts + ROTATION * place;
            channels.extend(first..first + ROTATION);
        }
        channels
    }

    /// Channels of a joint's rotation.
    pub fn rotation_of(&self, joint: usize) -> std::ops::Range<usize> {
        ROTATION * joint..ROTATION * (joint + 1)
    }

    /// Channels of the way of the joint that travels: the turn of its heading in radians, if motions
    /// are seen from there, and x, y and z.
    pub fn root_channels(&self) -> std::ops::Range<usize> {
        self.channels() - 3 - usize::from(self.heading.is_some())..self.channels()
    }

    /// The channel of the height of the joint that travels.
    pub fn height(&self) -> usize {
        self.channels() - 3 + self.up()
    }

    /// Which coordinate of a place is its height.
    pub(crate) fn up(&self) -> usize {
        self.up as usize
    }

    /// Indices of the joints that are in contact with the ground at times.
    pub fn contacts(&self) -> &[usize] {
        &self.contacts
    }

    /// Poses within the parents. What moves the joints above the one that travels moves it instead:
    /// in some files the hips travel, in others of the same skeleton the root does and takes them
    /// along.
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

    /// How a joint above the one that travels stands in new motions: the way and the heading are then
    /// those over the ground.
    fn upright(&self, joint: usize) -> RootPose {
        RootPose {
            position: self.joints()[joint].offset,
            orientation: Quaternion::IDENTITY,
        }
    }

    /// The motion of an example, `[frames, channels]`, after thinning.
    ///
    /// # Errors
    /// As [`must_match`](Self::must_match), and for numbers beyond single precision.
    pub fn to_frames(&self, example: &Example) -> Result<Frames, Error> {
        self.must_match(example)?;
        let bvh = &example.bvh;
        let (every, _) = thinning(bvh);
        let times: Vec<usize> = (0..bvh.frames()).step_by(every).collect();
        let mut poses: Vec<Vec<RootPose>> = times.iter().map(|&t| self.locals(bvh, t)).collect();
        let start = poses[0][self.root_joint].position;
        let trajectory = poses.iter().map(|pose| {
            let place = pose[self.root_joint].position;
            [0, 1, 2].map(|axis| {
                let origin = if axis == self.up as usize {
                    0.0
                } else {
                    start[axis]
                };
                (place[axis] - origin) * self.scale
            })
        });
        let mut trajectory = displacements(&trajectory.collect::<Vec<_>>(), Some(self.up));
        let turns = self
            .heading
            .map(|_| self.to_heading_frame(&mut poses, &mut trajectory));
        let contacts = self.contacts_of(bvh, &times);
        let mut values: Vec<f32> = Vec::with_capacity(times.len() * self.channels());
        for (t, pose) in poses.iter().enumerate() {
            for joint in pose {
                let rotation = rotation6d::from_quaternion(joint.orientation);
                values.extend(rotation.map(|value| value as f32));
            }
            for &joint in &self.translated {
                values.extend(
                    pose[joint]
                        .position
                        .map(|value| (value * self.scale) as f32),
                );
            }
            for contact in &contacts {
                values.extend([if contact[t] { 1.0 } else { 0.0 }, 0.0, 0.0, 0.0, 0.0, 0.0]);
            }
            values.extend(turns.as_ref().map(|turns| turns[t] as f32));
            values.extend(trajectory[t].map(|value| value as f32));
        }
        if !values.iter().all(|value| value.is_finite()) {
            let hint = "lengths are scaled by the longest bone: check the positions";
            let problem = "holds positions too large for single precision";
            return Err(Error::file(&example.file, problem, hint));
        }
        Ok(Frames::new(self.channels(), values))
    }

    /// A motion, `[frames, channels]`, as a file with the joints, channels and units of the first
    /// example, which starts where that does.
    ///
    /// # Errors
    /// If it is not finite.
    ///
    /// # Panics
    /// Panics if it has other channels.
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
            let numbers = |from: usize| frame[from..].iter().copied().map(f64::from);
            for (joint, still) in still.iter().enumerate() {
                let mut six = numbers(ROTATION * joint);
                let six = [(); 6].map(|()| six.next().expect("a rotation"));
                locals.push(RootPose {
                    position: still.position,
                    orientation: rotation6d::to_quaternion(six),
                });
            }
            let own = &mut locals[t * joints..];
            for (index, &joint) in self.translated.iter().enumerate() {
                let mut values = numbers(ROTATION * joints + 3 * index);
                own[joint].position =
                    [(); 3].map(|()| values.next().expect("a place") / self.scale);
            }
            let root_joint = &mut own[self.root_joint];
            root_joint.position = place;
            root_joint.orientation = self.heading_rotation(heading) * root_joint.orientation;
        }
        Ok(self.bvh.reposed(self.frame_time, &locals)?)
    }

    /// Whether each contact joint rests in each of the frames `times`, `[contacts][times]`.
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
