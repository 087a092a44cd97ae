//! Direction of a ground track in each frame.

use std::f64::consts::{PI, TAU};

use super::{STILL, smoothed};
use crate::circular;

/// Path features of a frame for a network (docs/sources.md, section 7, option C).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathFeatures {
    /// Ground position `[x, z]`, metres.
    pub position: [f64; 2],
    /// Step per frame: central differences, one-sided at both ends.
    pub step: [f64; 2],
    /// Direction of the step, radians, -pi to pi. Frames that hardly move repeat the last
    /// direction, or have 0.
    pub heading: f64,
    /// Change of the heading per metre; 0 in frames that hardly move.
    pub curvature: f64,
}

impl PathFeatures {
    /// The features of a track with one position per frame.
    pub fn of(track: &[[f64; 2]]) -> Vec<Self> {
        let steps = gradient(track);
        let seconds = gradient(&steps);
        let headings = headings_above(&steps, STILL);
        let of_frame = |t: usize| {
            let ([dx, dz], [ddx, ddz]) = (steps[t], seconds[t]);
            let speed = dx.hypot(dz);
            Self {
                position: track[t],
                step: steps[t],
                heading: wrapped(headings[t]),
                curvature: match speed < STILL {
                    true => 0.0,
                    false => (dz * ddx - dx * ddz) / speed.powi(3),
                },
            }
        };
        (0..track.len()).map(of_frame).collect()
    }
}

/// The heading of each frame of a track, as in [`PathFeatures`].
pub fn headings_of(track: &[[f64; 2]]) -> Vec<f64> {
    headings_above(&gradient(track), STILL)
}

/// Headings of a walk without sway. Steps below `least` metres repeat the previous heading.
pub fn headings_of_gait(track: &[[f64; 2]], least: f64) -> Vec<f64> {
    headings_above(&gradient(&without_sway(track)), least.max(STILL))
}

/// A track without the sway of steps.
pub(super) fn without_sway(track: &[[f64; 2]]) -> Vec<[f64; 2]> {
    smoothed(track, GAIT_WINDOW, 1)
}

/// Smoothing window for a gait, frames: about one step.
const GAIT_WINDOW: usize = 13;

/// Directions of steps. Steps shorter than `least` repeat the previous direction.
fn headings_above(steps: &[[f64; 2]], least: f64) -> Vec<f64> {
    let moving = |[dx, dz]: &[f64; 2]| dx.hypot(*dz) >= least;
    let heading = |[dx, dz]: &[f64; 2]| dx.atan2(*dz);
    let mut last = steps.iter().find(|step| moving(step)).map_or(0.0, heading);
    let of_frame = |step| {
        if moving(step) {
            last = heading(step);
        }
        last
    };
    steps.iter().map(of_frame).collect()
}

/// Central differences per frame, one-sided at both ends.
fn gradient(track: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let last = track.len().saturating_sub(1);
    let difference = |t: usize| {
        let (from, to) = (t.saturating_sub(1), (t + 1).min(last));
        let frames = (to - from).max(1) as f64;
        [0, 1].map(|i| (track[to][i] - track[from][i]) / frames)
    };
    (0..track.len()).map(difference).collect()
}

/// Angles without jumps: each is within half a turn of the previous angle.
pub fn unwrapped(angles: &[f64]) -> Vec<f64> {
    let mut last: Option<f64> = None;
    let unwrap = |angle: &f64| {
        let here = last.map_or(*angle, |last| last + wrapped(angle - last));
        last = Some(here);
        here
    };
    angles.iter().map(unwrap).collect()
}

/// The angle in (-pi, pi].
pub fn wrapped(angle: f64) -> f64 {
    let turned = circular::wrapped(angle);
    match turned <= -PI {
        true => turned + TAU,
        false => turned,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_circle_has_the_curvature_of_its_radius() {
        let track: Vec<[f64; 2]> = (0..60)
            .map(|t| 0.05 * f64::from(t))
            .map(|a| [3.0 * a.sin(), 3.0 * a.cos()])
            .collect();
        let features = PathFeatures::of(&track);
        for frame in &features[2..58] {
            // The circle turns from +z towards +x: the heading grows.
            assert!(
                (frame.curvature - 1.0 / 3.0).abs() < 1e-3,
                "{}",
                frame.curvature
            );
        }
        let turned = unwrapped(&headings_of(&track));
        assert!((turned[58] - turned[1] - 57.0 * 0.05).abs() < 1e-9);
    }

    #[test]
    fn a_standing_body_keeps_its_heading_and_one_that_never_moves_has_none() {
        let mut track = vec![[0.0, 0.0]; 3];
        track.extend([[0.1, 0.0], [0.2, 0.0]]);
        track.extend([[0.2, 0.0]; 4]);
        let features = PathFeatures::of(&track);
        for frame in &features {
            assert!((frame.heading - PI / 2.0).abs() < 1e-12);
        }
        assert_eq!(features[8].curvature, 0.0);
        assert_eq!(headings_of(&[[2.0, 1.0]; 5]), [0.0; 5]);
        assert_eq!(headings_of(&[[2.0, 1.0]]), [0.0]);
        assert!(PathFeatures::of(&[]).is_empty());
    }

    #[test]
    fn angles_unwrap_by_shortest_steps() {
        let found = unwrapped(&[3.0, -3.0, 2.5, -2.5]);
        assert!(found.windows(2).all(|pair| (pair[1] - pair[0]).abs() <= PI));
        assert_eq!(wrapped(PI), PI);
        assert_eq!(wrapped(-PI), PI);
        assert!((wrapped(7.0) - (7.0 - TAU)).abs() < 1e-12);
    }
}
