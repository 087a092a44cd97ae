//! Goals that no body can reach.

use super::{Goal, Obstacle};

/// Top speed of a sprinter, metres per second.
const FASTEST: f64 = 12.0;

/// A target position of the root.
struct Stop {
    name: String,
    frame: usize,
    position: [f64; 2],
}

impl Goal {
    /// Warnings about a valid goal: segments faster than a sprinter or than `fastest`, the fastest
    /// step of training in metres per second, positions in obstacles, and positions that obstacles
    /// enclose.
    pub fn feasibility_warnings(&self, fps: f64, fastest: f64) -> Vec<String> {
        let stops = self.stops();
        let segments = too_fast(&stops, fps, fastest);
        let mut warnings: Vec<String> = match self.trajectory {
            // One warning for all points.
            Some(_) => worst_of(segments.collect()).into_iter().collect(),
            None => segments.map(|(_, text)| text).collect(),
        };
        warnings.extend(self.inside_obstacles(&stops));
        warnings.extend(self.enclosed(&stops));
        warnings
    }

    /// Target positions by frame. A clip begins at the origin.
    fn stops(&self) -> Vec<Stop> {
        let stop = |name, frame, position| Stop {
            name,
            frame,
            position,
        };
        let keyframes = self.keyframes.iter().enumerate();
        let keyframes =
            keyframes.map(|(i, k)| stop(format!("keyframe[{i}]"), k.frame, k.position()));
        let points = self.trajectory.iter();
        let points = points.flat_map(|all| (all.first_frame..).zip(&all.points).enumerate());
        let points =
            points.map(|(i, (frame, at))| stop(format!("trajectory.points[{i}]"), frame, *at));
        let mut stops: Vec<Stop> = keyframes.chain(points).collect();
        stops.sort_by_key(|stop| stop.frame);
        if stops.first().is_some_and(|first| first.frame > 0) {
            stops.insert(0, stop("the start".into(), 0, [0.0; 2]));
        }
        stops
    }

    fn inside_obstacles(&self, stops: &[Stop]) -> Vec<String> {
        let mut warnings = Vec::new();
        for (index, obstacle) in self.obstacles.iter().enumerate() {
            let depth = |stop: &Stop| -Obstacle::signed_distance(obstacle, stop.position);
            let inside = || stops.iter().filter(|stop| depth(stop) > 0.0);
            let deepest = inside().max_by(|a, b| depth(a).total_cmp(&depth(b)));
            let Some(deepest) = deepest else { continue };
            let Stop { name, frame, .. } = deepest;
            let more = match inside().count() {
                1 => String::new(),
                all => format!(", and {} more positions are inside it", all - 1),
            };
            warnings.push(format!(
                "{name} (frame {frame}) is {:.2} m inside obstacle[{index}]{more}: the goal \
                 contradicts itself",
                depth(deepest)
            ));
        }
        warnings
    }

    /// The first segment between keyframes that crosses an obstacle on every line that was found.
    fn enclosed(&self, stops: &[Stop]) -> Option<String> {
        if self.trajectory.is_some() {
            return None;
        }
        let is_free = |stop: &Stop| self.clearance(stop.position, stop.position) > 0.0;
        let crosses = |pair: &&[Stop]| {
            let corners = self.detour(pair[0].position, pair[1].position);
            let mut lines = corners.windows(2);
            let is_crossed = lines.any(|line| self.clearance(line[0], line[1]) < 0.0);
            pair.iter().all(is_free) && is_crossed
        };
        let pair = stops.windows(2).find(crosses)?;
        Some(format!(
            "no line from {} (frame {}) to {} (frame {}) around the obstacles was found: the motion \
             may cross them",
            pair[0].name, pair[0].frame, pair[1].name, pair[1].frame
        ))
    }
}

/// Segments between neighboring targets that are too fast, with their speed.
fn too_fast(stops: &[Stop], fps: f64, fastest: f64) -> impl Iterator<Item = (f64, String)> {
    stops.windows(2).filter_map(move |pair| {
        let [from, to] = pair else { return None };
        let metres = (to.position[0] - from.position[0]).hypot(to.position[1] - from.position[1]);
        let seconds = (to.frame - from.frame) as f64 / fps;
        let speed = metres / seconds;
        let reason = match speed > FASTEST {
            true => format!("no body runs faster than {FASTEST} m/s, so the goal will be missed"),
            false => format!("the fastest step of training is {fastest:.2} m/s"),
        };
        let text = format!(
            "from {} (frame {}) to {} (frame {}) it is {metres:.1} m in {seconds:.2} s, {speed:.1} \
             m/s: {reason}",
            from.name, from.frame, to.name, to.frame
        );
        (speed > fastest.min(FASTEST)).then_some((speed, text))
    })
}

/// The fastest segment, and the number of other segments.
fn worst_of(segments: Vec<(f64, String)>) -> Option<String> {
    let all = segments.len();
    let (_, text) = segments.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(match all {
        1 => text,
        all => format!("{text}; {} other steps are too fast too", all - 1),
    })
}

#[cfg(test)]
mod tests {
    use super::super::{Keyframe, Trajectory};
    use super::*;

    fn goal(keyframes: &[(usize, f64, f64)]) -> Goal {
        let keyframe = |&(frame, x, z): &(usize, f64, f64)| Keyframe { frame, x, z };
        Goal {
            keyframes: keyframes.iter().map(keyframe).collect(),
            ..Goal::new(120)
        }
    }

    #[test]
    fn a_segment_that_is_too_fast_is_named_with_distance_time_and_speed() {
        let warnings = goal(&[(30, 0.0, 100.0)]).feasibility_warnings(20.0, FASTEST);
        assert_eq!(warnings.len(), 1);
        for part in [
            "the start (frame 0)",
            "keyframe[0] (frame 30)",
            "100.0 m in 1.50 s",
            "66.7 m/s",
        ] {
            assert!(warnings[0].contains(part), "{warnings:?}");
        }
        // The keyframes are unsorted; only the second segment is too fast.
        let warnings =
            goal(&[(60, 0.0, 30.0), (40, 0.0, 10.0)]).feasibility_warnings(20.0, FASTEST);
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(warnings[0].contains("from keyframe[1] (frame 40) to keyframe[0] (frame 60)"));
    }

    #[test]
    fn a_possible_speed_has_no_warning() {
        assert!(
            goal(&[(20, 0.0, 11.9)])
                .feasibility_warnings(20.0, FASTEST)
                .is_empty()
        );
        assert!(
            goal(&[(0, 5.0, 5.0), (20, 5.0, 6.0)])
                .feasibility_warnings(20.0, FASTEST)
                .is_empty()
        );
        assert!(Goal::new(10).feasibility_warnings(20.0, FASTEST).is_empty());
    }

    #[test]
    fn a_segment_faster_than_training_is_named() {
        let goal = goal(&[(20, 0.0, 3.0)]);
        assert!(goal.feasibility_warnings(20.0, 3.1).is_empty());
        let warnings = goal.feasibility_warnings(20.0, 1.6);
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(
            warnings[0].ends_with("3.0 m/s: the fastest step of training is 1.60 m/s"),
            "{warnings:?}"
        );
    }

    #[test]
    fn an_enclosed_keyframe_is_named() {
        let mut goal = goal(&[(60, 0.0, 3.0)]);
        let wall = |side: f64| {
            let corner = |x: f64, z: f64| [side * x, 3.0 + side * z];
            [
                corner(-1.0, 0.9),
                corner(1.0, 0.9),
                corner(1.0, 1.0),
                corner(-1.0, 1.0),
            ]
            .to_vec()
        };
        let across = |side: f64| {
            let corner = |x: f64, z: f64| [side * x, 3.0 + z];
            [
                corner(0.9, -1.0),
                corner(1.0, -1.0),
                corner(1.0, 1.0),
                corner(0.9, 1.0),
            ]
            .to_vec()
        };
        goal.obstacles = [wall(-1.0), wall(1.0), across(-1.0)]
            .map(|vertices| Obstacle::Polygon { vertices })
            .to_vec();
        assert!(goal.feasibility_warnings(20.0, FASTEST).is_empty());
        goal.obstacles.push(Obstacle::Polygon {
            vertices: across(1.0),
        });
        let warnings = goal.feasibility_warnings(20.0, FASTEST);
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(
            warnings[0].starts_with("no line from the start (frame 0) to keyframe[0] (frame 60)"),
            "{warnings:?}"
        );
    }

    #[test]
    fn of_a_trajectory_the_fastest_step_is_named() {
        let mut goal = Goal::new(10);
        let points = vec![[0.0, 0.0], [0.0, 0.7], [0.0, 2.7], [0.0, 2.8]];
        goal.trajectory = Some(Trajectory {
            first_frame: 0,
            points,
        });
        let warnings = goal.feasibility_warnings(20.0, FASTEST);
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(warnings[0].contains("trajectory.points[1] (frame 1) to trajectory.points[2]"));
        assert!(
            warnings[0].ends_with("; 1 other steps are too fast too"),
            "{warnings:?}"
        );
    }

    #[test]
    fn a_keyframe_inside_an_obstacle_contradicts_the_goal() {
        let mut goal = goal(&[(60, 1.0, 1.0)]);
        goal.obstacles = vec![Obstacle::Disc {
            x: 1.0,
            z: 1.25,
            radius: 0.5,
        }];
        let warnings = goal.feasibility_warnings(20.0, FASTEST);
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(warnings[0].starts_with("keyframe[0] (frame 60) is 0.25 m inside obstacle[0]"));
    }
}
