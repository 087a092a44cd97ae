//! The root path: conversion between relative and absolute root channels.
//!
//! Channels 0 to 3 of a frame are (rotation, x, z, height). The root quaternion is (cos a, 0, sin
//! a, 0) and maps world to facing frame: for yaw psi (from +z towards +x), a = -psi / 2. Source:
//! GMD, appendix B; docs/sources.md, section 4.1.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Quaternion;
use crate::vector::{minus, plus};

/// Representation of the root in channels 0 to 2.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Root {
    /// Changes to the next frame, as in published HumanML3D. The path begins at x = z = 0 facing
    /// +z.
    #[default]
    Relative,
    /// Position and half angle.
    Absolute,
}

impl fmt::Display for Root {
    /// The name in a config.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl Root {
    /// The half angles `a` in radians, `[frames]`, from channels 0 to 3, `[frames, 4]`.
    pub fn half_angles(self, channels: &[[f64; 4]]) -> Vec<f64> {
        let rotations = channels.iter().map(|[rotation, ..]| *rotation);
        match self {
            Self::Absolute => rotations.collect(),
            Self::Relative => {
                let mut sum = 0.0;
                let before = |rotation: f64| {
                    let before = sum;
                    sum += rotation;
                    before
                };
                rotations.map(before).collect()
            }
        }
    }

    /// The root quaternions, world to facing frame, `[frames]`.
    pub fn quaternions(self, channels: &[[f64; 4]]) -> Vec<Quaternion> {
        let quaternion = |angle| Quaternion::from_yaw(2.0 * angle);
        let angles = self.half_angles(channels).into_iter();
        angles.map(quaternion).collect()
    }

    /// The root's positions (x, height, z) in metres, `[frames, 3]`.
    pub fn positions(self, channels: &[[f64; 4]]) -> Vec<[f64; 3]> {
        match self {
            Self::Absolute => channels.iter().map(|[_, x, z, y]| [*x, *y, *z]).collect(),
            Self::Relative => {
                let angles = self.half_angles(channels);
                let mut place = [0.0; 2];
                let position = |t: usize| {
                    if t > 0 {
                        let [_, x, z, _] = channels[t - 1];
                        place = plus(place, turn(-angles[t], [x, z]));
                    }
                    [place[0], channels[t][3], place[1]]
                };
                (0..channels.len()).map(position).collect()
            }
        }
    }

    /// The same path in representation `to`, `[frames, 4]`. From absolute to relative, the start is
    /// lost and the last change repeats the previous change (zero for a single frame).
    pub fn convert(self, channels: &[[f64; 4]], to: Self) -> Vec<[f64; 4]> {
        match (self, to) {
            (Self::Relative, Self::Absolute) => {
                let angles = self.half_angles(channels);
                let positions = self.positions(channels);
                let rows = angles.into_iter().zip(positions);
                rows.map(|(angle, [x, y, z])| [angle, x, z, y]).collect()
            }
            (Self::Absolute, Self::Relative) => {
                let changes = channels.windows(2).map(|pair| {
                    let ([angle, x, z, _], [next_angle, next_x, next_z, _]) = (pair[0], pair[1]);
                    let step = turn(next_angle, [next_x - x, next_z - z]);
                    [next_angle - angle, step[0], step[1]]
                });
                let mut changes: Vec<[f64; 3]> = changes.collect();
                changes.push(changes.last().copied().unwrap_or_default());
                let row = |([rotation, x, z], row): ([f64; 3], &[f64; 4])| [rotation, x, z, row[3]];
                changes.into_iter().zip(channels).map(row).collect()
            }
            _ => channels.to_vec(),
        }
    }

    /// The gradient with respect to channels, `[frames, 4]`, from the `upstream` gradient of
    /// positions, `[frames, 2]`.
    ///
    /// G(s) is the sum of `upstream` from frame s on. A relative step before frame s gets G(s) in
    /// its own frame. A rotation gets the sum over later angles.
    pub fn ground_gradient(self, channels: &[[f64; 4]], upstream: &[[f64; 2]]) -> Vec<[f64; 4]> {
        assert_eq!(upstream.len(), channels.len(), "one gradient a frame");
        if self == Self::Absolute {
            return upstream.iter().map(|[x, z]| [0.0, *x, *z, 0.0]).collect();
        }
        let angles = self.half_angles(channels);
        let mut gradient = vec![[0.0; 4]; channels.len()];
        let (mut later, mut angle_gradient) = ([0.0; 2], 0.0);
        for t in (1..channels.len()).rev() {
            later = plus(later, upstream[t]);
            let [_, x, z, _] = channels[t - 1];
            let step = turn(-angles[t], [x, z]);
            // One unit of the half angle `a` turns the step by two units towards (-z, x).
            angle_gradient += 2.0 * (later[1] * step[0] - later[0] * step[1]);
            let [x, z] = turn(angles[t], later);
            gradient[t - 1] = [angle_gradient, x, z, 0.0];
        }
        gradient
    }

    /// The sum of squared ground distances to `target` (x, z) over all frames, square metres, and
    /// the gradient with respect to channels 0 to 3, `[frames, 4]`.
    pub fn ground_distance(
        self,
        channels: &[[f64; 4]],
        target: &[[f64; 2]],
    ) -> (f64, Vec<[f64; 4]>) {
        assert_eq!(target.len(), channels.len(), "one target a frame");
        let positions = self.positions(channels).into_iter().zip(target);
        let apart = positions.map(|([x, _, z], target)| minus([x, z], *target));
        let apart: Vec<[f64; 2]> = apart.collect();
        let distance = apart.iter().flatten().map(|value| value * value).sum();
        let upstream: Vec<[f64; 2]> = apart.iter().map(|v| v.map(|x| 2.0 * x)).collect();
        (distance, self.ground_gradient(channels, &upstream))
    }
}

/// The ground vector (x, z) rotated by the root quaternion of half angle `angle`.
fn turn(angle: f64, [x, z]: [f64; 2]) -> [f64; 2] {
    let (sin, cos) = (2.0 * angle).sin_cos();
    [x * cos + z * sin, z * cos - x * sin]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn trajectories(frames: usize) -> impl Strategy<Value = Vec<[f64; 4]>> {
        let row = (-0.2..0.2, -0.1..0.1, -0.1..0.1, 0.5..1.5).prop_map(<[f64; 4]>::from);
        proptest::collection::vec(row, 1..=frames)
    }

    #[test]
    fn a_quarter_turn_walks_sideways() {
        let quarter = std::f64::consts::FRAC_PI_4;
        let trajectory = [[-quarter, 0.0, 2.0, 0.9], [0.0, 0.0, 1.0, 1.0], [0.0; 4]];
        let positions = Root::Relative.positions(&trajectory);
        // The body faces +x from the second frame on: forward is +x.
        let expected = [[0.0, 0.9, 0.0], [2.0, 1.0, 0.0], [3.0, 0.0, 0.0]];
        for (found, expected) in positions.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 1e-12);
        }
        assert_eq!(
            Root::Relative.half_angles(&trajectory),
            [0.0, -quarter, -quarter]
        );
    }

    proptest! {
        #[test]
        fn a_relative_trajectory_returns_but_for_its_last_change(trajectory in trajectories(196)) {
            let absolute = Root::Relative.convert(&trajectory, Root::Absolute);
            prop_assert_eq!(
                Root::Absolute.positions(&absolute),
                Root::Relative.positions(&trajectory)
            );
            let back = Root::Absolute.convert(&absolute, Root::Relative);
            for (a, b) in back.iter().zip(&trajectory).take(trajectory.len() - 1) {
                for (a, b) in a.iter().zip(b) {
                    prop_assert!((a - b).abs() < 1e-12);
                }
            }
            if trajectory.len() > 1 {
                prop_assert_eq!(&back[trajectory.len() - 1][..3], &back[trajectory.len() - 2][..3]);
            }
        }

        #[test]
        fn the_ground_gradient_is_that_of_small_changes(trajectory in trajectories(12), pull in -1.0..1.0) {
            let target: Vec<[f64; 2]> =
                (0..trajectory.len()).map(|t| [pull, 0.1 * t as f64]).collect();
            for root in [Root::Relative, Root::Absolute] {
                let (_, gradient) = root.ground_distance(&trajectory, &target);
                for t in 0..trajectory.len() {
                    for channel in 0..4 {
                        let distance = |change: f64| {
                            let mut changed = trajectory.clone();
                            changed[t][channel] += change;
                            root.ground_distance(&changed, &target).0
                        };
                        let slope = (distance(1e-5) - distance(-1e-5)) / 2e-5;
                        prop_assert!((slope - gradient[t][channel]).abs() < 1e-6);
                    }
                }
            }
        }
    }
}
