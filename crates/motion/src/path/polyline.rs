//! Polylines by arc length.

use super::course::walked;
use super::{PathError, STILL};

/// Largest coordinate, metres. Single precision resolves half a millimetre there.
pub(super) const MAX_METRES: f64 = 5e3;

/// A polyline on the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct Polyline {
    points: Vec<[f64; 2]>,
    /// Arc length of each point, metres.
    cumulative: Vec<f64>,
}

/// A position on a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// Ground position, metres.
    pub point: [f64; 2],
    /// Unit tangent.
    pub tangent: [f64; 2],
}

impl PathPoint {
    /// The heading of the tangent, radians.
    pub fn heading(&self) -> f64 {
        self.tangent[0].atan2(self.tangent[1])
    }
}

impl Polyline {
    /// The polyline through `points`. Neighboring points may be equal.
    ///
    /// # Errors
    /// [`PathError::TooFewPoints`], [`PathError::NotAPoint`].
    pub fn new(points: Vec<[f64; 2]>) -> Result<Self, PathError> {
        must_be_points(&points)?;
        Ok(Self::through(points))
    }

    /// The polyline through finite points, possibly beyond the range of user input.
    pub(crate) fn through(points: Vec<[f64; 2]>) -> Self {
        let cumulative = walked(&points);
        Self { points, cumulative }
    }

    /// Its points.
    pub fn points(&self) -> &[[f64; 2]] {
        &self.points
    }

    /// Arc length of each point, metres.
    pub fn cumulative(&self) -> &[f64] {
        &self.cumulative
    }

    /// Total length, metres.
    pub fn length(&self) -> f64 {
        *self.cumulative.last().expect("two points or more")
    }

    /// The position at a share of the length, clamped to the line. Without length: the start, with
    /// tangent +z.
    pub fn at(&self, share: f64) -> PathPoint {
        self.at_metres(share.clamp(0.0, 1.0) * self.length())
    }

    /// The position at an arc length, clamped to the line.
    pub fn at_metres(&self, metres: f64) -> PathPoint {
        let length = self.length();
        if length < STILL {
            return PathPoint {
                point: self.points[0],
                tangent: [0.0, 1.0],
            };
        }
        let metres = metres.clamp(0.0, length);
        // The last nonzero segment that begins at or before this length.
        let begins = self.cumulative.partition_point(|begin| *begin <= metres);
        let mut segment = begins.clamp(1, self.points.len() - 1) - 1;
        let long = |segment: usize| self.cumulative[segment + 1] - self.cumulative[segment];
        while segment > 0 && long(segment) == 0.0 {
            segment -= 1;
        }
        let long = long(segment);
        let ([ax, az], [bx, bz]) = (self.points[segment], self.points[segment + 1]);
        let part = (metres - self.cumulative[segment]) / long;
        PathPoint {
            point: [ax + part * (bx - ax), az + part * (bz - az)],
            tangent: [(bx - ax) / long, (bz - az) / long],
        }
    }

    /// The part up to an arc length.
    #[must_use]
    pub fn up_to(&self, metres: f64) -> Self {
        if metres >= self.length() {
            return self.clone();
        }
        let before = self.points.iter().zip(&self.cumulative);
        let before = before.take_while(|(_, along)| **along < metres.max(STILL));
        let mut points: Vec<[f64; 2]> = before.map(|(point, _)| *point).collect();
        points.push(self.at_metres(metres).point);
        Self::through(points)
    }

    /// Points at equal distances along the line, including both ends.
    ///
    /// # Panics
    /// Panics for fewer than two points.
    pub fn resampled(&self, count: usize) -> Vec<[f64; 2]> {
        assert!(count >= 2, "both ends");
        let share = |i: usize| i as f64 / (count - 1) as f64;
        (0..count).map(|i| self.at(share(i)).point).collect()
    }
}

/// Rejects invalid lists of points.
pub(super) fn must_be_points(points: &[[f64; 2]]) -> Result<(), PathError> {
    let bad = |point: &[f64; 2]| !point.iter().all(|value| value.abs() <= MAX_METRES);
    if let Some(index) = points.iter().position(bad) {
        let [x, z] = points[index];
        return Err(PathError::NotAPoint { index, x, z });
    }
    match points.len() {
        0 | 1 => Err(PathError::TooFewPoints {
            found: points.len(),
        }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn points_that_repeat_do_not_stop_a_line() {
        let points = vec![
            [0.0, 0.0],
            [0.0, 0.0],
            [0.0, 2.0],
            [0.0, 2.0],
            [1.0, 2.0],
            [1.0, 2.0],
        ];
        let line = Polyline::new(points).unwrap();
        for (share, point, tangent) in [
            (-0.5, [0.0, 0.0], [0.0, 1.0]),
            (0.0, [0.0, 0.0], [0.0, 1.0]),
            (0.5, [0.0, 1.5], [0.0, 1.0]),
            // The tangent at a corner is the next segment's.
            (2.0 / 3.0, [0.0, 2.0], [1.0, 0.0]),
            (1.0, [1.0, 2.0], [1.0, 0.0]),
            (7.0, [1.0, 2.0], [1.0, 0.0]),
        ] {
            assert_eq!(line.at(share), PathPoint { point, tangent }, "{share}");
        }
        assert_eq!(line.resampled(4)[1], [0.0, 1.0]);
        assert_eq!(line.up_to(2.5).length(), 2.5);
        assert_eq!(line.up_to(2.5).at(1.0).point, [0.5, 2.0]);
        assert_eq!(line.up_to(9.0), line);
        assert_eq!(line.up_to(0.0).length(), 0.0);
    }

    #[test]
    fn invalid_points_are_refused() {
        let message = |points| Polyline::new(points).unwrap_err().to_string();
        assert_eq!(
            message(vec![[1.0, 2.0]]),
            "a path has 1 points, at least 2 are needed"
        );
        assert!(message(vec![]).contains("has 0 points"));
        for bad in [f64::NAN, f64::INFINITY, 1e6] {
            let message = message(vec![[0.0, 0.0], [1.0, bad]]);
            assert!(message.starts_with("point 1 of the path"), "{message}");
        }
    }

    proptest! {
        #[test]
        fn equal_shares_are_equally_far_along(
            points in proptest::collection::vec(proptest::array::uniform2(-5.0..5.0f64), 2..9),
            share in 0.0..1.0f64,
        ) {
            let line = Polyline::new(points.clone()).unwrap();
            let place = line.at(share);
            // The part has this share of the length.
            let metres = share * line.length();
            let mut before: Vec<[f64; 2]> = points
                .iter()
                .zip(line.cumulative())
                .take_while(|(_, at)| **at <= metres)
                .map(|(point, _)| *point)
                .collect();
            before.push(place.point);
            let cut = Polyline::new(before).unwrap();
            prop_assert!((cut.length() - metres).abs() < 1e-9);
            let [x, z] = place.tangent;
            prop_assert!((x.hypot(z) - 1.0).abs() < 1e-9);
        }
    }
}
