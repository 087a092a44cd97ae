//! Eight style dimensions of a motion, in the four pairs of CC-MotionGen, section 2.5: intensity,
//! spatial extent, rhythmic feel and body attitude.

use kinegrad_motion::derivatives::{angular_velocity, forward_differences};
use kinegrad_motion::quantiles::median;
use kinegrad_motion::vector::length;
use kinegrad_motion::{FPS, Quaternion};

/// Frames on each side of a window: for one second, and for two seconds.
const NEAR: usize = 15;
const WIDE: usize = 30;

/// Style of every frame, `[frames, 8]`, over centered windows cut at the ends. The dimensions are
/// mean speed (m/s), mean acceleration / 10, extent on the floor and range of height over two
/// seconds (m), burstiness (deviation of the floor speed over its mean + 0.1), mean yaw rate / 3,
/// five times the mean height above the median (m), mean tilt (rad).
pub fn describe(positions: &[[f64; 3]], quaternions: &[Quaternion]) -> Vec<[f64; 8]> {
    let frames = positions.len();
    let velocity = forward_differences(positions, FPS);
    let acceleration = forward_differences(&velocity, FPS);
    let speed: Vec<f64> = velocity.iter().map(|&v| length(v)).collect();
    let floor_speed: Vec<f64> = velocity.iter().map(|[x, _, z]| x.hypot(*z)).collect();
    let effort: Vec<f64> = acceleration.iter().map(|&a| length(a)).collect();
    let yaw_rate: Vec<f64> = angular_velocity(quaternions, FPS)
        .iter()
        .map(|[_, y, _]| y.abs())
        .collect();
    let tilt: Vec<f64> = quaternions
        .iter()
        .map(|q| q.rotate([0.0, 1.0, 0.0])[1].clamp(-1.0, 1.0).acos())
        .collect();
    let height: Vec<f64> = positions.iter().map(|position| position[1]).collect();
    let usual = median(height.clone());
    (0..frames)
        .map(|t| {
            let near = t.saturating_sub(NEAR)..(t + NEAR + 1).min(frames);
            let wide = t.saturating_sub(WIDE)..(t + WIDE + 1).min(frames);
            let places = &positions[wide];
            let along = |axis: usize| range(places.iter().map(|place| place[axis]));
            let floor = mean(&floor_speed[near.clone()]);
            let burst = deviation(&floor_speed[near.clone()], floor);
            [
                mean(&speed[near.clone()]),
                mean(&effort[near.clone()]) / 10.0,
                along(0).hypot(along(2)),
                along(1),
                burst / (floor + 0.1),
                mean(&yaw_rate[near.clone()]) / 3.0,
                5.0 * (mean(&height[near.clone()]) - usual),
                mean(&tilt[near]),
            ]
        })
        .collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn deviation(values: &[f64], mean_value: f64) -> f64 {
    let squares: Vec<f64> = values.iter().map(|v| (v - mean_value).powi(2)).collect();
    mean(&squares).sqrt()
}

fn range(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    });
    high - low
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_walk_has_the_style_of_one() {
        let positions: Vec<[f64; 3]> = (0..90).map(|t| [0.02 * f64::from(t), 1.0, 0.0]).collect();
        let lean = Quaternion::from_rotation_vector([0.0, 0.0, 0.2]);
        let turning: Vec<Quaternion> = (0..90)
            .map(|t| Quaternion::from_yaw(0.05 * f64::from(t)) * lean)
            .collect();
        let style = describe(&positions, &turning)[45];
        let expected = [0.6, 0.0, 1.2, 0.0, 0.0, 0.5, 0.0, 0.2];
        for (dimension, (found, expected)) in style.into_iter().zip(expected).enumerate() {
            assert!(
                (found - expected).abs() < 1e-9,
                "dimension {dimension}: {found} {expected}"
            );
        }
    }

    #[test]
    fn height_and_bursts_are_seen() {
        let positions: Vec<[f64; 3]> = (0..60)
            .map(|t| {
                [
                    if t < 30 { 0.0 } else { 0.1 * f64::from(t) },
                    if t < 20 { 1.2 } else { 1.0 },
                    0.0,
                ]
            })
            .collect();
        let style = describe(&positions, &vec![Quaternion::IDENTITY; 60]);
        assert!((style[0][6] - 1.0).abs() < 1e-9, "{}", style[0][6]);
        assert!(style[30][4] > 0.5 && style[59][4] < 0.1);
        assert!((style[20][3] - 0.2).abs() < 1e-9);
    }

    #[test]
    fn a_median_of_an_even_number_lies_between() {
        assert_eq!(median(vec![4.0, 1.0, 2.0, 9.0]), 3.0);
        assert_eq!(median(vec![4.0, 1.0, 2.0]), 2.0);
    }
}
