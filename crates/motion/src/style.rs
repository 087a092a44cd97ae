//! The eight style channels, measured from recorded motion.
//!
//! The source learns the style (CC-MotionGen, section 2.5). Here measures replace the four learned
//! pairs:
//!
//! | channels | pair of the source | measures |
//! |---|---|---|
//! | 0, 1 | movement intensity | mean speed (m/s); mean acceleration / 10 (m/s^2) |
//! | 2, 3 | spatial extent | diagonal of the box on the floor (m); range of height (m) |
//! | 4, 5 | rhythmic feel | burstiness; mean turning about the vertical / 3 (rad/s) |
//! | 6, 7 | body attitude | 5 (mean height - median height of the take) (m); mean tilt of the body's up axis from the vertical (rad) |
//!
//! Means cover the frames `t - 15 .. t + 15`, with the ends repeated; extents cover `t - 30 .. t +
//! 30`. Burstiness is the deviation of the floor speed divided by the mean speed + 0.1 m/s.

use crate::derivatives::{angular_velocity, forward_differences};
use crate::quantiles::median;
use crate::vector::length;
use crate::{FPS, Quaternion};

/// Frames of a mean: one second.
const MEAN_FRAMES: usize = 30;

/// Frames of an extent: two seconds.
const EXTENT_FRAMES: usize = 60;

/// Offset of the mean speed in the burstiness, m/s.
const REST_SPEED: f64 = 0.1;

/// Style of each frame, `[frames, 8]`, from positions in metres and unit `orientations` at 30
/// frames per second.
pub fn describe(positions: &[[f64; 3]], orientations: &[Quaternion]) -> Vec<[f64; 8]> {
    let frames = positions.len();
    assert_eq!(frames, orientations.len(), "one orientation a frame");
    let velocity = forward_differences(positions, FPS);
    // The last two accelerations repeat the third-last acceleration.
    let mut acceleration = forward_differences(&velocity[..frames.saturating_sub(1)], FPS);
    acceleration.resize(frames, acceleration.last().copied().unwrap_or_default());

    let of = |measure: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..frames).map(measure).collect() };
    let turning = angular_velocity(orientations, FPS);
    let mean_speed = running_mean(&of(&|t| length(velocity[t])));
    let mean_acceleration = running_mean(&of(&|t| length(acceleration[t])));
    let floor_speed = of(&|t| velocity[t][0].hypot(velocity[t][2]));
    let mean_turning = running_mean(&of(&|t| turning[t][1].abs()));
    let mean_height = running_mean(&of(&|t| positions[t][1]));
    let mean_tilt = running_mean(&of(&|t| tilt(orientations[t])));

    let mean_floor_speed = running_mean(&floor_speed);
    let variance = running_mean(&of(&|t| (floor_speed[t] - mean_floor_speed[t]).powi(2)));
    let median_height = median(of(&|t| positions[t][1]));
    let of_frame = |t: usize| {
        let [width, height, depth] = extent(positions, t);
        [
            mean_speed[t],
            mean_acceleration[t] / 10.0,
            width.hypot(depth),
            height,
            variance[t].sqrt() / (mean_speed[t] + REST_SPEED),
            mean_turning[t] / 3.0,
            5.0 * (mean_height[t] - median_height),
            mean_tilt[t],
        ]
    };
    (0..frames).map(of_frame).collect()
}

/// Means over the frames around each frame, with the ends repeated.
fn running_mean(values: &[f64]) -> Vec<f64> {
    let half = MEAN_FRAMES as isize / 2;
    let last = values.len() as isize - 1;
    let at = |t: isize| values[t.clamp(0, last) as usize];
    let mean = |t: isize| (t - half..t + half).map(at).sum::<f64>() / MEAN_FRAMES as f64;
    (0..=last).map(mean).collect()
}

/// Size of the bounding box of the positions near frame `t`, metres.
fn extent(positions: &[[f64; 3]], t: usize) -> [f64; 3] {
    let half = EXTENT_FRAMES / 2;
    let near = &positions[t.saturating_sub(half)..(t + half).min(positions.len())];
    [0, 1, 2].map(|axis| {
        let along = near.iter().map(|position| position[axis]);
        along.clone().fold(f64::NEG_INFINITY, f64::max) - along.fold(f64::INFINITY, f64::min)
    })
}

/// Angle of the body's up axis from the vertical in radians.
fn tilt(orientation: Quaternion) -> f64 {
    let [x, y, z] = orientation.rotate([0.0, 1.0, 0.0]);
    // Unlike acos, accurate near the vertical.
    x.hypot(z).atan2(y)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_style(found: [f64; 8], expected: [f64; 8]) {
        for (channel, (found, expected)) in found.into_iter().zip(expected).enumerate() {
            assert!(
                (found - expected).abs() < 1e-9,
                "style.{channel}: {found} {expected}"
            );
        }
    }

    #[test]
    fn standing_still_is_tilt_alone() {
        let leaning = Quaternion::from_yaw(1.0) * Quaternion::from_rotation_vector([0.2, 0.0, 0.0]);
        for frames in [1, 2, 3, 100] {
            for style in describe(&vec![[1.0, 0.9, -2.0]; frames], &vec![leaning; frames]) {
                assert_style(style, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2]);
            }
        }
        assert!(describe(&[], &[]).is_empty());
    }

    #[test]
    fn constant_speed_and_turning_have_their_measures() {
        // The body moves at 0.6 m/s along x and 0.8 m/s along z, and turns at 1.5 rad/s.
        let frames = 120;
        let at = |t: usize| t as f64 / FPS;
        let positions: Vec<_> = (0..frames)
            .map(|t| [0.6 * at(t), 1.0, 0.8 * at(t)])
            .collect();
        let turning: Vec<_> = (0..frames)
            .map(|t| Quaternion::from_yaw(1.5 * at(t)))
            .collect();
        let style = describe(&positions, &turning);
        assert_style(style[60], [1.0, 0.0, 59.0 / 30.0, 0.0, 0.0, 0.5, 0.0, 0.0]);
        // The extent is halved at the ends; means do not change.
        assert_style(style[0], [1.0, 0.0, 29.0 / 30.0, 0.0, 0.0, 0.5, 0.0, 0.0]);
        assert_style(style[119], [1.0, 0.0, 1.0, 0.0, 0.0, 0.5, 0.0, 0.0]);
    }

    #[test]
    fn a_rise_shows_in_height_and_acceleration() {
        // Free fall upwards: y = t^2 / 2 seconds, 1 m/s^2.
        let positions: Vec<_> = (0..90)
            .map(|t| [0.0, 0.5 * (f64::from(t) / FPS).powi(2), 0.0])
            .collect();
        let style = describe(&positions, &[Quaternion::IDENTITY; 90]);
        for frame in &style {
            assert!((frame[1] - 0.1).abs() < 1e-9, "{frame:?}");
        }
        assert!(style[10][6] < 0.0 && style[80][6] > 0.0);
        let rise = positions[74][1] - positions[15][1];
        assert!((style[45][3] - rise).abs() < 1e-12);
    }

    #[test]
    fn stop_and_go_is_burstier_than_constant_speed() {
        // The body moves at 1 m/s and rests, half a second each.
        let mut x = 0.0;
        let positions: Vec<_> = (0..180)
            .map(|t| {
                let now = x;
                x += if t / 15 % 2 == 0 { 1.0 / FPS } else { 0.0 };
                [now, 1.0, 0.0]
            })
            .collect();
        let style = describe(&positions, &[Quaternion::IDENTITY; 180]);
        // The speed is 0 or 1 for half the time each, 0.5 from the mean.
        assert!((style[90][0] - 0.5).abs() < 1e-9);
        assert!((style[90][4] - 0.5 / 0.6).abs() < 1e-9, "{}", style[90][4]);
    }
}
