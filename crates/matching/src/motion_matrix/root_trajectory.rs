//! Root trajectories in world coordinates or relative to the heading.

use std::f64::consts::TAU;

use kinegrad_capture::{Axis, Bvh, RootPose, UpAxis};
use kinegrad_motion::Quaternion;
use kinegrad_motion::vector::plus;

use super::MotionMatrix;
use crate::{Frames, places, rotation6d};

impl MotionMatrix {
    /// Root positions, `[frames]`, in file units.
    pub fn path(&self, frames: &Frames) -> Vec<[f64; 3]> {
        let trajectory = self.root_trajectory(frames).into_iter();
        trajectory.map(|(place, _)| place).collect()
    }

    /// Sets the start of motions to `place`, horizontal, in file units.
    pub(crate) fn start_at(&mut self, place: [f64; 2]) {
        let level = (0..3).filter(|&axis| axis != self.up as usize);
        for (axis, place) in level.zip(place) {
            self.start[axis] = place - self.base[axis];
        }
    }

    /// Sets start and first heading of motions to those of `motion`.
    pub(crate) fn start_like(&mut self, motion: &Bvh) {
        let pose = self.locals(motion, 0)[self.root_joint];
        self.start = pose.position;
        self.heading = self.heading.map(|_| self.heading_of(pose.orientation));
    }

    /// Sets the start of motions so that `frames` pass `place` at frame `t`.
    pub(crate) fn start_through(&mut self, frames: &Frames, (t, place): (usize, [f64; 2])) {
        let passed = self.root_trajectory(frames)[t].0;
        let level = (0..3).filter(|&axis| axis != self.up as usize);
        for (axis, place) in level.zip(place) {
            self.start[axis] += place - self.base[axis] - passed[axis];
        }
    }

    /// Closes the heading of a loop: the difference between the total turn and the nearest multiple
    /// of a full turn is distributed evenly over the frames.
    pub(crate) fn close_heading(&self, frames: &mut Frames) {
        if self.heading.is_none() {
            return;
        }
        let (turn, n) = (self.root_channels().start, frames.frames());
        let all: f64 = (0..n).map(|t| f64::from(frames.frame(t)[turn])).sum();
        let share = (all - TAU * (all / TAU).round()) / n as f64;
        (0..n).for_each(|t| frames.frame_mut(t)[turn] -= share as f32);
    }

    /// Lets a loop end where it starts: its displacement is taken off evenly over the frames.
    pub(crate) fn stay_in_place(&self, frames: &mut Frames) {
        let first = self.channels() - 3;
        let trajectory = self.root_trajectory(frames);
        let headings = || trajectory.iter().map(|(_, heading)| *heading).enumerate();
        let mut travelled = [0.0; 3];
        for (t, heading) in headings() {
            let step = [0, 1, 2].map(|axis| f64::from(frames.frame(t)[first + axis]));
            travelled = plus(travelled, self.heading_rotation(heading).rotate(step));
        }
        let share = travelled.map(|value| value / trajectory.len() as f64);
        for (t, heading) in headings() {
            let step = self.heading_rotation(-heading).rotate(share);
            for axis in (0..3).filter(|&axis| axis != self.up as usize) {
                frames.frame_mut(t)[first + axis] -= step[axis] as f32;
            }
        }
    }

    /// Root position in file units and heading in radians, `[frames]`.
    pub(super) fn root_trajectory(&self, frames: &Frames) -> Vec<([f64; 3], f64)> {
        let mut heading = self.heading.unwrap_or(0.0);
        let (mut headings, mut displaced) = (Vec::new(), Vec::new());
        for t in 0..frames.frames() {
            let values = &frames.frame(t)[self.root_channels()];
            let (turn, values) = values.split_at(values.len() - 3);
            if t > 0 {
                heading += turn.iter().copied().map(f64::from).sum::<f64>();
            }
            headings.push(heading);
            let moved = [0, 1, 2].map(|axis| f64::from(values[axis]));
            displaced.push(self.heading_rotation(heading).rotate(moved));
        }
        let start = self.start.map(|value| value * self.scale);
        let path = places(&displaced, start, Some(self.up)).into_iter();
        let path = path.map(|place| place.map(|value| value / self.scale));
        path.zip(headings).collect()
    }

    /// The rotation about the vertical by `heading` radians.
    pub(super) fn heading_rotation(&self, heading: f64) -> Quaternion {
        let mut vector = [0.0; 3];
        vector[self.up as usize] = heading;
        Quaternion::from_rotation_vector(vector)
    }

    /// The heading of a rotation, in radians.
    pub(super) fn heading_of(&self, rotation: Quaternion) -> f64 {
        let about = [rotation.x, rotation.y, rotation.z][self.up as usize];
        2.0 * about.atan2(rotation.w)
    }

    /// The smallest arc in radians that contains all root headings; none if motions are relative to
    /// the heading.
    pub fn heading_arc(&self, motions: &[Frames]) -> Option<f64> {
        if self.heading.is_some() {
            return None;
        }
        let six = self.rotation_of(self.root_joint);
        let rows = motions.iter();
        let rows = rows.flat_map(|frames| frames.values().chunks_exact(frames.channels()));
        let heading = |row: &[f32]| {
            let six = std::array::from_fn(|i| f64::from(row[six.start + i]));
            self.heading_of(rotation6d::to_quaternion(six))
                .rem_euclid(TAU)
        };
        let mut headings: Vec<f64> = rows.map(heading).collect();
        headings.sort_unstable_by(f64::total_cmp);
        let (first, last) = (headings.first()?, headings.last()?);
        let gaps = headings.windows(2).map(|pair| pair[1] - pair[0]);
        Some(TAU - gaps.fold(first + TAU - last, f64::max))
    }

    /// Makes root rotations and displacements relative to the heading, and returns the changes of
    /// heading, `[frames]`. The first frame gets the displacement and heading change of the second
    /// frame.
    pub(super) fn to_heading_frame(
        &self,
        poses: &mut [Vec<RootPose>],
        trajectory: &mut [[f64; 3]],
    ) -> Vec<f64> {
        let headings = poses.iter().map(|pose| pose[self.root_joint].orientation);
        let headings: Vec<f64> = headings.map(|turn| self.heading_of(turn)).collect();
        for ((pose, moved), heading) in poses.iter_mut().zip(trajectory.iter_mut()).zip(&headings) {
            let back = self.heading_rotation(-heading);
            *moved = back.rotate(*moved);
            let root_joint = &mut pose[self.root_joint];
            root_joint.orientation = back * root_joint.orientation;
        }
        let turn = |pair: &[f64]| {
            let turn = pair[1] - pair[0];
            turn - TAU * (turn / TAU).round()
        };
        let mut turns: Vec<f64> = headings.windows(2).map(turn).collect();
        turns.insert(0, turns.first().copied().unwrap_or(0.0));
        if let [first, second, ..] = trajectory {
            let height = first[self.up as usize];
            *first = *second;
            first[self.up as usize] = height;
        }
        turns
    }

    /// A position in top view: right and towards the viewer, in file units.
    pub fn top_view(&self, place: [f64; 3]) -> (f64, f64) {
        let up = match self.up {
            Axis::Z => UpAxis::Z,
            Axis::X | Axis::Y => UpAxis::Y,
        };
        let [x, _, z] = up.to_y_up(place);
        (x, z)
    }
}
