//! Plane geometry of simple polygons.

use kinegrad_settings::{InvalidSetting, Refused, counted, require};

use crate::vector::minus;

/// The edges of a closed polygon, without those of length zero.
fn edges(vertices: &[[f64; 2]]) -> impl Iterator<Item = ([f64; 2], [f64; 2])> + Clone {
    let after = vertices.iter().cycle().skip(1);
    let edges = vertices.iter().zip(after);
    edges.filter(|(a, b)| a != b).map(|(a, b)| (*a, *b))
}

/// Signed distance of a point from a polygon's edge, negative inside, and its gradient.
pub(super) fn distance_and_gradient(vertices: &[[f64; 2]], point: [f64; 2]) -> (f64, [f64; 2]) {
    let mut inside = false;
    let mut nearest = (f64::INFINITY, [0.0; 2], [0.0; 2]);
    for (a, b) in edges(vertices) {
        let along = minus(b, a);
        let share = dot(minus(point, a), along) / dot(along, along);
        let share = share.clamp(0.0, 1.0);
        let closest = [a[0] + share * along[0], a[1] + share * along[1]];
        let offset = minus(point, closest);
        let distance = offset[0].hypot(offset[1]);
        // NaN stays NaN.
        if distance < nearest.0 || distance.is_nan() {
            nearest = (distance, offset, along);
        }
        // The ray from the point towards +x crosses the edge.
        if (a[1] > point[1]) != (b[1] > point[1]) {
            let crossing = a[0] + (point[1] - a[1]) / along[1] * along[0];
            inside ^= point[0] < crossing;
        }
    }
    let (distance, offset, along) = nearest;
    if distance == 0.0 {
        // The outward side of an edge, for counterclockwise polygons (x to z).
        let doubled_area: f64 = edges(vertices).map(|(a, b)| cross(a, b)).sum();
        let length = along[0].hypot(along[1]).copysign(doubled_area);
        return (0.0, [along[1] / length, -along[0] / length]);
    }
    let sign = if inside { -1.0 } else { 1.0 };
    let gradient = offset.map(|component| sign * component / distance);
    (sign * distance, gradient)
}

/// Smallest signed distance of the points of the segment from `a` to `b`: exact outside; of a segment
/// that crosses the polygon, the depth of one of its points inside.
pub(super) fn swept_distance(vertices: &[[f64; 2]], a: [f64; 2], b: [f64; 2]) -> f64 {
    let along = minus(b, a);
    let at = |share: f64| [0, 1].map(|axis| a[axis] + share * along[axis]);
    let signed = |share: f64| distance_and_gradient(vertices, at(share)).0;
    let ends = [0.0, 1.0].map(signed);
    // Where it crosses edges, and between.
    let crossing = |(from, to): ([f64; 2], [f64; 2])| {
        let edge = minus(to, from);
        let share = cross(minus(from, a), edge) / cross(along, edge);
        (intersect((a, b), (from, to)) && share.is_finite()).then_some(share)
    };
    let mut crossings: Vec<f64> = edges(vertices).filter_map(crossing).collect();
    if crossings.is_empty() && ends.iter().all(|distance| *distance > 0.0) {
        // Of two segments that do not cross, the nearest points include an end of one.
        let corners = vertices.iter().map(|&corner| {
            let [x, z] = minus(corner, at(share_nearest(corner, a, b)));
            x.hypot(z)
        });
        return least(corners.chain(ends));
    }
    crossings.extend([0.0, 1.0]);
    crossings.sort_by(f64::total_cmp);
    crossings.truncate(MOST_CROSSINGS);
    let between = crossings.windows(2).map(|pair| (pair[0] + pair[1]) / 2.0);
    let shares = between.chain(crossings.iter().copied());
    least(shares.map(signed).chain(ends))
}

/// Most crossings of a segment whose surroundings are measured, from the start on.
const MOST_CROSSINGS: usize = 32;

/// The smallest number; NaN is not hidden.
pub(super) fn least(numbers: impl IntoIterator<Item = f64>) -> f64 {
    let numbers = numbers.into_iter();
    numbers.fold(f64::INFINITY, |least, number| match number < least {
        false if !number.is_nan() => least,
        _ => number,
    })
}

/// The share of the segment from `a` to `b` that is nearest to a point.
pub(super) fn share_nearest(point: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let along = minus(b, a);
    let share = dot(minus(point, a), along) / dot(along, along);
    match share.is_nan() {
        true => 0.0,
        false => share.clamp(0.0, 1.0),
    }
}

/// Rejects polygons with fewer than three corners, and edges that touch between corners.
pub(super) fn check(vertices: &[[f64; 2]]) -> Result<(), InvalidSetting> {
    let mut corners = vertices.to_vec();
    corners.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    corners.dedup();
    let found = format!("a list of {}", counted(corners.len(), "distinct corner"));
    require(corners.len() >= 3, "vertices", found, "three or more")
        .hint("name the corners in order around the obstacle, or use the kind `disc`")?;
    let edges: Vec<_> = edges(vertices).collect();
    for (i, &first) in edges.iter().enumerate() {
        for (distance, &second) in edges[i + 1..].iter().enumerate() {
            let j = i + 1 + distance;
            let touches = if distance == 0 {
                folds_back(first, second)
            } else if (j + 1) % edges.len() == i {
                folds_back(second, first)
            } else {
                intersect(first, second)
            };
            if touches {
                let found = format!(
                    "a line whose edges from {:?} and from {:?} cross or touch",
                    first.0, second.0
                );
                let allowed = "a line that does not touch itself";
                return Err(InvalidSetting::new("vertices", found, allowed).hint(
                    "name the corners in order around the obstacle; split a shape with several \
                     parts into several obstacles",
                ));
            }
        }
    }
    Ok(())
}

/// True if the second edge, which follows the first, overlaps the first.
fn folds_back((a, b): ([f64; 2], [f64; 2]), (_, c): ([f64; 2], [f64; 2])) -> bool {
    let (first, second) = (minus(b, a), minus(c, b));
    cross(first, second) == 0.0 && dot(first, second) < 0.0
}

/// True if two edges have a common point.
fn intersect((a, b): ([f64; 2], [f64; 2]), (c, d): ([f64; 2], [f64; 2])) -> bool {
    let side = |from: [f64; 2], to: [f64; 2], point| cross(minus(to, from), minus(point, from));
    let (c_side, d_side) = (side(a, b, c), side(a, b, d));
    let (a_side, b_side) = (side(c, d, a), side(c, d, b));
    let within = |from: [f64; 2], to: [f64; 2], point: [f64; 2]| {
        (0..2).all(|i| from[i].min(to[i]) <= point[i] && point[i] <= from[i].max(to[i]))
    };
    (c_side * d_side < 0.0 && a_side * b_side < 0.0)
        || (c_side == 0.0 && within(a, b, c))
        || (d_side == 0.0 && within(a, b, d))
        || (a_side == 0.0 && within(c, d, a))
        || (b_side == 0.0 && within(c, d, b))
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}
