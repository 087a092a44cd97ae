//! Positions on a circle, in cycles, such as the phase in a beat or a bar.

use std::f64::consts::TAU;

/// The shortest step from one position to another, -0.5 to 0.5. Full cycles are ignored.
pub fn step(from: f64, to: f64) -> f64 {
    let step = to - from;
    step - step.round()
}

/// An angle in radians, moved by full turns to -pi to pi.
pub fn wrapped(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

/// Distance of two positions, 0 to 0.5. The mean distance of unrelated positions is 0.25.
pub fn distance(a: f64, b: f64) -> f64 {
    step(a, b).abs()
}

/// Length of the mean of `exp(2 pi i d)` over differences `d`: 1 if all are equal, 0 without
/// differences.
pub fn concentration(differences: impl IntoIterator<Item = f64>) -> f64 {
    let (mut sine, mut cosine, mut count) = (0.0, 0.0, 0.0);
    for difference in differences {
        let angle = TAU * difference;
        sine += angle.sin();
        cosine += angle.cos();
        count += 1.0;
    }
    if count > 0.0 {
        f64::hypot(sine, cosine) / count
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shortest_steps_cross_the_end_of_the_cycle() {
        for (from, to, expected) in [
            (0.95, 0.05, 0.1),
            (0.05, 0.95, -0.1),
            (0.2, 0.6, 0.4),
            (3.9, -2.0, 0.1),
            (1.25, 0.25, 0.0),
        ] {
            let found = step(from, to);
            assert!((found - expected).abs() < 1e-12, "{from} {to}: {found}");
            assert!((distance(from, to) - expected.abs()).abs() < 1e-12);
            assert!((distance(to, from) - expected.abs()).abs() < 1e-12);
        }
        assert_eq!(distance(0.25, 0.75), 0.5);
        assert!(distance(f64::NAN, 0.0).is_nan());
    }

    #[test]
    fn differences_that_agree_are_concentrated_wherever_they_lie() {
        assert!((concentration([0.3, 1.3, -0.7]) - 1.0).abs() < 1e-12);
        let around = (0..10).map(|k| f64::from(k) / 10.0);
        assert!(concentration(around) < 1e-12);
        assert!((concentration([0.0, 0.25]) - 0.5f64.sqrt()).abs() < 1e-12);
        assert_eq!(concentration([]), 0.0);
    }
}
