//! Whether time runs forward, by how feet land.

use crate::humanml::Joints;
use crate::vector::{length, minus};

/// Added to sums of cubes, so that equal ones have a ratio of 1.
const LEAST: f64 = 1e-3;

/// [`BodyMeasure::TimeDirection`](super::BodyMeasure::TimeDirection) of a body that travels:
///
/// ```text
/// ln(sum of cubes of the increases of the ankles' speed / of its decreases)
///   + ln(sum of cubes of the ankles' upward speeds / of their downward speeds)
/// ```
pub(super) fn time_direction(joints: &Joints, ankles: [usize; 2], fps: f64) -> f64 {
    let (mut speeding, mut rising) = (Balance::default(), Balance::default());
    for ankle in ankles {
        let track = joints.track(ankle);
        let velocities: Vec<[f64; 3]> = (track.windows(2))
            .map(|pair| minus(pair[1], pair[0]).map(|step| fps * step))
            .collect();
        velocities
            .iter()
            .for_each(|velocity| rising.add(velocity[1]));
        let speeds: Vec<f64> = velocities.into_iter().map(length).collect();
        speeds
            .windows(2)
            .for_each(|pair| speeding.add(pair[1] - pair[0]));
    }
    speeding.logarithm() + rising.logarithm()
}

/// Sums of cubes of positive and of negative values.
#[derive(Default)]
struct Balance {
    positive: f64,
    negative: f64,
}

impl Balance {
    fn add(&mut self, value: f64) {
        self.positive += value.max(0.0).powi(3);
        self.negative += (-value).max(0.0).powi(3);
    }

    fn logarithm(&self) -> f64 {
        ((self.positive + LEAST) / (self.negative + LEAST)).ln()
    }
}
