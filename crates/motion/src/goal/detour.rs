//! Lines between keyframes that go around obstacles.

use std::iter::successors;

use pathfinding::directed::astar::astar;

use super::{Goal, GroundTargets, Obstacle};
use crate::path::Polyline;
use crate::vector::minus;

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
/// `[least, greatest]` of x and z, metres.
type Bounds = [[f64; 2]; 2];

impl Goal {
    /// The trajectory, or the keyframes and the shortest lines between them that keep the goal's
    /// margin and 0.1 m more from the obstacles, at constant speed. Keyframes nearer to an obstacle
    /// reduce the distance. A line is straight if nothing is in its way, or if no detour is found.
    ///
    /// Detours are searched on a grid of at most 65 by 65 points around the line and the obstacles
    /// that it crosses. If there is none, the grid doubles with coarser cells, up to all obstacles.
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
            true => {
                let mut grids = self
                    .regions(from, to, least)
                    .map(|region| self.grid(region, from, to, least));
                grids.find_map(|grid| grid.path(least))
            }
            false => None,
        };
        let path = path.unwrap_or_else(|| vec![from, to]);
        pulled_tight(&path, &is_free)
    }

    /// The regions in which a detour is searched: the line with the obstacles nearer to it than
    /// `least`, then twice the sides of the region before, until all obstacles are inside.
    fn regions(&self, from: Point, to: Point, least: f64) -> impl Iterator<Item = Bounds> {
        let line = [0, 1].map(|axis| [from[axis].min(to[axis]), from[axis].max(to[axis])]);
        let with = |region: Bounds, each: &Obstacle| {
            let bounds = each.bounds();
            [0, 1].map(|axis| {
                let ([low, high], [lower, higher]) = (region[axis], bounds[axis]);
                [low.min(lower), high.max(higher)]
            })
        };
        let crossed = self.obstacles.iter();
        let crossed = crossed.filter(|each| each.swept_distance(from, to) < least);
        let first = crossed.fold(line, with);
        let all = self.obstacles.iter().fold(line, with);
        successors(Some(first), move |region| {
            let doubled = [0, 1].map(|axis| {
                let ([low, high], [least, greatest]) = (region[axis], all[axis]);
                let more = EDGE.max(0.5 * (high - low));
                [(low - more).max(least), (high + more).min(greatest)]
            });
            (doubled != *region).then_some(doubled)
        })
    }

    /// The grid over a region and its edge.
    fn grid(&self, region: Bounds, from: Point, to: Point, least: f64) -> Grid {
        let edge = least + EDGE;
        let sides = region.map(|[low, high]| high - low + 2.0 * edge);
        let cell = (sides[0].max(sides[1]) / CELLS).max(SMALLEST_CELL);
        let origin = region.map(|[low, _]| low - edge);
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
        let metres = |from: Cell, to: Cell| {
            let [x, z] = minus(self.point(to), self.point(from));
            x.hypot(z)
        };
        let distance = |cell: Cell| self.distances[cell[0] * self.size[1] + cell[1]];
        let is_free = |from: Cell, to: Cell| {
            // Over an obstacle between them, the distances would be less than the step's length.
            distance(to) >= least && distance(from) + distance(to) > metres(from, to)
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
        // Ends in the same cell have no path.
        (cells.len() > 1).then(|| cells.into_iter().map(|cell| self.point(cell)).collect())
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
            let goal = goal(ENDS, obstacles);
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

    const ENDS: [(usize, Point); 2] = [(0, [0.0, 0.0]), (60, [0.0, 4.0])];

    /// Length of the line of a goal, metres.
    fn length(goal: &Goal) -> f64 {
        let line = positions(goal);
        let steps = line.windows(2);
        let steps = steps.map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]));
        steps.sum()
    }

    /// Overlapping discs along a line from `from` to `to`.
    fn wall(from: Point, to: Point) -> impl Iterator<Item = Obstacle> {
        let [x, z] = minus(to, from);
        let last = (x.hypot(z) / 0.6).round();
        let shares = (0..=last as usize).map(move |index| index as f64 / last);
        shares.map(move |share| disc(from[0] + share * x, from[1] + share * z, 0.4))
    }

    #[test]
    fn walls_of_discs_are_rounded() {
        // Two tangents and an arc at 0.7 m from the last disc's center.
        let around = |half: f64| {
            let center = half.hypot(2.0);
            let turn = (half / center).asin() + (0.7 / center).asin();
            2.0 * (center.powi(2) - 0.49).sqrt() + 0.7 * 2.0 * turn
        };
        for half in [1.2, 2.4, 6.0, 24.0] {
            let goal = goal(ENDS, wall([-half, 2.0], [half, 2.0]).collect());
            assert!(goal.feasibility_warnings(1e-3, 12.0).is_empty(), "{half}");
            let (length, exact) = (length(&goal), around(half));
            let near = exact - 0.05..1.1 * exact;
            assert!(near.contains(&length), "{half}: {length} {exact}");
            for pair in positions(&goal).windows(2) {
                assert!(goal.clearance(pair[0], pair[1]) > 0.2, "{half}: {pair:?}");
            }
        }
    }

    #[test]
    fn walls_that_open_towards_an_end_are_left() {
        for side in [-1.0, 1.0] {
            // The start or the last keyframe is between the arms.
            let at = |x: f64, z: f64| [x, 2.0 + side * z];
            let back = wall(at(-2.4, 0.0), at(2.4, 0.0));
            let arms = [-2.4, 2.4].map(|x| wall(at(x, 0.0), at(x, 4.2)));
            let discs = back.chain(arms.into_iter().flatten());
            let goal = goal(ENDS, discs.collect());
            assert!(goal.feasibility_warnings(1e-3, 12.0).is_empty(), "{side}");
            let length = length(&goal);
            assert!((12.0..18.0).contains(&length), "{side}: {length}");
        }
    }

    /// Discs around the point `[0, 4]`.
    fn ring(discs: u32, radius: f64) -> impl Iterator<Item = Obstacle> {
        let turn = move |index| std::f64::consts::TAU * f64::from(index) / f64::from(discs);
        let ring = (0..discs).map(move |index| turn(index).sin_cos());
        ring.map(move |(x, z)| disc(radius * x, 4.0 + radius * z, 0.5))
    }

    #[test]
    fn a_ring_around_a_keyframe_is_crossed_with_a_warning() {
        // Discs elsewhere do not help.
        let others = wall([-9.0, -6.0], [90.0, -6.0]);
        let goal = goal(ENDS, ring(12, 1.5).chain(others).collect());
        assert!((length(&goal) - 4.0).abs() < 1e-9);
        let warnings = goal.feasibility_warnings(1e-3, 12.0);
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(
            warnings[0].starts_with("no line from keyframe[0]"),
            "{warnings:?}"
        );
    }

    #[test]
    fn the_number_of_searches_grows_with_the_logarithm_of_the_walls_length() {
        let searches = |discs: usize| {
            let half = 0.3 * discs as f64;
            let goal = goal(ENDS, wall([-half, 2.0], [half, 2.0]).collect());
            goal.regions(ENDS[0].1, ENDS[1].1, 0.3).count()
        };
        let counts = [10, 40, 160, 640, 2560].map(searches);
        for pair in counts.windows(2) {
            assert!((1..=3).contains(&(pair[1] - pair[0])), "{counts:?}");
        }
    }

    #[test]
    fn the_way_around_a_disc_is_short() {
        let goal = goal(ENDS, vec![disc(0.0, 2.0, 0.5)]);
        let length = length(&goal);
        // Two tangents and an arc at 0.8 m from the center.
        let exact = 2.0 * (4.0f64 - 0.64).sqrt() + 0.8 * 2.0 * (0.8f64 / 2.0).asin();
        assert!(
            length > exact - 0.02 && length < 1.04 * exact,
            "{length} {exact}"
        );
    }

    #[test]
    fn a_free_line_and_an_enclosed_target_are_straight() {
        let straight = goal(ENDS, Vec::new());
        let same = |obstacles| {
            let (found, expected) = (positions(&goal(ENDS, obstacles)), positions(&straight));
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
        assert!(same(ring(12, 1.5).collect()));
        assert!(!same(vec![disc(0.0, 2.0, 0.5)]));
    }
}
