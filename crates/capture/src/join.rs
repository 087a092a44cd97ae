//! Joins between segments, so that the root is continuous.
//!
//! Where two successive frames are not neighbours in the capture, all later frames are rotated
//! about the vertical and moved on the floor, so that heading and velocity are continuous. The
//! jumps in height and tilt are corrected in the first frame, and the correction fades over
//! `fade_frames` with the weight
//! ```text
//! w = 1 - u^3 (10 - 15 u + 6 u^2),    u = frames since the border / fade_frames
//! ```

use kinegrad_settings::InvalidSetting;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use kinegrad_motion::Quaternion;

use crate::error::require;
use crate::{Assembly, Error, RootPose, RootSource, RootTrack};

/// Detection and smoothing of joins between segments.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Joining {
    /// Frames over which a jump in height and tilt is faded out.
    pub fade_frames: usize,
    /// Largest step in the capture, in seconds, between two successive frames without a join. The
    /// default is 4.5 frames at 80 per second: 1.7 times the pace of the music.
    pub max_step_seconds: f64,
}

impl Default for Joining {
    fn default() -> Self {
        Self {
            fade_frames: 15,
            max_step_seconds: 4.5 / 80.0,
        }
    }
}

impl Joining {
    /// Checks that `max_step_seconds` is positive.
    ///
    /// # Errors
    /// If it is not.
    pub fn check(&self) -> Result<(), InvalidSetting> {
        let seconds = self.max_step_seconds;
        let allowed = "a positive number of seconds of capture";
        require(seconds > 0.0, "max_step_seconds", seconds, allowed)
    }
}

/// The track of an assembly without jumps, and the frames that begin after a join. Each run of
/// valid frames is joined within itself; after a gap the root keeps its captured place.
///
/// # Errors
/// [`Error::Setting`] if `max_step_seconds` is not positive.
pub fn join(assembly: &Assembly, joining: &Joining) -> Result<(RootTrack, Vec<usize>), Error> {
    joining.check()?;
    let track = &assembly.track;
    let mut joined: Vec<Option<RootPose>> = vec![None; track.frames()];
    let mut borders = Vec::new();
    for stretch in track.stretches() {
        let start = stretch.start;
        let mut shift = Shift::none();
        for t in stretch {
            let Some(captured) = track.pose(t) else {
                continue;
            };
            if t > start
                && is_border(assembly, t, joining)
                && let Some(last) = joined[t - 1]
            {
                let earlier = if t > start + 1 { joined[t - 2] } else { None };
                shift = Shift::new(last, earlier.unwrap_or(last), captured, t);
                borders.push(t);
            }
            joined[t] = Some(shift.apply(captured, t, joining.fade_frames));
        }
    }
    Ok((RootTrack::from_poses(joined, track.rate())?, borders))
}

fn is_border(assembly: &Assembly, t: usize, joining: &Joining) -> bool {
    let (Some(before), Some(now)) = (assembly.moments[t - 1], assembly.moments[t]) else {
        return true;
    };
    let step = now.seconds - before.seconds;
    now.take != before.take || step < 0.0 || step > joining.max_step_seconds
}

/// Correction of captured poses from a join on.
struct Shift {
    border: usize,
    turn: Quaternion,
    floor: [f64; 2],
    /// Metres from the captured height at the border up to the expected height.
    rise: f64,
    /// Rotation vector in radians that takes the turned orientation at the border to the
    /// orientation before it.
    tilt: [f64; 3],
}

impl Shift {
    fn none() -> Self {
        Self {
            border: 0,
            turn: Quaternion::IDENTITY,
            floor: [0.0; 2],
            rise: 0.0,
            tilt: [0.0; 3],
        }
    }

    /// The correction with which `captured` in frame `border` continues `last` and `earlier`, the
    /// two frames before.
    fn new(last: RootPose, earlier: RootPose, captured: RootPose, border: usize) -> Self {
        let heading = last.orientation.yaw() - captured.orientation.yaw();
        let turn = Quaternion::from_yaw(heading);
        let turned = turn.rotate(captured.position);
        // The velocity is a difference of joined frames, so that two joins in a row agree.
        let expected = [0, 1, 2].map(|i| 2.0 * last.position[i] - earlier.position[i]);
        let left = last.orientation * (turn * captured.orientation).conjugate();
        Self {
            border,
            turn,
            floor: [expected[0] - turned[0], expected[2] - turned[2]],
            rise: expected[1] - turned[1],
            tilt: left.to_rotation_vector(),
        }
    }

    fn apply(&self, captured: RootPose, t: usize, fade_frames: usize) -> RootPose {
        let age = t - self.border;
        let u = age as f64 / fade_frames as f64;
        let weight = match age < fade_frames {
            true => 1.0 - u.powi(3) * (10.0 - 15.0 * u + 6.0 * u * u),
            false => 0.0,
        };
        let [x, y, z] = self.turn.rotate(captured.position);
        let tilt = Quaternion::from_rotation_vector(self.tilt.map(|v| v * weight));
        RootPose {
            position: [x + self.floor[0], y + weight * self.rise, z + self.floor[1]],
            orientation: tilt * self.turn * captured.orientation,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{Segment, assemble};
    use kinegrad_data::synthetic;
    use kinegrad_motion::FPS;
    use kinegrad_motion::derivatives::{angular_velocity, forward_differences};
    use kinegrad_motion::phrase::POSITION;
    use kinegrad_motion::vector::length;

    /// A dancer captured at the pace of the music.
    fn take(seed: u64, frames: usize) -> RootTrack {
        let dancer = synthetic::phrase(0, frames, seed).motion;
        let poses = (0..frames).map(|t| {
            Some(RootPose {
                position: dancer.vector(t, POSITION),
                orientation: dancer.quaternion(t),
            })
        });
        RootTrack::from_poses(poses.collect(), FPS).unwrap()
    }

    /// Pieces of 30 frames, each from a take and its first frame.
    fn pieces(takes: &[RootTrack], from: &[(usize, usize)]) -> Assembly {
        let sources: Vec<&dyn RootSource> = takes.iter().map(|t| t as &dyn RootSource).collect();
        let segment = |(k, (take, first)): (usize, &(usize, usize))| Segment {
            take: *take,
            capture_frames: *first as f64..(first + 30) as f64,
            start_seconds: k as f64,
            seconds: 1.0,
        };
        let segments: Vec<Segment> = from.iter().enumerate().map(segment).collect();
        assemble(&sources, &segments, 30 * from.len()).unwrap()
    }

    proptest! {
        #[test]
        fn the_root_continues_over_a_border(seed: u64, second in 0usize..60) {
            // The capture goes from frame 29 to `second`: the same or the next frame makes no border.
            prop_assume!(!(29..=30).contains(&second));
            let takes = [take(seed, 100)];
            let assembly = pieces(&takes, &[(0, 0), (0, second)]);
            let (track, borders) = join(&assembly, &Joining::default()).unwrap();
            prop_assert_eq!(borders, vec![30]);
            let velocity = forward_differences(&track.positions, FPS);
            let jump = [0, 1, 2].map(|i| velocity[29][i] - velocity[28][i]);
            prop_assert!(length(jump) < 1e-9, "the velocity is continuous: {jump:?}");
            let turning = angular_velocity(&track.orientations, FPS);
            prop_assert!(length(turning[29]) < 1e-9, "the orientation is continuous: {turning:?}");
            // After the fade, only a rotation about the vertical and a move on the floor are left.
            for t in 45..60 {
                let captured = takes[0].pose(second + t - 30).unwrap();
                let joined = track.pose(t).unwrap();
                prop_assert!((captured.position[1] - joined.position[1]).abs() < 1e-9);
                let turn = joined.orientation * captured.orientation.conjugate();
                prop_assert!(turn.x.abs().max(turn.z.abs()) < 1e-9, "{turn:?}");
            }
        }
    }

    #[test]
    fn neighbours_in_the_capture_are_left_alone() {
        let takes = [take(7, 100)];
        let assembly = pieces(&takes, &[(0, 0), (0, 30), (0, 60)]);
        let (track, borders) = join(&assembly, &Joining::default()).unwrap();
        assert!(borders.is_empty());
        for t in 0..90 {
            let (joined, captured) = (track.pose(t).unwrap(), takes[0].pose(t).unwrap());
            assert!(joined.orientation.dot(captured.orientation).abs() > 1.0 - 1e-12);
            for axis in 0..3 {
                assert!((joined.position[axis] - captured.position[axis]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn another_take_is_a_border_even_at_the_next_frame() {
        let assembly = pieces(&[take(7, 100), take(8, 100)], &[(0, 0), (1, 30)]);
        let (_, borders) = join(&assembly, &Joining::default()).unwrap();
        assert_eq!(borders, [30]);
    }

    #[test]
    fn without_a_fade_height_and_tilt_jump() {
        let takes = [take(7, 100)];
        let sharp = Joining {
            fade_frames: 0,
            ..Joining::default()
        };
        let (track, _) = join(&pieces(&takes, &[(0, 50), (0, 0)]), &sharp).unwrap();
        let [_, height, _] = track.positions[30];
        assert!((height - takes[0].positions[0][1]).abs() < 1e-12);
        // The heading is still continuous.
        let yaws = [29, 30].map(|t| track.orientations[t].yaw());
        assert!((yaws[0] - yaws[1]).abs() < 1e-9);
    }

    #[test]
    fn after_a_gap_the_root_is_where_it_was_captured() {
        let takes = [take(7, 100)];
        let mut assembly = pieces(&takes, &[(0, 50), (0, 0)]);
        let poses = (0..60).map(|t| assembly.track.pose(t).filter(|_| t != 29));
        assembly.track = RootTrack::from_poses(poses.collect(), FPS).unwrap();
        let (track, borders) = join(&assembly, &Joining::default()).unwrap();
        assert!(borders.is_empty());
        assert_eq!(track.stretches(), [0..29, 30..60]);
        assert_eq!(track.positions[30], takes[0].positions[0]);
        let never = Joining {
            max_step_seconds: 0.0,
            ..Joining::default()
        };
        assert!(join(&assembly, &never).is_err());
    }
}
