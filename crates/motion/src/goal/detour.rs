//! Lines between keyframes that go around obstacles.

use pathfinding::directed::astar::astar;

use super::{Goal, GroundTargets, Obstacle};
use crate::path::Polyline;

/// Most cells along a side of the grid that a detour is searched on.
const CELLS: f64 = 64.0;
/// Smallest cell, metres.
const SMALLEST_CELL: f64 = 0.05;
/// Width of the grid's edge around the line and the obstacles that it crosses, metres.
const EDGE: f64 = 1.0;
/// Distance that detours keep from obstacles in addition to the goal's margin, metres.
const CLEARANCE: f64 = 0.1;

type Point = [f64; 2];
type Cell = [usize; 2];

impl Goal {
    /// The trajectory, or the keyframes and the shortest lines between them that keep the goal's
    /// margin and 0.1 m more from the obstacles, at constant speed. Keyframes nearer to an obstacle
    /// reduce the distance. A line is straight if nothing is in its way, or if no detour is found.
    pub fn around_obstacles(&self) -> GroundTargets {
        if self.trajectory.is_some() || self.obstacles.is_empty() {
            return self.dense();
        }
        GroundTargets::along_lines(&self.keyframes, self.frames, |from, to, steps| {
            let mut positions = Polyline::through(self.detour(from, to)).resampled(steps + 1);
            positions.truncate(steps);
            positions
        })
    }

    /// The distance of the line from `a` to `b` from the nearest obstacle, metres; negative inside.
    pub(super) fn clearance(&self, a: Point, b: Point) -> f64 {
        let distances = self.obstacles.iter().map(|each| each.swept_distance(a, b));
        distances.fold(f64::INFINITY, f64::min)
    }

    /// The corners of the line from `from` to `to`, both included.
    pub(super) fn detour(&self, from: Point, to: Point) -> Vec<Point> {
        let distance = |a, b| self.clearance(a, b);
        let ends = distance(from, from).min(distance(to, to));
        let least = ends.min(self.margin + CLEARANCE) - 1e-9;
        let is_free = |a, b| distance(a, b) >= least;
        let path = match least > 0.0 && !is_free(from, to) {
            true => self.grid(from, to, least).path(least),
            false => None,
        };
        // Ends in the same cell have no path.
        let path = path.filter(|path| path.len() > 1);
        let path = path.unwrap_or_else(|| vec![from, to]);
        pulled_tight(&path, &is_free)
    }

    /// The grid around the line and the obstacles nearer to it than `least`.
    fn grid(&self, from: Point, to: Point, least: f64) -> Grid {
        let crossed = self.obstacles.iter();
        let crossed = crossed.filter(|each| each.swept_distance(from, to) < least);
        let line = [0, 1].map(|axis| [from[axis].min(to[axis]), from[axis].max(to[axis])]);
        let bounds = crossed.map(Obstacle::bounds).fold(line, |all, each| {
            [0, 1].map(|axis| {
                let ([low, high], [lower, higher]) = (all[axis], each[axis]);
                [low.min(lower), high.max(higher)]
            })
        });
        let edge = least + EDGE;
        let sides = bounds.map(|[low, high]| high - low + 2.0 * edge);
        let cell = (sides[0].max(sides[1]) / CELLS).max(SMALLEST_CELL);
        let origin = bounds.map(|[low, _]| low - edge);
        let nearest = |point: Point| {
            [0, 1].map(|axis| ((point[axis] - origin[axis]) / cell).round() as usize)
        };
        let mut grid = Grid {
            ends: [(nearest(from), from), (nearest(to), to)],
            size: sides.map(|side| (side / cell).ceil() as usize + 1),
            origin,
            cell,
            distances: Vec::new(),
        };
        let [rows, columns] = grid.size;
        let cells = (0..rows).flat_map(|x| (0..columns).map(move |z| [x, z]));
        let distance = |cell| {
            let point = grid.point(cell);
            let distances = self
                .obstacles
                .iter()
                .map(|each| each.signed_distance(point));
            distances.fold(f64::INFINITY, f64::min)
        };
        grid.distances = cells.map(distance).collect();
        grid
    }
}

/// Points on the ground that a detour may go through.
struct Grid {
    origin: Point,
    /// Distance of neighbors, metres.
    cell: f64,
    /// Number of cells along each axis.
    size: Cell,
    /// The cells of the line's ends, which stand for the ends.
    ends: [(Cell, Point); 2],
    /// Signed distance of each cell from the obstacles, x first, metres.
    distances: Vec<f64>,
}

impl Grid {
    fn point(&self, cell: Cell) -> Point {
        let end = self.ends.iter().find(|(end, _)| *end == cell);
        match end {
            Some((_, point)) => *point,
            None => [0, 1].map(|axis| self.origin[axis] + cell[axis] as f64 * self.cell),
        }
    }

    /// The shortest path between the ends whose cells keep `least` from the obstacles.
    fn path(&self, least: f64) -> Option<Vec<Point>> {
        let [(start, _), (end, _)] = self.ends;
        let length = |from: Cell, to: Cell| {
            let [x, z] = [0, 1].map(|axis| to[axis].abs_diff(from[axis]) as f64);
            x.hypot(z)
        };
        let distance = |cell: Cell| self.distances[cell[0] * self.size[1] + cell[1]];
        let is_free = |from: Cell, to: Cell| {
            // Over an obstacle between them, the distances would be less than the step's length.
            let step = length(from, to) * self.cell;
            distance(to) >= least && distance(from) + distance(to) > step
        };
        let steps = |&from: &Cell| {
            let [rows, columns] = [0, 1].map(|axis| {
                let first = from[axis].saturating_sub(1);
                first..(from[axis] + 2).min(self.size[axis])
            });
            let around = rows.flat_map(|x| columns.clone().map(move |z| [x, z]));
            let free = around.filter(|&to| to != from && is_free(from, to));
            // Thousandths of a cell.
            let costs = free.map(|to| (to, (1000.0 * length(from, to)) as u64));
            costs.collect::<Vec<_>>()
        };
        let ahead = |&cell: &Cell| (1000.0 * length(cell, end)) as u64;
        let (cells, _) = astar(&start, steps, ahead, |&cell| cell == end)?;
        Some(cells.into_iter().map(|cell| self.point(cell)).collect())
    }
}

/// The corners of a path that are left when each is joined to the last that a free line reaches.
fn pulled_tight(path: &[Point], is_free: &dyn Fn(Point, Point) -> bool) -> Vec<Point> {
    let mut corners = vec![path[0]];
    let mut at = 0;
    while at + 1 < path.len() {
        let reached = (at + 2..path.len())
            .rev()
            .find(|&to| is_free(path[at], path[to]));
        at = reached.unwrap_or(at + 1);
        corners.push(path[at]);
    }
    corners
}

#[cfg(test)]
mod tests {
    use super::super::Keyframe;
    use super::*;

    fn goal(ends: [(usize, Point); 2], obstacles: Vec<Obstacle>) -> Goal {
        let keyframe = |(frame, [x, z]): (usize, Point)| Keyframe { frame, x, z };
        Goal {
            margin: 0.2,
            keyframes: ends.map(keyframe).to_vec(),
            obstacles,
            ..Goal::new(61)
        }
    }

    fn disc(x: f64, z: f64, radius: f64) -> Obstacle {
        Obstacle::Disc { x, z, radius }
    }

    /// The positions of a goal with a target in each frame.
    fn positions(goal: &Goal) -> Vec<Point> {
        let targets = goal.around_obstacles();
        targets
            .positions()
            .iter()
            .map(|target| target.expect("a line"))
            .collect()
    }

    #[test]
    fn a_line_goes_around_obstacles_at_constant_speed() {
        let wall = [[-2.0, 1.9], [1.0, 1.9], [1.0, 2.1], [-2.0, 2.1]];
        // A pocket that opens towards the start.
        let pocket = [
            [-1.0, 1.0],
            [-0.9, 1.0],
            [-0.9, 2.0],
            [0.9, 2.0],
            [0.9, 1.0],
            [1.0, 1.0],
            [1.0, 2.1],
            [-1.0, 2.1],
        ];
        let polygon = |corners: &[Point]| Obstacle::Polygon {
            vertices: corners.to_vec(),
        };
        for obstacles in [
            vec![disc(0.0, 2.0, 0.5)],
            vec![disc(0.0, 2.0, 0.5), disc(1.2, 2.0, 0.5)],
            vec![polygon(&wall)],
            vec![polygon(&pocket)],
        ] {
            let goal = goal([(0, [0.0, 0.0]), (60, [0.0, 4.0])], obstacles);
            let line = positions(&goal);
            assert_eq!((line[0], line[60]), ([0.0, 0.0], [0.0, 4.0]));
            let steps: Vec<f64> = line
                .windows(2)
                .map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]))
                .collect();
            let longest = steps.iter().copied().fold(0.0, f64::max);
            // Steps over a corner are shorter.
            assert!(steps.iter().all(|step| *step > 0.5 * longest), "{steps:?}");
            assert!((60.0 * longest) < 8.0, "{longest}");
            for pair in line.windows(2) {
                // Steps over a corner may cut it.
                assert!(goal.clearance(pair[0], pair[1]) > 0.25, "{pair:?}");
            }
        }
    }

    #[test]
    fn the_way_around_a_disc_is_short() {
        let goal = goal(
            [(0, [0.0, 0.0]), (60, [0.0, 4.0])],
            vec![disc(0.0, 2.0, 0.5)],
        );
        let length: f64 = positions(&goal)
            .windows(2)
            .map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]))
            .sum();
        // Two tangents and an arc at 0.8 m from the center.
        let exact = 2.0 * (4.0f64 - 0.64).sqrt() + 0.8 * 2.0 * (0.8f64 / 2.0).asin();
        assert!(
            length > exact - 0.02 && length < 1.04 * exact,
            "{length} {exact}"
        );
    }

    #[test]
    fn a_free_line_and_an_enclosed_target_are_straight() {
        let ends = [(0, [0.0, 0.0]), (60, [0.0, 4.0])];
        let straight = goal(ends, Vec::new());
        let same = |obstacles| {
            let (found, expected) = (positions(&goal(ends, obstacles)), positions(&straight));
            found
                .iter()
                .flatten()
                .zip(expected.iter().flatten())
                .all(|(a, b)| (a - b).abs() < 1e-9)
        };
        assert!(same(vec![disc(1.0, 2.0, 0.5)]));
        // The last keyframe is inside.
        assert!(same(vec![disc(0.0, 4.0, 0.5)]));
        // Between overlapping discs all around.
        let ring = (0..12).map(|i| {
            f64::from(i)
                .mul_add(std::f64::consts::FRAC_PI_6, 0.1)
                .sin_cos()
        });
        assert!(same(
            ring.map(|(x, z)| disc(1.5 * x, 1.5 * z, 0.5)).collect()
        ));
        assert!(!same(vec![disc(0.0, 2.0, 0.5)]));
    }
}
