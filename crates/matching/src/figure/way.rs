//! The way of the joint that travels, seen from outside or from its heading.

use std::f64::consts::TAU;

use kinegrad_capture::{Axis, RootPose, UpAxis};
use kinegrad_motion::Quaternion;

use super::Figure;
use crate::{Frames, places};

impl Figure {
    /// The way of the joint that travels, `[frames]`, in the file's units.
    pub fn path(&self, frames: &Frames) -> Vec<[f64; 3]> {
        self.way_of(frames)
            .into_iter()
            .map(|(place, _)| place)
            .collect()
    }

    /// Bends the way of a motion, so that at frame `t` it is at `place` on the two axes that do not
    /// point up, in the file's units, for each of `points`. Each bends what is behind the one before
    /// it, most in the middle and not at its ends. The first frame stays where it is
    /// ([`start_at`](Self::start_at) says otherwise).
    pub fn lead(&self, frames: &mut Frames, points: &[(usize, [f64; 2])]) {
        let mut points = points.to_vec();
        points.sort_by_key(|(t, _)| *t);
        let level = [0, 1, 2]
            .into_iter()
            .filter(|&axis| axis != self.up as usize);
        let level: Vec<usize> = level.collect();
        let first = self.channels() - 3;
        let mut before = 0;
        for (t, place) in points.into_iter().filter(|(t, _)| *t > 0) {
            if t == before {
                continue;
            }
            let way = self.way_of(frames);
            let mut missed = [0.0; 3];
            for (&axis, place) in level.iter().zip(place) {
                missed[axis] = (place - self.base[axis] - way[t].0[axis]) * self.scale;
            }
            // The speed of the least jerk from rest to rest, so that no corner is left.
            let speed = |frame: usize| {
                let part = ((frame - before) as f64 - 0.5) / (t - before) as f64;
                (part * (1.0 - part)).powi(2)
            };
            let all: f64 = (before + 1..=t).map(speed).sum();
            for (frame, (_, heading)) in way.iter().enumerate().take(t + 1).skip(before + 1) {
                let share = missed.map(|value| value * speed(frame) / all);
                let moved = self.turned(-heading).rotate(share);
                for &axis in &level {
                    frames.frame_mut(frame)[first + axis] += moved[axis] as f32;
                }
            }
            before = t;
        }
    }

    /// Has motions start at `place`, on the two axes that do not point up, in the file's units.
    pub(crate) fn start_at(&mut self, place: [f64; 2]) {
        let level = (0..3).filter(|&axis| axis != self.up as usize);
        for (axis, place) in level.zip(place) {
            self.start[axis] = place - self.base[axis];
        }
    }

    /// Closes the heading of a loop: what is missing to whole turns from its first frame around to it
    /// is shared out evenly, so that the body goes on as it began. Without a heading nothing changes.
    pub(crate) fn close(&self, frames: &mut Frames) {
        if self.heading.is_none() {
            return;
        }
        let (turn, n) = (self.way().start, frames.frames());
        let all: f64 = (0..n).map(|t| f64::from(frames.frame(t)[turn])).sum();
        let share = (all - TAU * (all / TAU).round()) / n as f64;
        (0..n).for_each(|t| frames.frame_mut(t)[turn] -= share as f32);
    }

    /// Place of the joint that travels, in the file's units, and the heading that its rotation is
    /// seen from, in radians, `[frames]`.
    pub(super) fn way_of(&self, frames: &Frames) -> Vec<([f64; 3], f64)> {
        let mut heading = self.heading.unwrap_or(0.0);
        let (mut headings, mut displaced) = (Vec::new(), Vec::new());
        for t in 0..frames.frames() {
            let values = &frames.frame(t)[self.way()];
            let (turn, values) = values.split_at(values.len() - 3);
            if t > 0 {
                heading += turn.iter().copied().map(f64::from).sum::<f64>();
            }
            headings.push(heading);
            let moved = [0, 1, 2].map(|axis| f64::from(values[axis]));
            displaced.push(self.turned(heading).rotate(moved));
        }
        let start = self.start.map(|value| value * self.scale);
        let path = places(&displaced, start, Some(self.up)).into_iter();
        path.map(|place| place.map(|value| value / self.scale))
            .zip(headings)
            .collect()
    }

    /// The turn about the vertical by `heading` radians.
    pub(super) fn turned(&self, heading: f64) -> Quaternion {
        let mut vector = [0.0; 3];
        vector[self.up as usize] = heading;
        Quaternion::from_rotation_vector(vector)
    }

    /// How far a rotation turns about the vertical, in radians.
    pub(super) fn heading_of(&self, rotation: Quaternion) -> f64 {
        let about = [rotation.x, rotation.y, rotation.z][self.up as usize];
        2.0 * about.atan2(rotation.w)
    }

    /// Turns rotations and displacements of the joint that travels to where it heads, and returns
    /// the turns of the heading since the frame before, `[frames]`. The first frame moves and turns
    /// as the second does.
    pub(super) fn seen_from_heading(
        &self,
        poses: &mut [Vec<RootPose>],
        way: &mut [[f64; 3]],
    ) -> Vec<f64> {
        let headings: Vec<f64> = poses
            .iter()
            .map(|pose| self.heading_of(pose[self.travelling].orientation))
            .collect();
        for ((pose, moved), heading) in poses.iter_mut().zip(way.iter_mut()).zip(&headings) {
            let back = self.turned(-heading);
            *moved = back.rotate(*moved);
            let travelling = &mut pose[self.travelling];
            travelling.orientation = back * travelling.orientation;
        }
        let turn = |pair: &[f64]| {
            let turn = pair[1] - pair[0];
            turn - TAU * (turn / TAU).round()
        };
        let mut turns: Vec<f64> = headings.windows(2).map(turn).collect();
        turns.insert(0, turns.first().copied().unwrap_or(0.0));
        if let [first, second, ..] = way {
            let height = first[self.up as usize];
            *first = *second;
            first[self.up as usize] = height;
        }
        turns
    }

    /// A place from above: to the right and towards the viewer, in the file's units.
    pub fn from_above(&self, place: [f64; 3]) -> (f64, f64) {
        let up = match self.up {
            Axis::Z => UpAxis::Z,
            Axis::X | Axis::Y => UpAxis::Y,
        };
        let [x, _, z] = up.to_y_up(place);
        (x, z)
    }
}
