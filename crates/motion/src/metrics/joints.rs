//! Foot sliding and jerk of a body.

use crate::derivatives::{jerk_of, mean_norm};
use crate::humanml::Joints;
use crate::vector::length;

/// Height below which a foot stands on the ground, metres.
pub const SKATING_HEIGHT: f64 = 0.05;

/// Speed above which a standing foot slides, metres per second: 2.5 cm per frame at 20 frames per
/// second.
pub const SKATING_SPEED: f64 = 0.5;

/// Share of the steps between frames, at `fps` frames per second, in which one of the `feet` (toe
/// joints) slides. A sliding foot is below [`SKATING_HEIGHT`] in both frames and horizontally
/// faster than [`SKATING_SPEED`]. `None` for fewer than two frames.
pub fn sliding_ratio(joints: &Joints, fps: f64, feet: &[usize]) -> Option<f64> {
    share_of_steps(joints, fps, feet, |step| {
        step.contact && step.speed > SKATING_SPEED
    })
}

/// Foot skating of the published evaluation (docs/sources.md, section 4.13): a [`sliding_ratio`] in
/// which the mean speed over five steps must also exceed [`SKATING_SPEED`]. Steps beyond the ends
/// count as zero. `None` for fewer than two frames.
pub fn skating_ratio(joints: &Joints, fps: f64, feet: &[usize]) -> Option<f64> {
    share_of_steps(joints, fps, feet, |step| {
        step.contact && step.speed > SKATING_SPEED && step.mean_speed > SKATING_SPEED
    })
}

/// Share of the steps in which one of the `feet` `slides`.
fn share_of_steps(
    joints: &Joints,
    fps: f64,
    feet: &[usize],
    slides: fn(&SkatingStep) -> bool,
) -> Option<f64> {
    let feet = feet.iter().map(|&foot| skating_steps(joints, fps, foot));
    let feet: Vec<Vec<SkatingStep>> = feet.collect();
    let steps = joints.frames() - 1;
    let slid = (0..steps).filter(|&t| feet.iter().any(|foot| slides(&foot[t])));
    (steps > 0).then(|| slid.count() as f64 / steps as f64)
}

/// A step of a foot between frames.
#[derive(Clone, Copy, Debug)]
pub struct SkatingStep {
    /// True if the foot is on the ground in both frames.
    pub contact: bool,
    /// Horizontal speed, metres per second.
    pub speed: f64,
    /// Mean speed over five steps, with this one in the middle.
    pub mean_speed: f64,
}

/// The steps of a foot, for [`skating_ratio`].
pub fn skating_steps(joints: &Joints, fps: f64, foot: usize) -> Vec<SkatingStep> {
    let track = joints.track(foot);
    let speed = |pair: &[[f64; 3]]| (pair[1][0] - pair[0][0]).hypot(pair[1][2] - pair[0][2]) * fps;
    let speeds: Vec<f64> = track.windows(2).map(speed).collect();
    let step = |(t, &speed): (usize, &f64)| {
        let around = &speeds[t.saturating_sub(2)..speeds.len().min(t + 3)];
        SkatingStep {
            contact: track[t][1] < SKATING_HEIGHT && track[t + 1][1] < SKATING_HEIGHT,
            speed,
            mean_speed: around.iter().sum::<f64>() / 5.0,
        }
    };
    speeds.iter().enumerate().map(step).collect()
}

/// Jerk norms of all joints, metres per second cubed, one joint after another; empty below four frames.
pub fn jerk_norms(joints: &Joints, fps: f64) -> Vec<f64> {
    let of_joint = |joint| jerk_of(&joints.track(joint), fps);
    let jerks = (0..joints.joints()).flat_map(of_joint);
    jerks.map(length).collect()
}

/// Height of the lowest joint of each frame, metres, `[frames]`.
pub fn lowest_heights(joints: &Joints) -> Vec<f64> {
    let lowest = |t: usize| {
        let heights = joints.frame(t).iter().map(|place| place[1]);
        heights.fold(f64::INFINITY, f64::min)
    };
    (0..joints.frames()).map(lowest).collect()
}

/// Mean jerk norm over joints and frames, metres per second cubed; `None` for fewer than four
/// frames.
pub fn mean_jerk(joints: &Joints, fps: f64) -> Option<f64> {
    let jerk = |joint: usize| mean_norm(&jerk_of(&joints.track(joint), fps));
    let sum = || (0..joints.joints()).map(jerk).sum::<f64>();
    (joints.frames() >= 4).then(|| sum() / joints.joints() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_low_foot_that_moves_slides() {
        // Joint 0 is high; the feet are joints 1 and 2. Rows are frames at 20 per second.
        let high = [0.0, 1.0, 0.0];
        let positions = [
            [high, [0.0, 0.01, 0.0], [0.0, 0.20, 0.0]],
            // Foot 1 slides by 3 cm.
            [high, [0.018, 0.04, 0.024], [0.0, 0.06, 0.0]],
            // Foot 1 slides by only 2.4 cm; foot 2 was high in the previous frame.
            [high, [0.018, 0.04, 0.048], [1.0, 0.04, 0.0]],
            // Foot 1 leaves the ground; foot 2 moves only vertically.
            [high, [0.5, 0.05, 0.048], [1.0, 0.0, 0.0]],
            [high, [0.9, 0.3, 0.048], [1.0, 0.04, -0.1]],
        ];
        let ratio = |fps, feet: &[usize]| {
            let joints = Joints::new(positions.as_flattened().to_vec(), 3).unwrap();
            sliding_ratio(&joints, fps, feet)
        };
        assert_eq!(ratio(20.0, &[1, 2]), Some(0.5));
        assert_eq!(ratio(20.0, &[1]), Some(0.25));
        // In half the time, 2.4 cm are a slide too.
        assert_eq!(ratio(40.0, &[1]), Some(0.5));
        assert_eq!(ratio(20.0, &[0]), Some(0.0));
        assert_eq!(ratio(20.0, &[]), Some(0.0));
        let one = Joints::new(positions[0].to_vec(), 3).unwrap();
        assert_eq!(sliding_ratio(&one, 20.0, &[1]), None);
        // Positions that are not finite are not valid joints.
        let nan = [[0.0, f64::NAN, 0.0], [0.0; 3]];
        assert!(Joints::new(nan.to_vec(), 1).is_err());
    }

    #[test]
    fn a_single_quick_step_slides_and_does_not_skate() {
        // One joint is on the ground; 0.5 m/s is 2.5 cm per frame.
        let ratio = |steps: &[f64]| {
            let mut x = 0.0;
            let mut places = vec![[0.0; 3]];
            for step in steps {
                x += step;
                places.push([x, 0.0, 0.0]);
            }
            let joints = Joints::new(places, 1).unwrap();
            [
                skating_ratio(&joints, 20.0, &[0]),
                sliding_ratio(&joints, 20.0, &[0]),
            ]
        };
        let quick = [0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(ratio(&quick), [Some(0.0), Some(1.0 / 8.0)]);
        let slide = [0.0, 0.0, 0.05, 0.05, 0.05, 0.05, 0.05, 0.0];
        // The five-step mean is 4 cm at the second and second-last sliding step, 3 cm at the outer
        // steps.
        assert_eq!(ratio(&slide), [Some(5.0 / 8.0); 2]);
        // A slow step does not skate, and steps beyond the ends are zero.
        let slide = [0.05, 0.05, 0.01, 0.05, 0.05];
        assert_eq!(ratio(&slide), [Some(2.0 / 5.0), Some(4.0 / 5.0)]);
        assert_eq!(ratio(&[]), [None; 2]);
    }

    #[test]
    fn jerk_is_the_third_derivative() {
        // x = t^3 with t in seconds has a jerk of 6, z = 0.5 t^2 a jerk of 0. Differences are
        // exact.
        let fps = 4.0;
        let body = |frame: usize| {
            let t = frame as f64 / fps;
            [[t.powi(3), 1.0, 0.0], [0.0, 0.0, 0.5 * t * t]]
        };
        let positions: Vec<[[f64; 3]; 2]> = (0..6).map(body).collect();
        let joints = |frames: usize| {
            let places = positions[..frames].as_flattened().to_vec();
            Joints::new(places, 2).unwrap()
        };
        assert!((mean_jerk(&joints(6), fps).unwrap() - 3.0).abs() < 1e-12);
        assert_eq!(mean_jerk(&joints(3), fps), None);
    }
}
