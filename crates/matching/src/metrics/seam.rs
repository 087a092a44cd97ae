//! Seams of loops.

use kinegrad_capture::{Bvh, RootPose};
use kinegrad_motion::vector::length;
use serde::Serialize;

use crate::{MotionMatrix, percentile_95};

/// The seam of a loop, relative to the 95th percentiles of the rest. Values are joint means in
/// coordinates relative to the root.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Seam {
    /// The step from the last frame to the first.
    pub step: f64,
    /// The change of velocity at the seam.
    pub velocity: f64,
}

impl Seam {
    /// The seam of a motion; `None` for fewer than four frames.
    pub(crate) fn of(layout: &MotionMatrix, bvh: &Bvh) -> Option<Self> {
        let n = bvh.frames();
        if n < 4 {
            return None;
        }
        // Ancestors of the root joint are left out.
        let mut travel = vec![false; layout.joints().len()];
        for (joint, own) in layout.joints().iter().enumerate() {
            let with = own.parent.is_some_and(|parent| travel[parent]);
            travel[joint] = joint == layout.root_joint || with;
        }
        let places = |t: usize| -> Vec<[f64; 3]> {
            let world = bvh.world(t);
            let (x, y) = layout.top_view(world[layout.root_joint].position);
            let place = |(pose, travels): (&RootPose, &bool)| {
                let (a, b) = layout.top_view(pose.position);
                travels.then_some([a - x, b - y, pose.position[layout.up as usize]])
            };
            world.iter().zip(&travel).filter_map(place).collect()
        };
        let places: Vec<Vec<[f64; 3]>> = (0..n).map(places).collect();
        let mean = |terms: &[(usize, f64)]| {
            let joints = places[0].len();
            let of = |joint: usize| {
                let term =
                    |axis: usize, (t, weight): &(usize, f64)| weight * places[t % n][joint][axis];
                length([0, 1, 2].map(|axis| terms.iter().map(|each| term(axis, each)).sum()))
            };
            (0..joints).map(of).sum::<f64>() / joints as f64
        };
        let step = |t: usize| mean(&[(t + 1, 1.0), (t, -1.0)]);
        let turn = |t: usize| mean(&[(t + 2, 1.0), (t + 1, -2.0), (t, 1.0)]);
        let steps: Vec<f64> = (0..n - 1).map(step).collect();
        let turns: Vec<f64> = (0..n - 2).map(turn).collect();
        let in_parts = |value: f64, of: &[f64]| match percentile_95(of) {
            0.0 if value == 0.0 => 0.0,
            usual => value / usual,
        };
        Some(Self {
            step: in_parts(step(n - 1), &steps),
            velocity: in_parts(turn(n - 2).max(turn(n - 1)), &turns),
        })
    }

    /// Maximum of step and velocity.
    pub fn jump(self) -> f64 {
        self.step.max(self.velocity)
    }
}
