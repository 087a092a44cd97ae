//! The position on a path of each frame.

use serde::{Deserialize, Serialize};

use super::{Polyline, STILL, between};
use crate::humanml::Joints;

/// Arc length along a path over the frames of a motion.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ArcLengthMode {
    /// The full path, in the trajectory's proportions. A standing motion advances evenly.
    #[default]
    Stretch,
    /// The motion's own arc length and speed; at the end of the path the motion stands.
    Own,
}

/// A position on a path for each frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    /// Arc length on the path, metres, `[frames]`.
    pub metres: Vec<f64>,
    /// Ground positions, `[frames]`.
    pub points: Vec<[f64; 2]>,
}

impl Course {
    /// The course along `path` of a root at `track`.
    pub fn of_motion(path: &Polyline, track: &[[f64; 2]], along: ArcLengthMode) -> Self {
        let walked = walked(track);
        let total = walked.last().copied().unwrap_or(0.0);
        let length = path.length();
        let metres = match along {
            ArcLengthMode::Stretch => {
                let last = track.len().saturating_sub(1).max(1) as f64;
                let share = |(t, metres): (usize, &f64)| match total < STILL {
                    true => t as f64 / last,
                    false => metres / total,
                };
                let shares = walked.iter().enumerate().map(share);
                shares.map(|share| share * length).collect()
            }
            ArcLengthMode::Own => return Self::at_pace(path, track, 1.0),
        };
        Self::at(path, metres)
    }

    /// The course along `path` of a root at `track` with `pace` times its arc length, standing at the
    /// end.
    pub fn at_pace(path: &Polyline, track: &[[f64; 2]], pace: f64) -> Self {
        let metres = walked(track).into_iter();
        let metres = metres.map(|metres| (pace * metres).min(path.length()));
        Self::at(path, metres.collect())
    }

    /// The course of `frames` frames along `path` at `speed` metres per second, standing at the
    /// end. Without a speed, the course covers the path evenly.
    pub fn at_speed(path: &Polyline, frames: usize, speed: Option<f64>, fps: f64) -> Self {
        let length = path.length();
        let step = match speed {
            Some(speed) => speed / fps,
            None => length / frames.saturating_sub(1).max(1) as f64,
        };
        let metres = (0..frames).map(|t| (t as f64 * step).min(length));
        Self::at(path, metres.collect())
    }

    /// The course through `points`, one point per frame.
    pub fn through(points: Vec<[f64; 2]>) -> Self {
        Self {
            metres: walked(&points),
            points,
        }
    }

    fn at(path: &Polyline, metres: Vec<f64>) -> Self {
        let points = metres.iter().map(|&metres| path.at_metres(metres).point);
        Self {
            points: points.collect(),
            metres,
        }
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.points.len()
    }
}

/// Ground positions of the root.
pub(super) fn ground(joints: &Joints) -> Vec<[f64; 2]> {
    joints.track(0).iter().map(|[x, _, z]| [*x, *z]).collect()
}

/// Arc length of a track at each frame, metres.
pub(super) fn walked(track: &[[f64; 2]]) -> Vec<f64> {
    let mut metres = 0.0;
    let covered = |t: usize| {
        if t > 0 {
            metres += between(track[t - 1], track[t]);
        }
        metres
    };
    (0..track.len()).map(covered).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(length: f64) -> Polyline {
        Polyline::new(vec![[0.0, 0.0], [0.0, length]]).unwrap()
    }

    #[test]
    fn a_motion_is_stretched_or_keeps_its_metres() {
        let track: Vec<[f64; 2]> = [0.0, 1.0, 1.0, 3.0, 4.0].map(|x| [x, 0.0]).to_vec();
        let stretched = Course::of_motion(&line(8.0), &track, ArcLengthMode::Stretch);
        assert_eq!(stretched.metres, [0.0, 2.0, 2.0, 6.0, 8.0]);
        assert_eq!(stretched.points[3], [0.0, 6.0]);
        let own = Course::of_motion(&line(8.0), &track, ArcLengthMode::Own);
        assert_eq!(own.metres, [0.0, 1.0, 1.0, 3.0, 4.0]);
        // At the end of a shorter path the course stands.
        let own = Course::of_motion(&line(2.0), &track, ArcLengthMode::Own);
        assert_eq!(own.metres, [0.0, 1.0, 1.0, 2.0, 2.0]);
        let fast = Course::at_pace(&line(5.0), &track, 1.5);
        assert_eq!(fast.metres, [0.0, 1.5, 1.5, 4.5, 5.0]);
        let standing = [[1.0, 1.0]; 3];
        assert_eq!(
            Course::of_motion(&line(4.0), &standing, ArcLengthMode::Stretch).metres,
            [0.0, 2.0, 4.0]
        );
        assert_eq!(
            Course::of_motion(&line(4.0), &standing, ArcLengthMode::Own).metres,
            [0.0; 3]
        );
    }

    #[test]
    fn a_stated_speed_stands_at_the_end() {
        let at = |speed| Course::at_speed(&line(2.0), 5, speed, 2.0).metres;
        assert_eq!(at(None), [0.0, 0.5, 1.0, 1.5, 2.0]);
        assert_eq!(at(Some(1.6)), [0.0, 0.8, 1.6, 2.0, 2.0]);
        assert_eq!(at(Some(0.4)), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8]);
        assert_eq!(Course::at_speed(&line(2.0), 1, None, 20.0).metres, [0.0]);
    }
}
