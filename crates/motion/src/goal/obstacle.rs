//! Obstacles as signed distance functions.

use kinegrad_settings::{InvalidSetting, Refused, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{check_metres, check_position, polygon};

/// A region of the ground plane that the root must avoid, in metres.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Obstacle {
    /// All points within `radius` of a center.
    Disc {
        /// Center, x.
        x: f64,
        /// Center, z.
        z: f64,
        /// Radius, positive.
        radius: f64,
    },
    /// The inside of a simple polygon.
    Polygon {
        /// Corners `[x, z]` in order, in either direction. The first corner may be repeated at the
        /// end.
        vertices: Vec<[f64; 2]>,
    },
}

impl Obstacle {
    /// Distance of a point from the obstacle's edge, metres, negative inside.
    pub fn signed_distance(&self, point: [f64; 2]) -> f64 {
        self.distance_and_gradient(point).0
    }

    /// Smallest signed distance of the points of the segment from `a` to `b`, metres: exact outside; of
    /// a segment that crosses the obstacle, the depth of one of its points inside.
    pub fn swept_distance(&self, a: [f64; 2], b: [f64; 2]) -> f64 {
        match self {
            &Self::Disc { x, z, .. } => {
                let shares = [0.0, polygon::share_nearest([x, z], a, b), 1.0];
                let at = |share: f64| [0, 1].map(|axis| a[axis] + share * (b[axis] - a[axis]));
                polygon::least(shares.map(|share| self.signed_distance(at(share))))
            }
            Self::Polygon { vertices } => polygon::swept_distance(vertices, a, b),
        }
    }

    /// Number of its corners.
    pub(super) fn corners(&self) -> usize {
        match self {
            Self::Disc { .. } => 0,
            Self::Polygon { vertices } => vertices.len(),
        }
    }

    /// Its extent along x and z, `[least, greatest]` of each.
    pub(super) fn bounds(&self) -> [[f64; 2]; 2] {
        match self {
            &Self::Disc { x, z, radius } => [x, z].map(|center| [center - radius, center + radius]),
            Self::Polygon { vertices } => [0, 1].map(|axis| {
                let along = vertices.iter().map(|vertex| vertex[axis]);
                let none = [f64::INFINITY, f64::NEG_INFINITY];
                along.fold(none, |[low, high], at| [low.min(at), high.max(at)])
            }),
        }
    }

    /// The [signed distance](Self::signed_distance) and its gradient, a unit vector. The first of
    /// several nearest edges counts. The gradient on an edge is the outward normal, and at a disc's
    /// center +x.
    pub fn distance_and_gradient(&self, point: [f64; 2]) -> (f64, [f64; 2]) {
        match self {
            &Self::Disc { x, z, radius } => {
                let offset = [point[0] - x, point[1] - z];
                let distance = offset[0].hypot(offset[1]);
                let gradient = match distance {
                    0.0 => [1.0, 0.0],
                    distance => offset.map(|component| component / distance),
                };
                (distance - radius, gradient)
            }
            Self::Polygon { vertices } => polygon::distance_and_gradient(vertices, point),
        }
    }

    /// # Errors
    /// Errors for invalid numbers, and for polygons with fewer than three corners or with touching
    /// edges.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        match self {
            &Self::Disc { x, z, radius } => {
                check_metres("x", x)?;
                check_metres("z", z)?;
                let allowed = "a positive number of metres";
                require(
                    radius > 0.0 && radius.is_finite(),
                    "radius",
                    radius,
                    allowed,
                )
                .hint("leave out an obstacle that has no size")
            }
            Self::Polygon { vertices } => {
                for (index, &vertex) in vertices.iter().enumerate() {
                    check_position(&format!("vertices[{index}]"), vertex)?;
                }
                polygon::check(vertices)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A square with side 2 around the origin, with a notch from the upper edge to the middle.
    fn notched() -> Obstacle {
        let vertices = vec![
            [-1.0, -1.0],
            [1.0, -1.0],
            [1.0, 1.0],
            [0.0, 0.0],
            [-1.0, 1.0],
        ];
        Obstacle::Polygon { vertices }
    }

    fn disc() -> Obstacle {
        Obstacle::Disc {
            x: 1.0,
            z: -2.0,
            radius: 0.5,
        }
    }

    fn assert_near(found: (f64, [f64; 2]), expected: (f64, [f64; 2])) {
        let pairs = [
            (found.0, expected.0),
            (found.1[0], expected.1[0]),
            (found.1[1], expected.1[1]),
        ];
        assert!(
            pairs.iter().all(|(a, b)| (a - b).abs() < 1e-12),
            "{found:?} instead of {expected:?}"
        );
    }

    #[test]
    fn a_disc_is_left_along_its_radius() {
        let at = |point| disc().distance_and_gradient(point);
        assert_near(at([4.0, 2.0]), (4.5, [0.6, 0.8]));
        assert_near(at([1.0, -2.25]), (-0.25, [0.0, -1.0]));
        assert_near(at([1.0, -2.0]), (-0.5, [1.0, 0.0]));
    }

    #[test]
    fn a_polygon_is_left_over_its_nearest_edge() {
        let root = 0.5f64.sqrt();
        for obstacle in [notched(), reversed(notched())] {
            let at = |point| obstacle.distance_and_gradient(point);
            assert_near(at([0.5, -3.0]), (2.0, [0.0, -1.0]));
            assert_near(at([0.5, -0.75]), (-0.25, [0.0, 1.0 - 2.0]));
            assert_near(at([4.0, -5.0]), (5.0, [0.6, -0.8]));
            // A point in the notch is inside the hull.
            assert_near(at([0.1, 0.9]), (0.8 * root, [-root, root]));
            // For this inner point, a reflex corner is nearest.
            assert_near(at([0.0, -0.25]), (-0.25, [0.0, 1.0]));
            // Points on an edge and beyond the edge's corner.
            assert_near(at([0.25, -1.0]), (0.0, [0.0, -1.0]));
            assert_near(at([0.5, 0.5]), (0.0, [-root, root]));
        }
    }

    fn reversed(obstacle: Obstacle) -> Obstacle {
        match obstacle {
            Obstacle::Polygon { mut vertices } => {
                vertices.reverse();
                Obstacle::Polygon { vertices }
            }
            disc => disc,
        }
    }

    #[test]
    fn a_segment_is_measured_between_its_ends() {
        let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-12, "{found}");
        // Over the disc, along a chord, past it, ending before it, and standing still.
        near(disc().swept_distance([-9.0, -2.0], [9.0, -2.0]), -0.5);
        near(disc().swept_distance([-9.0, -1.7], [9.0, -1.7]), -0.2);
        near(disc().swept_distance([-9.0, 0.0], [9.0, 0.0]), 1.5);
        near(disc().swept_distance([-9.0, -2.0], [0.0, -2.0]), 0.5);
        near(disc().swept_distance([1.0, 0.0], [1.0, 0.0]), 1.5);
        for obstacle in [notched(), reversed(notched())] {
            let swept = |a, b| obstacle.swept_distance(a, b);
            // Over it, over both of its points beside the notch, and into the notch alone.
            assert!(swept([-3.0, -0.5], [3.0, -0.5]) <= -0.5);
            assert!(swept([-3.0, 0.8], [3.0, 0.8]) < 0.0);
            assert!(swept([-0.1, 0.8], [0.1, 0.8]) > 0.0);
            near(swept([-3.0, 2.0], [3.0, 2.0]), 1.0);
            // Nearest to a corner in the middle of the segment.
            near(swept([0.0, 3.0], [3.0, 0.0]), 0.5f64.sqrt());
            // Along an edge.
            near(swept([-3.0, -1.0], [3.0, -1.0]), 0.0);
        }
        assert!(disc().swept_distance([f64::NAN, 0.0], [1.0, 1.0]).is_nan());
    }

    #[test]
    fn obstacles_read_by_kind_and_refuse_unknown_keys() {
        let read = |json: &str| serde_json::from_str::<Obstacle>(json);
        let found = read(r#"{"kind": "disc", "x": 1, "z": -2.0, "radius": 0.5}"#).unwrap();
        assert_eq!(found, disc());
        let json = serde_json::to_string(&notched()).unwrap();
        assert_eq!(read(&json).unwrap(), notched());
        assert!(read(r#"{"kind": "disc", "x": 1, "z": 2, "radius": 1, "y": 0}"#).is_err());
        assert!(read(r#"{"kind": "polygon", "vertices": [], "radius": 1}"#).is_err());
        assert!(read(r#"{"kind": "disc", "x": 1, "z": 2}"#).is_err());
        assert!(read(r#"{"kind": "box", "x": 1, "z": 2}"#).is_err());
        assert!(read(r#"{"x": 1, "z": 2, "radius": 1}"#).is_err());
    }

    #[test]
    fn shapes_without_an_inside_are_refused() {
        let message = |obstacle: Obstacle| obstacle.validate().unwrap_err().to_string();
        let disc = |x, radius| Obstacle::Disc { x, z: 0.0, radius };
        assert_eq!(
            message(disc(0.0, -1.0)),
            "`radius` is -1, allowed: a positive number of metres"
        );
        assert!(message(disc(f64::NAN, 1.0)).starts_with("`x` is NaN"));
        assert!(message(disc(0.0, f64::INFINITY)).contains("radius"));
        let polygon = |vertices: &[[f64; 2]]| Obstacle::Polygon {
            vertices: vertices.to_vec(),
        };
        let (a, b, c, d) = ([0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]);
        for few in [&[][..], &[a, b], &[a, b, a], &[a, a, b, b, a]] {
            assert!(
                message(polygon(few)).contains("distinct corners"),
                "{few:?}"
            );
        }
        assert!(message(polygon(&[a])).contains("1 distinct corner"));
        let middle = [1.0, 0.0];
        for crossing in [
            &[a, c, b, d][..],
            &[a, b, middle],
            &[a, b, c, middle, d],
            &[a, b, c, a, d, [-1.0, 1.0]],
            &[a, [3.0, 0.0], b, c],
        ] {
            assert!(message(polygon(crossing)).contains("cross"), "{crossing:?}");
        }
        assert!(message(polygon(&[a, [1.0, f64::NAN], c])).contains("vertices[1].z"));
        // Polygons may repeat the first corner at the end, or a corner twice in a row, and may have
        // straight corners.
        for good in [&[a, b, c][..], &[a, b, b, c, d, a], &[a, middle, b, c]] {
            polygon(good).validate().unwrap();
        }
    }

    proptest! {
        #[test]
        fn gradients_are_those_of_the_distance(x in -3.0..3.0f64, z in -3.0..3.0f64, round: bool) {
            let obstacle = if round { disc() } else { notched() };
            let (distance, gradient) = obstacle.distance_and_gradient([x, z]);
            // Near a tie of edges the numeric gradient is shorter than 1 and is not compared.
            let step = 1e-6;
            let numeric = [[step, 0.0], [0.0, step]].map(|[dx, dz]| {
                let ahead = obstacle.signed_distance([x + dx, z + dz]);
                (ahead - obstacle.signed_distance([x - dx, z - dz])) / (2.0 * step)
            });
            prop_assert!((gradient[0].hypot(gradient[1]) - 1.0).abs() < 1e-9);
            // Walking against the gradient ends on the edge, so both are exact.
            let edge = [x - distance * gradient[0], z - distance * gradient[1]];
            prop_assert!(obstacle.signed_distance(edge).abs() < 1e-9);
            let smooth = (numeric[0].hypot(numeric[1]) - 1.0).abs() < 1e-4;
            if smooth {
                prop_assert!((numeric[0] - gradient[0]).abs() < 1e-3);
                prop_assert!((numeric[1] - gradient[1]).abs() < 1e-3);
            }
        }

        #[test]
        fn direction_and_first_corner_do_not_matter(
            x in -3.0..3.0f64, z in -3.0..3.0f64, turn in 0usize..5,
        ) {
            let Obstacle::Polygon { mut vertices } = notched() else { unreachable!() };
            vertices.rotate_left(turn);
            let turned = reversed(Obstacle::Polygon { vertices });
            let difference = turned.signed_distance([x, z]) - notched().signed_distance([x, z]);
            prop_assert!(difference.abs() < 1e-12);
        }
    }
}
