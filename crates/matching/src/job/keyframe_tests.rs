//! Key frames of jobs: close together, near the ends, and in loops; places and headings.

use super::*;
use crate::jerk_around;
use crate::motion_matrix::tests::example;

fn walk(frames: usize) -> Example {
    example("walk.bvh", frames, 1.0 / 30.0)
}

fn key(time: f64, source_time: f64) -> Keyframe {
    Keyframe {
        time,
        source_time,
        file: None,
        part: None,
        place: None,
        reach: None,
        name: String::new(),
    }
}

fn with(keyframes: &[Keyframe]) -> Job {
    Job {
        keyframes: keyframes.iter().map(|key| (key.clone(), None)).collect(),
        ..Job::default()
    }
}

/// Largest rotation, in degrees, between frame `t` of a motion and frame `from` of the walk, over
/// the joints from `first` on, and the difference of the heights.
fn missed(made: &Made, t: usize, from: usize, first: usize) -> (f64, f64) {
    let (found, pose) = (made.bvh.locals(t), walk(70).bvh.locals(from));
    let turns = found[first..].iter().zip(&pose[first..]).map(|(a, b)| {
        let turn = (a.orientation.conjugate() * b.orientation).to_rotation_vector();
        kinegrad_motion::vector::length(turn).to_degrees()
    });
    let height = (found[1].position[1] - pose[1].position[1]).abs();
    (turns.fold(0.0, f64::max), height)
}

#[test]
fn key_frames_close_together_are_all_met() {
    for reach in [None, Some(0.0), Some(2.0)] {
        let at = |time: f64, source_time: f64, part: Option<&str>| Keyframe {
            part: part.map(str::to_string),
            reach,
            ..key(time, source_time)
        };
        // Neighbouring key frames of a leg and of the body do not change each other.
        let keys = [
            at(1.0, 0.3, None),
            at(1.2, 1.7, None),
            at(2.0, 0.9, Some("LeftFoot")),
            at(2.1, 1.4, None),
            at(0.9, 1.1, None),
        ];
        let made = with(&keys).make(&[walk(70)]).unwrap();
        for (t, from) in [(30, 9), (36, 51), (63, 42), (27, 33)] {
            let (degrees, height) = missed(&made, t, from, 0);
            assert!(degrees < 0.1 && height < 0.01, "{t} {degrees} {height}");
        }
        let (found, pose) = (made.bvh.locals(60), walk(70).bvh.locals(27));
        let turn = found[3].orientation.conjugate() * pose[3].orientation;
        assert!(turn.to_rotation_vector().iter().all(|v| v.abs() < 1e-3));
    }
}

#[test]
fn a_loop_with_a_key_frame_has_a_smooth_seam() {
    for (seed, time) in [(0, 1.0), (1, 2.0), (2, 0.0), (3, 3.3)] {
        let mut job = with(&[key(time, 0.9)]);
        job.settings.looping = Looping::Even;
        job.seed = seed;
        let made = job.make(&[walk(70)]).unwrap();
        let seam = made.seam(Looping::Even).unwrap();
        assert!(seam.jump() <= 1.0, "seed {seed}: {seam:?}");
    }
}

#[test]
fn key_frames_near_an_end_jerk_little_more_than_the_rest() {
    // The same walk at three times its speed.
    let text = crate::motion_matrix::tests::text(210, 1.0 / 10.0);
    let text = text.replace("Frame Time: 0.1\n", "Frame Time: 0.03333333\n");
    let wild = Example {
        file: "wild.bvh".to_string(),
        bvh: Bvh::parse(text.as_bytes(), "wild.bvh").unwrap(),
    };
    for t in [0, 3, 6, 133, 136, 139] {
        let mut job = with(&[key(f64::from(t) / 30.0, 3.0)]);
        job.keyframes[0].1 = Some(wild.clone());
        let made = job.make(&[walk(70)]).unwrap();
        let jerks = jerks(&made.bvh);
        let [near, rest] = jerk_around(&jerks, f64::from(t), 30.0);
        assert!(near <= 1.5 * rest, "{t}: {near} {rest}");
    }
}

#[test]
fn a_key_frame_does_not_still_the_rest() {
    let still = |seed, keyframes: &[Keyframe]| {
        let mut job = with(keyframes);
        job.length = Some(Length::Seconds(6.0));
        job.seed = seed;
        let made = job.make(&[walk(75)]).unwrap();
        made.quality.motion.still_share
    };
    for seed in [0, 1, 2] {
        let without = still(seed, &[]);
        for (time, source_time) in [(0.5, 2.0), (1.0, 0.3), (3.0, 1.0)] {
            let with = still(seed, &[key(time, source_time)]);
            assert!(with <= without + 0.05, "{seed} {time}: {with} {without}");
        }
    }
}

#[test]
fn a_loop_with_a_key_frame_at_its_seam_is_one() {
    for t in [0, 2, 60, 139] {
        let mut job = with(&[key(t as f64 / 30.0, 0.5)]);
        job.settings.looping = Looping::Even;
        let made = job.make(&[walk(70)]).unwrap();
        let frames = &made.synthesis.frames;
        let n = frames.frames();
        let step = |t: usize| {
            let pairs = frames.frame(t).iter().zip(frames.frame((t + 1) % n));
            pairs.map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
        };
        let most = (0..n - 1).map(step).fold(0.0, f32::max);
        assert!(step(n - 1) <= most, "{t}: {} {most}", step(n - 1));
        let (degrees, height) = missed(&made, t, 15, 0);
        assert!(degrees < 0.1 && height < 0.01, "{t} {degrees} {height}");
    }
}

#[test]
fn a_loop_that_turns_heads_at_its_end_as_at_its_beginning() {
    for keyframes in [vec![], vec![key(1.0, 0.5)]] {
        let mut job = with(&keyframes);
        job.length = Some(crate::Length::Frames(100));
        job.heading = Heading::Relative;
        job.settings.looping = Looping::Even;
        let made = job.make(&[walk(70)]).unwrap();
        let step = |a: usize, b: usize| {
            let [a, b] = [a, b].map(|t| made.bvh.locals(t)[1].orientation);
            kinegrad_motion::vector::length((a.conjugate() * b).to_rotation_vector())
        };
        let most = (1..100).map(|t| step(t - 1, t)).fold(0.0, f64::max);
        assert!(step(99, 0) <= 1.2 * most, "{} {most}", step(99, 0));
    }
}

#[test]
fn a_place_at_the_first_frame_is_where_the_motion_starts() {
    let first = Keyframe {
        place: Some([40.0, -30.0]),
        ..key(0.0, 0.5)
    };
    let later = Keyframe {
        place: Some([10.0, 20.0]),
        ..key(2.0, 0.5)
    };
    let made = with(&[first, later]).make(&[walk(70)]).unwrap();
    for (t, place) in [(0, [40.0, -30.0]), (60, [10.0, 20.0])] {
        let [x, _, z] = made.bvh.locals(t)[1].position;
        assert!(
            (x - place[0]).abs() < 0.01 && (z - place[1]).abs() < 0.01,
            "{x} {z}"
        );
    }
}
