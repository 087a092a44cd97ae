//! Goals as TOML and JSON, their validation, and the guidance loss.

use proptest::prelude::*;

use super::*;

fn read(json: &str) -> Goal {
    serde_json::from_str(json).unwrap()
}

fn message(goal: &Goal) -> String {
    goal.validate().unwrap_err().to_string()
}

fn keyframe(frame: usize, x: f64, z: f64) -> Keyframe {
    Keyframe { frame, x, z }
}

fn disc(x: f64, z: f64, radius: f64) -> Obstacle {
    Obstacle::Disc { x, z, radius }
}

#[test]
fn a_goal_reads_and_writes_as_a_document() {
    let goal = read(
        r#"{
            "frames": 120,
            "keyframe": [{"frame": 90, "x": 1, "z": 3.5}, {"frame": 30, "x": 0.5, "z": 1.2}],
            "obstacle": [{"kind": "disc", "x": 1.0, "z": 2.0, "radius": 0.4}],
            "weights": {"obstacle": 2.5}
        }"#,
    );
    goal.validate().unwrap();
    assert_eq!(goal.keyframes[1], keyframe(30, 0.5, 1.2));
    assert_eq!(goal.obstacles, [disc(1.0, 2.0, 0.4)]);
    assert_eq!((goal.weights.position, goal.weights.obstacle), (1.0, 2.5));
    assert_eq!(goal.margin, 0.0);
    let written = serde_json::to_string(&goal).unwrap();
    assert_eq!(read(&written), goal);
    let goal = read(r#"{"frames": 3, "trajectory": {"points": [[0, 0], [0.5, 1]]}}"#);
    goal.validate().unwrap();
    let expected = [Some([0.0, 0.0]), Some([0.5, 1.0]), None];
    assert_eq!(goal.points().positions(), expected);
    assert_eq!(goal.dense().positions(), expected);
}

#[test]
fn long_lists_are_refused_or_take_one_step_for_each_entry() {
    let ring = |corners: usize, radius: f64| {
        let turn = |i: usize| std::f64::consts::TAU * i as f64 / corners as f64;
        let corner = |i| [radius * turn(i).cos(), radius * turn(i).sin()];
        Obstacle::Polygon {
            vertices: (0..corners).map(corner).collect(),
        }
    };
    let mut goal = Goal::new(MAX_FRAMES);
    goal.obstacles = vec![ring(500, 1.0), ring(1500, 2.0)];
    goal.validate().unwrap();
    // By pairs of edges this would take minutes.
    goal.obstacles.push(ring(300_000, 3.0));
    let refused = message(&goal);
    assert!(
        refused.contains("polygons with 302000 corners in all"),
        "{refused}"
    );
    let disc = |x| Obstacle::Disc {
        x,
        z: 0.0,
        radius: 0.1,
    };
    goal.obstacles = (0..1001).map(|index| disc(f64::from(index))).collect();
    let refused = message(&goal);
    assert!(
        refused.contains("a list of 1001 discs, allowed: at most 1000 discs"),
        "{refused}"
    );
    goal.obstacles.pop();
    goal.validate().unwrap();
    goal.obstacles.clear();
    goal.keyframes = (0..MAX_FRAMES)
        .map(|frame| keyframe(frame, 0.0, 0.0))
        .collect();
    goal.validate().unwrap();
    goal.keyframes[MAX_FRAMES - 1].frame = 7;
    let refused = message(&goal);
    assert!(refused.contains("like that of `keyframe[7]`"), "{refused}");
}

#[test]
fn unknown_keys_are_refused() {
    for json in [
        r#"{"frames": 3, "keyframes": []}"#,
        r#"{"frames": 3, "keyframe": [{"frame": 1, "x": 0, "z": 0, "y": 0}]}"#,
        r#"{"frames": 3, "trajectory": {"points": [], "frames": 2}}"#,
        r#"{"frames": 3, "weights": {"goal": 2}}"#,
        r#"{"keyframe": []}"#,
    ] {
        assert!(serde_json::from_str::<Goal>(json).is_err(), "{json}");
    }
}

#[test]
fn errors_name_the_key_what_was_found_and_what_is_allowed() {
    let mut goal = Goal::new(120);
    goal.keyframes = vec![
        keyframe(30, 0.0, 0.0),
        keyframe(40, 1.0, 0.0),
        keyframe(300, 0.0, 0.0),
    ];
    assert_eq!(
        message(&goal),
        "`keyframe[2].frame` is 300, allowed: 0 to 119 (the goal has 120 frames)"
    );
    goal.keyframes[2].frame = 30;
    assert_eq!(
        message(&goal),
        "`keyframe[2].frame` is 30, like that of `keyframe[0]`, allowed: one keyframe for each \
         frame"
    );
    goal.keyframes[2] = keyframe(2, 0.0, f64::NAN);
    assert!(message(&goal).starts_with("`keyframe[2].z` is NaN, allowed: -100000 to 100000"));
    goal.keyframes[2] = keyframe(2, 1e308, 0.0);
    assert!(message(&goal).starts_with("`keyframe[2].x` is 1"));
    goal.keyframes.pop();
    goal.validate().unwrap();
    goal.trajectory = Some(Trajectory {
        first_frame: 118,
        points: vec![[0.0; 2]; 3],
    });
    assert!(message(&goal).starts_with("`trajectory` is given together with 2 keyframes"));
    goal.keyframes.clear();
    assert_eq!(
        message(&goal),
        "`trajectory.points` is a list of 3 positions, allowed: at most 2 (from frame 118 of 120)"
    );
    goal.trajectory.as_mut().unwrap().first_frame = 120;
    assert!(message(&goal).starts_with("`trajectory.first_frame` is 120, allowed: 0 to 119"));
    goal.trajectory.as_mut().unwrap().points.clear();
    assert!(message(&goal).starts_with("`trajectory.points` is empty"));
}

#[test]
fn a_goal_without_contents_or_frames_is_refused() {
    assert_eq!(Goal::new(9).validate().unwrap_err().key, "goal");
    assert!(message(&Goal::new(0)).starts_with("`frames` is 0, allowed: 1 to 216000"));
    let mut goal = Goal::new(9);
    goal.obstacles = vec![disc(0.0, 0.0, 1.0), disc(0.0, 0.0, 0.0)];
    assert!(message(&goal).starts_with("`obstacle[1].radius` is 0"));
    goal.obstacles.pop();
    goal.validate().unwrap();
    goal.margin = -0.1;
    assert!(message(&goal).starts_with("`margin` is -0.1, allowed: 0 to 100000"));
    goal.margin = 0.1;
    goal.weights.position = f64::INFINITY;
    assert!(message(&goal).starts_with("`weights.position` is inf"));
}

#[test]
fn the_line_is_left_out_or_goes_around_among_obstacles() {
    let mut goal = Goal::new(5);
    goal.keyframes = vec![keyframe(2, 2.0, 0.0)];
    let masked = |targets: GroundTargets| targets.masked().count();
    assert_eq!((masked(goal.dense()), masked(goal.points())), (3, 1));
    // A line could cross an obstacle.
    goal.obstacles = vec![disc(0.0, 5.0, 1.0)];
    assert_eq!(
        (masked(goal.dense()), masked(goal.around_obstacles())),
        (1, 3)
    );
}

#[test]
fn distances_are_divided_by_the_values_of_the_whole_batch() {
    let mut goals = [Goal::new(3), Goal::new(2)];
    goals[0].keyframes = vec![keyframe(0, 1.0, 0.0), keyframe(2, 0.0, 0.0)];
    goals[1].keyframes = vec![keyframe(1, 0.0, -1.0)];
    let mut positions = [0.0; 12];
    positions[4..6].copy_from_slice(&[3.0, -4.0]);
    let config = GuidanceConfig::default();
    let loss = GuidanceLoss::new(&config, &goals, 3).unwrap();
    // Two samples, six values: a factor of 1/3.
    let (value, gradient) = loss.evaluate(&positions);
    assert!((value - (1.0 + 7.0 + 1.0) / 3.0).abs() < 1e-12);
    let third = 1.0 / 3.0;
    let mut expected = [0.0; 12];
    (expected[0], expected[4], expected[5], expected[9]) = (-third, third, -third, third);
    assert_eq!(gradient, expected);
    // Frame 2 is not in the sum, but in the divisor.
    let limited = GuidanceConfig {
        frame_limit: Some(2),
        ..config.clone()
    };
    let loss = GuidanceLoss::new(&limited, &goals, 3).unwrap();
    assert!((loss.evaluate(&positions).0 - 2.0 / 3.0).abs() < 1e-12);
    let squared = GuidanceConfig {
        norm: GuidanceNorm::Mse,
        ..config
    };
    let loss = GuidanceLoss::new(&squared, &goals, 3).unwrap();
    let (value, gradient) = loss.evaluate(&positions);
    assert!((value - (1.0 + 25.0 + 1.0) / 3.0).abs() < 1e-12);
    assert!((gradient[5] + 8.0 / 3.0).abs() < 1e-12);
}

#[test]
fn depth_in_obstacles_is_divided_by_the_frames_of_the_goal() {
    let mut goal = Goal::new(4);
    goal.obstacles = vec![disc(0.0, 0.0, 1.0), disc(0.0, 9.0, 1.0)];
    let config = GuidanceConfig::default();
    let mut positions = [5.0; 10];
    positions[2..4].copy_from_slice(&[0.6, 0.0]);
    // These frames are after the goal's end.
    positions[8..].copy_from_slice(&[0.0, 0.0]);
    let evaluate = |goal: &Goal| {
        let loss = GuidanceLoss::new(&config, std::slice::from_ref(goal), 5).unwrap();
        loss.evaluate(&positions)
    };
    let (value, gradient) = evaluate(&goal);
    assert!((value - 5.0 * 0.4 / 4.0).abs() < 1e-12);
    let mut expected = [0.0; 10];
    expected[2] = -5.0 / 4.0;
    assert_eq!(gradient, expected);
    goal.margin = 0.5;
    goal.weights.obstacle = 1.0;
    assert!((evaluate(&goal).0 - 0.9 / 4.0).abs() < 1e-12);
    positions[2] = f64::NAN;
    let loss = GuidanceLoss::new(&config, &[goal], 5).unwrap();
    assert!(loss.evaluate(&positions).0.is_nan());
}

#[test]
fn goals_that_do_not_fit_the_motion_are_refused() {
    let mut goal = Goal::new(10);
    goal.keyframes = vec![keyframe(3, 0.0, 0.0)];
    let refused = |config: &GuidanceConfig, frames| {
        let error = GuidanceLoss::new(config, std::slice::from_ref(&goal), frames);
        error.map(|_| ()).unwrap_err().to_string()
    };
    let default = GuidanceConfig::default();
    assert!(refused(&default, 9).starts_with("`frames` is 10, allowed: at most 9"));
    let none = GuidanceConfig {
        frame_limit: Some(0),
        ..default.clone()
    };
    assert!(refused(&none, 10).starts_with("`frame_limit` is 0"));
    assert!(GuidanceLoss::new(&default, &[Goal::new(2)], 10).is_err());
}

proptest! {
    #[test]
    fn the_gradient_is_that_of_the_value(
        positions in proptest::collection::vec(-2.0..2.0f64, 16),
        targets in proptest::collection::vec(-2.0..2.0f64, 4),
        squared: bool,
        margin in 0.0..0.5f64,
    ) {
        let mut goals = [Goal::new(4), Goal::new(3)];
        goals[0].keyframes = vec![keyframe(1, targets[0], targets[1])];
        goals[0].obstacles = vec![disc(0.3, -0.2, 1.1)];
        goals[1].keyframes = vec![keyframe(2, targets[2], targets[3])];
        let vertices = vec![[-1.0, -1.0], [1.5, -0.5], [0.2, 0.1], [0.5, 1.5]];
        goals[1].obstacles = vec![Obstacle::Polygon { vertices }, disc(1.0, 1.0, 0.5)];
        goals[1].weights.position = 0.5;
        goals.iter_mut().for_each(|goal| goal.margin = margin);
        let norm = if squared { GuidanceNorm::Mse } else { GuidanceNorm::L1 };
        let config = GuidanceConfig { norm, frame_limit: None };
        let loss = GuidanceLoss::new(&config, &goals, 4).unwrap();
        let (_, gradient) = loss.evaluate(&positions);
        let step = 1e-7;
        for index in 0..positions.len() {
            let at = |offset: f64| {
                let mut moved = positions.clone();
                moved[index] += offset;
                loss.evaluate(&moved).0
            };
            let (before, here, after) = (at(-step), at(0.0), at(step));
            let numeric = (after - before) / (2.0 * step);
            // At a kink the slopes of both sides differ, and all slopes in between are valid.
            let (left, right) = ((here - before) / step, (after - here) / step);
            let allowed = 1e-5 + (left - right).abs();
            prop_assert!((gradient[index] - numeric).abs() < allowed, "{index}");
        }
    }
}

#[test]
fn paths_may_end_before_the_motion_does() {
    let config = GuidanceConfig::default();
    let goals = [2, 5].map(|frames| {
        let mut goal = Goal::new(frames);
        let keyframe = Keyframe {
            frame: 1,
            x: 9.0,
            z: 9.0,
        };
        goal.keyframes = vec![keyframe];
        goal
    });
    let path = |frames: usize| vec![[1.0, 2.0]; frames];
    let loss = GuidanceLoss::along(&config, &goals, &[path(2), path(5)], 5).unwrap();
    let (value, gradient) = loss.evaluate(&[0.0; 20]);
    // Two samples have 14 target values: half are off by 1, half by 2.
    assert!((value - 2.0 / 14.0 * 7.0 * 3.0).abs() < 1e-9, "{value}");
    let expected = |index: usize| {
        if (4..10).contains(&index) {
            0.0
        } else {
            -2.0 / 14.0
        }
    };
    for (index, found) in gradient.into_iter().enumerate() {
        assert!((found - expected(index)).abs() < 1e-9, "{index}: {found}");
    }
}
