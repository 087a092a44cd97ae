//! How a body moves: feet that slide, and how jerky the joints are.

use crate::kinematics::{self, mean_norm};

/// A foot below this height stands on the ground, metres.
pub const SKATING_HEIGHT: f64 = 0.05;

/// A standing foot that moves faster than this slides, metres per second: the published 2.5 cm
/// between two frames at 20 frames per second.
pub const SKATING_SPEED: f64 = 0.5;

/// Positions of a body's joints, frame by frame, metres with +y up.
#[derive(Clone, Copy, Debug)]
pub struct JointTracks<'a> {
    positions: &'a [[f64; 3]],
    joints: usize,
    fps: f64,
}

impl<'a> JointTracks<'a> {
    /// Positions `[frames, joints, 3]` at `fps` frames per second.
    ///
    /// # Panics
    /// Panics if these are not whole frames, or `fps` is not positive.
    pub fn new(positions: &'a [[f64; 3]], joints: usize, fps: f64) -> Self {
        assert!(
            joints > 0 && positions.len().is_multiple_of(joints),
            "whole frames of {joints} joints"
        );
        assert!(fps > 0.0, "{fps} frames per second");
        Self {
            positions,
            joints,
            fps,
        }
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.positions.len() / self.joints
    }

    /// Where `joint` is in frame `t`.
    fn at(&self, t: usize, joint: usize) -> [f64; 3] {
        self.positions[t * self.joints + joint]
    }

    fn finite(&self) -> bool {
        self.positions
            .iter()
            .flatten()
            .all(|value| value.is_finite())
    }

    /// Share of the steps from one frame to the next in which one of the `feet` (the toes' joints)
    /// slides: it is below [`SKATING_HEIGHT`] in both frames and moves horizontally faster than
    /// [`SKATING_SPEED`]. `None` for fewer than two frames or where a value is not finite.
    ///
    /// # Panics
    /// Panics if a foot is not among the joints.
    pub fn skating_ratio(&self, feet: &[usize]) -> Option<f64> {
        assert!(
            feet.iter().all(|foot| *foot < self.joints),
            "feet are joints"
        );
        let steps = self.frames().saturating_sub(1);
        let slides = |t: usize, foot: usize| {
            let (here, there) = (self.at(t, foot), self.at(t + 1, foot));
            let speed = (there[0] - here[0]).hypot(there[2] - here[2]) * self.fps;
            here[1] < SKATING_HEIGHT && there[1] < SKATING_HEIGHT && speed > SKATING_SPEED
        };
        let slid = (0..steps).filter(|&t| feet.iter().any(|&foot| slides(t, foot)));
        (steps > 0 && self.finite()).then(|| slid.count() as f64 / steps as f64)
    }

    /// Mean over joints and frames of the Euclidean norm of the third difference of position times
    /// the cube of the frame rate, metres per second cubed. `None` for fewer than four frames or
    /// where a value is not finite.
    pub fn mean_jerk(&self) -> Option<f64> {
        if self.frames() < 4 || !self.finite() {
            return None;
        }
        let jerk_of = |joint: usize| {
            let track: Vec<_> = (0..self.frames()).map(|t| self.at(t, joint)).collect();
            mean_norm(&kinematics::jerk_of(&track, self.fps))
        };
        Some((0..self.joints).map(jerk_of).sum::<f64>() / self.joints as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_low_foot_that_moves_slides() {
        // Joint 0 is high above; the feet are joints 1 and 2. Rows are frames at 20 per second.
        let high = [0.0, 1.0, 0.0];
        let positions = [
            [high, [0.0, 0.01, 0.0], [0.0, 0.20, 0.0]],
            // Foot 1 slides by 3 cm.
            [high, [0.018, 0.04, 0.024], [0.0, 0.06, 0.0]],
            // It slides by 2.4 cm only; foot 2 was high in the frame before.
            [high, [0.018, 0.04, 0.048], [1.0, 0.04, 0.0]],
            // It leaves the ground; foot 2 moves up and down only.
            [high, [0.5, 0.05, 0.048], [1.0, 0.0, 0.0]],
            [high, [0.9, 0.3, 0.048], [1.0, 0.04, -0.1]],
        ];
        let ratio = |fps, feet: &[usize]| {
            JointTracks::new(positions.as_flattened(), 3, fps).skating_ratio(feet)
        };
        assert_eq!(ratio(20.0, &[1, 2]), Some(0.5));
        assert_eq!(ratio(20.0, &[1]), Some(0.25));
        // In half the time 2.4 cm are too many, too.
        assert_eq!(ratio(40.0, &[1]), Some(0.5));
        assert_eq!(ratio(20.0, &[0]), Some(0.0));
        assert_eq!(ratio(20.0, &[]), Some(0.0));
        let one = JointTracks::new(positions[0].as_slice(), 3, 20.0);
        assert_eq!(one.skating_ratio(&[1]), None);
        let nan = [[0.0, f64::NAN, 0.0], [0.0; 3]];
        assert_eq!(JointTracks::new(&nan, 1, 20.0).skating_ratio(&[0]), None);
    }

    #[test]
    fn jerk_is_the_third_derivative() {
        // x = t^3 with t in seconds has a jerk of 6, z = 0.5 t^2 none; differences are exact.
        let fps = 4.0;
        let body = |frame: usize| {
            let t = frame as f64 / fps;
            [[t.powi(3), 1.0, 0.0], [0.0, 0.0, 0.5 * t * t]]
        };
        let positions: Vec<[[f64; 3]; 2]> = (0..6).map(body).collect();
        let tracks = JointTracks::new(positions.as_flattened(), 2, fps);
        assert!((tracks.mean_jerk().unwrap() - 3.0).abs() < 1e-12);
        let short = JointTracks::new(&positions.as_flattened()[..6], 2, fps);
        assert_eq!(short.mean_jerk(), None);
    }
}
