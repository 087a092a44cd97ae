//! Catmull-Rom splines, by the scheme of Barry and Goldman (1988).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::polyline::must_be_points;
use super::{PathError, Polyline, between};

/// Distance below which control points are equal, metres.
const SAME: f64 = 1e-8;

/// Straight pieces of a segment.
const STEPS: usize = 64;

/// Most straight pieces of a curve with fewer segments.
const MOST_PIECES: usize = 1 << 20;

/// Parameterization of a spline: the knot distance is the point distance to this power.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Parameterization {
    /// 0: a cubic with tension 1/2.
    Uniform,
    /// 1/2: neither loops nor cusps within a segment (Yuksel et al. 2011).
    #[default]
    Centripetal,
    /// 1.
    Chordal,
}

impl Parameterization {
    fn power(self) -> f64 {
        match self {
            Self::Uniform => 0.0,
            Self::Centripetal => 0.5,
            Self::Chordal => 1.0,
        }
    }
}

/// A curve through control points.
#[derive(Clone, Debug, PartialEq)]
pub struct CatmullRom {
    /// Four control points per segment: the two ends, and one before and after.
    segments: Vec<[[f64; 2]; 4]>,
    power: f64,
}

/// A point and its derivative.
type Moving = [[f64; 2]; 2];

impl CatmullRom {
    /// The curve through `points`, extended in the direction of its end points, or closed.
    ///
    /// # Errors
    /// The errors of [`Polyline::new`].
    pub fn new(
        points: &[[f64; 2]],
        parameterization: Parameterization,
        closed: bool,
    ) -> Result<Self, PathError> {
        must_be_points(points)?;
        let mut apart: Vec<[f64; 2]> = Vec::with_capacity(points.len());
        for point in points {
            let is_new = |last: &[f64; 2]| between(*last, *point) >= SAME;
            if apart.last().is_none_or(is_new) {
                apart.push(*point);
            }
        }
        if closed && apart.len() > 1 && between(apart[0], apart[apart.len() - 1]) < SAME {
            apart.pop();
        }
        let n = apart.len();
        let mirrored = |end: [f64; 2], next: [f64; 2]| [0, 1].map(|i| 2.0 * end[i] - next[i]);
        let segments = match n {
            1 => vec![[apart[0]; 4]],
            _ if closed => {
                let around = |i: usize| [i + n - 1, i, i + 1, i + 2].map(|i| apart[i % n]);
                (0..n).map(around).collect()
            }
            _ => {
                let mut all = vec![mirrored(apart[0], apart[1])];
                all.extend(&apart);
                all.push(mirrored(apart[n - 1], apart[n - 2]));
                let windows = all.windows(4);
                windows.map(|four| [0, 1, 2, 3].map(|i| four[i])).collect()
            }
        };
        Ok(Self {
            segments,
            power: parameterization.power(),
        })
    }

    /// Number of segments.
    pub fn segments(&self) -> usize {
        self.segments.len()
    }

    /// The point at `tau`, 0 to 1, of a segment, and its derivative.
    pub fn at(&self, segment: usize, tau: f64) -> ([f64; 2], [f64; 2]) {
        let points = self.segments[segment];
        if between(points[1], points[2]) == 0.0 {
            return (points[1], [0.0; 2]);
        }
        let mut knots = [0.0; 4];
        for i in 1..4 {
            knots[i] = knots[i - 1] + between(points[i - 1], points[i]).powf(self.power);
        }
        let unit = knots[2] - knots[1];
        let t = knots[1] + tau * unit;
        // Linear interpolation in t between two moving points, from knot a to knot b.
        let mix = |[p, dp]: Moving, [q, dq]: Moving, a: f64, b: f64| -> Moving {
            let (left, right) = ((b - t) / (b - a), (t - a) / (b - a));
            let value = [0, 1].map(|i| left * p[i] + right * q[i]);
            let slope = [0, 1].map(|i| left * dp[i] + right * dq[i] + (q[i] - p[i]) / (b - a));
            [value, slope]
        };
        let still = points.map(|point| [point, [0.0; 2]]);
        let level = |k: usize| mix(still[k], still[k + 1], knots[k], knots[k + 1]);
        let [first, second, third] = [0, 1, 2].map(level);
        let left = mix(first, second, knots[0], knots[2]);
        let right = mix(second, third, knots[1], knots[3]);
        let [value, slope] = mix(left, right, knots[1], knots[2]);
        (value, slope.map(|by_t| by_t * unit))
    }

    /// The curve as a line with 64 straight pieces per segment, or fewer of more than 16384
    /// segments: at most 2^20 in all, but at least one per segment.
    pub fn polyline(&self) -> Polyline {
        let mut points = vec![self.at(0, 0.0).0];
        let steps = (MOST_PIECES / self.segments()).clamp(1, STEPS);
        for segment in 0..self.segments() {
            points.extend((1..=steps).map(|i| self.at(segment, i as f64 / steps as f64).0));
        }
        Polyline::through(points)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pieces_of_long_lists_have_a_bound() {
        for (count, pieces) in [
            (100, 99 * 64),
            (350_000, 349_999 * 2),
            (1_500_000, 1_499_999),
        ] {
            let points: Vec<[f64; 2]> = (0..count).map(|i| [0.001 * f64::from(i), 0.0]).collect();
            let spline = CatmullRom::new(&points, Parameterization::default(), false).unwrap();
            assert_eq!(spline.polyline().points().len(), pieces + 1);
        }
    }

    #[test]
    fn a_spline_goes_through_its_points_and_closes_without_a_corner() {
        let points = [[0.0, 0.0], [0.0, 2.0], [0.0, 2.0], [1.5, 2.5], [2.0, 0.0]];
        for parameterization in [
            Parameterization::Uniform,
            Parameterization::Centripetal,
            Parameterization::Chordal,
        ] {
            let open = CatmullRom::new(&points, parameterization, false).unwrap();
            assert_eq!(open.segments(), 3);
            assert_eq!(open.at(0, 0.0).0, [0.0, 0.0]);
            assert!(between(open.at(2, 1.0).0, [2.0, 0.0]) < 1e-12);
            let closed = CatmullRom::new(&points, parameterization, true).unwrap();
            assert_eq!(closed.segments(), 4);
            assert!(between(closed.at(3, 1.0).0, [0.0, 0.0]) < 1e-12);
            for segment in 0..4 {
                let (end, leaving) = closed.at(segment, 1.0);
                let (start, arriving) = closed.at((segment + 1) % 4, 0.0);
                assert!(between(end, start) < 1e-12);
                let cross = leaving[0] * arriving[1] - leaving[1] * arriving[0];
                assert!(
                    cross.abs() < 1e-9,
                    "{parameterization:?} {segment}: {cross}"
                );
            }
        }
    }

    #[test]
    fn two_points_close_and_curves_may_exceed_the_furthest_point() {
        let kind = Parameterization::Centripetal;
        let there_and_back = CatmullRom::new(&[[0.0, 0.0], [0.0, 2.0]], kind, true).unwrap();
        let line = there_and_back.polyline();
        assert!(
            (line.length() - 4.0).abs() < 1e-9 && between(line.at(1.0).point, [0.0, 0.0]) < 1e-9
        );
        let far = 5e3;
        let square = [[0.0, 0.0], [far, 0.0], [far, far], [0.0, far]];
        let line = CatmullRom::new(&square, kind, false).unwrap().polyline();
        assert!(line.points().iter().any(|point| point[0] > far));
    }

    #[test]
    fn its_derivative_is_its_slope() {
        let points = [[0.0, 0.0], [1.0, 2.0], [3.0, 2.5], [3.5, -1.0]];
        let spline = CatmullRom::new(&points, Parameterization::Centripetal, false).unwrap();
        for segment in 0..3 {
            let (_, slope) = spline.at(segment, 0.4);
            let (before, after) = (
                spline.at(segment, 0.4 - 1e-6).0,
                spline.at(segment, 0.4 + 1e-6).0,
            );
            for i in 0..2 {
                assert!((slope[i] - (after[i] - before[i]) / 2e-6).abs() < 1e-6);
            }
        }
        assert!(spline.polyline().length() > 7.0);
    }
}
