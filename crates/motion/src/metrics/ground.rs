//! Measures of the root's path on the ground, between its frames too.

use serde::{Deserialize, Serialize};

use crate::goal::Obstacle;

/// A step of a path: the move from one frame to the next.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
pub struct PathStep {
    /// The frame that it ends in, from 0.
    pub frame: usize,
    /// Metres per second.
    pub speed: f64,
}

/// The speed of each step of a path, m/s: of `ground` positions `[x, z]` in metres, `fps` a second.
pub fn step_speeds(ground: &[[f64; 2]], fps: f64) -> impl Iterator<Item = f64> {
    let steps = ground.windows(2);
    steps.map(move |pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]) * fps)
}

/// The fastest step of a path; `None` of fewer than two frames. A step that is not finite counts as
/// the fastest.
pub fn fastest_step(ground: &[[f64; 2]], fps: f64) -> Option<PathStep> {
    let steps = step_speeds(ground, fps).enumerate();
    let (before, speed) = steps.max_by(|a, b| a.1.total_cmp(&b.1))?;
    let frame = before + 1;
    Some(PathStep { frame, speed })
}

/// The clearance of a path from obstacles.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
pub struct Clearance {
    /// Smallest distance from an obstacle, in and between frames, metres; negative inside.
    pub metres: f64,
    /// The frame of that distance, or the one after it.
    pub frame: usize,
    /// Number of frames inside an obstacle, or reached from outside of it by a step across it.
    pub frames_inside: usize,
}

/// The clearance of a path, measured along the straight line between its frames; `None` without
/// obstacles or frames.
pub fn clearance(ground: &[[f64; 2]], obstacles: &[Obstacle]) -> Option<Clearance> {
    let mut nearest: Option<Clearance> = None;
    let mut frames_inside = 0;
    let mut was_inside = false;
    for (frame, &at) in ground.iter().enumerate() {
        let from = ground[frame.saturating_sub(1)];
        let mut is_inside = false;
        let mut is_crossed = false;
        for obstacle in obstacles {
            let metres = obstacle.swept_distance(from, at);
            is_crossed |= metres < 0.0;
            is_inside |= obstacle.signed_distance(at) < 0.0;
            if nearest.is_none_or(|least| metres.is_nan() || metres < least.metres) {
                nearest = Some(Clearance {
                    metres,
                    frame,
                    frames_inside,
                });
            }
        }
        // The first frame after an obstacle is outside of it.
        frames_inside += usize::from(is_inside || is_crossed && !was_inside);
        was_inside = is_inside;
    }
    nearest.map(|nearest| Clearance {
        frames_inside,
        ..nearest
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fastest_step_has_its_frame() {
        let path = [[0.0, 0.0], [0.0, 0.1], [0.3, 0.5], [0.3, 0.5]];
        let fastest = fastest_step(&path, 20.0).expect("steps");
        assert_eq!(fastest.frame, 2);
        assert!((fastest.speed - 10.0).abs() < 1e-12);
        assert_eq!(fastest_step(&path[..1], 20.0), None);
        let broken = fastest_step(&[[0.0; 2], [f64::NAN, 0.0], [9.0, 0.0]], 20.0);
        assert!(broken.expect("steps").speed.is_nan());
    }

    #[test]
    fn a_path_that_hops_over_an_obstacle_is_inside_it_for_a_frame() {
        let disc = |x, radius| Obstacle::Disc { x, z: 0.0, radius };
        let hop = [[0.0, 0.0], [1.0, 0.1], [3.0, 0.1], [4.0, 0.1]];
        let found = clearance(&hop, &[disc(2.0, 0.5)]).expect("an obstacle");
        assert_eq!((found.frame, found.frames_inside), (2, 1));
        assert!((found.metres + 0.4).abs() < 1e-12);
        // In it for two frames: leaving it is not another.
        let walk = [[1.0, 0.0], [1.8, 0.0], [2.2, 0.0], [3.0, 0.0]];
        let found = clearance(&walk, &[disc(2.0, 0.5)]).expect("an obstacle");
        assert_eq!(found.frames_inside, 2);
        let found = clearance(&hop, &[disc(2.0, 0.05), disc(9.0, 1.0)]).expect("obstacles");
        assert_eq!((found.frame, found.frames_inside), (2, 0));
        assert!((found.metres - 0.05).abs() < 1e-12);
        assert_eq!(clearance(&hop, &[]), None);
        assert_eq!(clearance(&[], &[disc(0.0, 1.0)]), None);
        let broken = clearance(&[[0.0; 2], [f64::NAN, 0.0]], &[disc(9.0, 1.0)]);
        assert!(broken.expect("an obstacle").metres.is_nan());
    }
}
