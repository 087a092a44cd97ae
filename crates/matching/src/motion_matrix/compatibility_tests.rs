//! Incompatible motions, and motions in which different joints travel.

use super::tests::{example, text};
use super::*;

fn parsed(text: &str, file: &str) -> Example {
    Example {
        file: file.to_string(),
        bvh: Bvh::parse(text.as_bytes(), file).unwrap(),
    }
}

fn walk() -> Example {
    example("walk.bvh", 40, 1.0 / 30.0)
}

fn refused(examples: &[Example]) -> String {
    let error = MotionMatrix::new(examples, MatrixOptions::default()).unwrap_err();
    error.to_string()
}

/// The walk, with the poses of its first joints changed by `change`.
fn changed(file: &str, change: impl Fn(usize, &mut [RootPose])) -> Example {
    let walk = walk();
    let mut locals: Vec<RootPose> = (0..40).flat_map(|t| walk.bvh.locals(t)).collect();
    for (t, pose) in locals.chunks_exact_mut(6).enumerate() {
        change(t, pose);
    }
    Example {
        file: file.to_string(),
        bvh: walk.bvh.reposed(1.0 / 30.0, &locals).unwrap(),
    }
}

#[test]
fn bones_of_another_size_are_refused() {
    let metres: String = text(40, 1.0 / 30.0)
        .lines()
        .map(|line| match line.strip_prefix("OFFSET ") {
            Some(numbers) => {
                let numbers = numbers
                    .split(' ')
                    .map(|n| n.parse::<f64>().unwrap() / 100.0);
                let numbers: Vec<String> = numbers.map(|n| n.to_string()).collect();
                format!("OFFSET {}\n", numbers.join(" "))
            }
            None => format!("{line}\n"),
        })
        .collect();
    assert_eq!(
        refused(&[walk(), parsed(&metres, "metres.bvh")]),
        "metres.bvh: the bone to `LeftFoot` is 0.4250 long, in walk.bvh 42.5000"
    );
    // Another rest pose, and a body a sixth smaller.
    let forth = text(40, 1.0 / 30.0).replace("OFFSET 0 -42.5 0", "OFFSET 0 0 42.5");
    let message = refused(&[walk(), parsed(&forth, "forth.bvh")]);
    assert!(
        message.contains("is 42.5000 long and points elsewhere"),
        "{message}"
    );
    let small = text(40, 1.0 / 30.0).replace("OFFSET 0 -42.5 0", "OFFSET 0 -36 0");
    let examples = [walk(), parsed(&small, "small.bvh")];
    MotionMatrix::new(&examples, MatrixOptions::default()).unwrap();
}

#[test]
fn a_motion_with_another_root_joint_keeps_its_trajectory() {
    // The root travels three times as far as the hips of the example, and turns.
    let taken = changed("taken.bvh", |t, pose| {
        pose[1].position = [0.0, pose[1].position[1], 0.0];
        pose[0].position = [0.0, 0.0, 3.0 * t as f64];
        pose[0].orientation = Quaternion::from_yaw(0.4);
    });
    for (example, other) in [(walk(), &taken), (taken.clone(), &walk())] {
        let examples = [example];
        for heading in [false, true] {
            let options = MatrixOptions {
                heading,
                ..MatrixOptions::default()
            };
            let layout = MotionMatrix::with(&examples, &[other], options).unwrap();
            assert_eq!(layout.root_joint, 1);
            let back = layout.to_bvh(&layout.to_frames(other).unwrap()).unwrap();
            let start = [&back, &other.bvh].map(|bvh| bvh.world(0)[3].position);
            for t in 0..40 {
                let [new, old] = [&back, &other.bvh].map(|bvh| bvh.world(t)[3].position);
                // The start is that of the first example.
                let apart = [0, 1, 2].map(|i| (new[i] - start[0][i]) - (old[i] - start[1][i]));
                if !heading {
                    assert!(length(apart) < 0.01, "{t}: {apart:?}");
                }
                assert!(
                    (length([new[0] - start[0][0], 0.0, new[2] - start[0][2]])
                        - length([old[0] - start[1][0], 0.0, old[2] - start[1][2]]))
                    .abs()
                        < 0.01
                );
            }
        }
    }
}

#[test]
fn the_trajectory_of_hips_below_a_turned_root_is_over_the_ground() {
    // A root that lies on its back and turns its hips upright again.
    let tip = Quaternion::from_rotation_vector([-std::f64::consts::FRAC_PI_2, 0.0, 0.0]);
    let tipped = changed("tipped.bvh", |_, pose| {
        pose[0].orientation = tip;
        pose[1].position = tip.conjugate().rotate(pose[1].position);
        pose[1].orientation = tip.conjugate() * pose[1].orientation;
    });
    for heading in [false, true] {
        let options = MatrixOptions {
            heading,
            ..MatrixOptions::default()
        };
        let of = |walk: &Example| {
            let layout = MotionMatrix::new(std::slice::from_ref(walk), options.clone()).unwrap();
            layout.to_frames(walk).unwrap()
        };
        let (one, other) = (of(&walk()), of(&tipped));
        for (a, b) in one.values().iter().zip(other.values()) {
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
    }
}

#[test]
fn what_the_first_example_cannot_write_is_refused() {
    let still = text(40, 1.0 / 30.0)
        .replace(
            "CHANNELS 6 Xposition Yposition Zposition Yrotation Xrotation Zrotation",
            "CHANNELS 3 Yrotation Xrotation Zrotation",
        )
        .lines()
        .map(|line| match line.split(' ').collect::<Vec<_>>() {
            words if words.len() == 24 => [&words[..6], &words[9..]].concat().join(" ") + "\n",
            _ => format!("{line}\n"),
        })
        .collect::<String>();
    let still = parsed(&still, "still.bvh");
    assert_eq!(
        refused(&[still.clone(), walk()]),
        "still.bvh: has no position channels for `Hips`, and walk.bvh moves `Hips`"
    );
    MotionMatrix::new(&[walk(), still.clone()], MatrixOptions::default()).unwrap();
    MotionMatrix::new(&[still], MatrixOptions::default()).unwrap();
    // A joint that slides in the source of a part also slides in the new motion.
    let slides = text(40, 1.0 / 30.0).replace(
        "OFFSET -9 -5 0\nCHANNELS 3 ",
        "OFFSET -9 -5 0\nCHANNELS 6 Xposition Yposition Zposition ",
    );
    let with_places = |y: fn(usize) -> f64| {
        let lines = slides.lines().enumerate().map(|(index, line)| {
            match line.split(' ').collect::<Vec<_>>() {
                words if words.len() == 24 => {
                    let (before, behind) = words.split_at(18);
                    format!(
                        "{} -9 {} 0 {}\n",
                        before.join(" "),
                        y(index),
                        behind.join(" ")
                    )
                }
                _ => format!("{line}\n"),
            }
        });
        lines.collect::<String>()
    };
    let one = parsed(&with_places(|_| -5.0), "one.bvh");
    let slides = parsed(&with_places(|t| -5.0 - (t % 2) as f64), "slides.bvh");
    let layout = MotionMatrix::with(
        std::slice::from_ref(&one),
        &[&slides],
        MatrixOptions::default(),
    );
    let layout = layout.unwrap();
    assert_eq!(layout.channels_of(4).len(), 9);
    let back = layout.to_bvh(&layout.to_frames(&slides).unwrap()).unwrap();
    for t in 0..40 {
        let [new, old] = [&back, &slides.bvh].map(|bvh| bvh.locals(t)[4].position[1]);
        assert!((new - old).abs() < 1e-3);
    }
}

#[test]
fn a_trajectory_within_a_turning_joint_has_no_heading() {
    // A tail on the root: the hips are not the root's only child.
    let text = text(40, 1.0 / 30.0);
    let tail =
        "JOINT Tail\n{\nOFFSET 0 1 0\nCHANNELS 0\nEnd Site\n{\nOFFSET 0 1 0\n}\n}\n}\nMOTION";
    let text = text.replace("}\nMOTION", tail);
    let quick: String = text
        .lines()
        .map(|line| match line.strip_prefix("0 0 0 0 0 0 ") {
            Some(rest) => {
                let (x, rest) = rest.split_once(' ').unwrap();
                let x = 10.0 * x.parse::<f64>().unwrap();
                format!("0 0 0 30 0 0 {x} {rest}\n")
            }
            None => format!("{line}\n"),
        })
        .collect();
    let turned = parsed(&quick, "turned.bvh");
    let upright = parsed(&quick.replace("0 0 0 30 0 0", "0 0 0 0 0 0"), "upright.bvh");
    let by_heading = || MatrixOptions {
        heading: true,
        ..MatrixOptions::default()
    };
    assert_eq!(
        MotionMatrix::new(std::slice::from_ref(&turned), by_heading())
            .unwrap_err()
            .to_string(),
        "turned.bvh: `Hips` travels within `Root`, which turns or moves"
    );
    MotionMatrix::new(&[upright], by_heading()).unwrap();
    let layout = MotionMatrix::new(&[turned], MatrixOptions::default()).unwrap();
    assert_eq!(layout.root_joint, 1);
}
