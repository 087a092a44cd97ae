//! Motions that pass the strict checks, and motions that fail named checks.

use super::*;
use crate::Profile;
use crate::phrase::{ACCELERATION, ANGULAR_VELOCITY, PHASE, POSITION, VELOCITY};
use crate::random_phrase::random_phrase;
use crate::{Quaternion, derive};

fn training() -> Statistics {
    let phrases: Vec<Phrase> = (0..20).map(|seed| random_phrase(seed, 60)).collect();
    crate::phrase_statistics(&phrases).unwrap()
}

/// Changes one frame of a good phrase, then names the checks that fail.
fn failing(change: impl Fn(&mut Phrase)) -> Vec<&'static str> {
    let mut motion = random_phrase(7, 60);
    change(&mut motion);
    let report = check(&motion, &training());
    report
        .checks
        .iter()
        .filter(|check| !check.passed)
        .map(|check| check.name)
        .collect()
}

fn add_everywhere(motion: &mut Phrase, channels: std::ops::Range<usize>, offset: [f64; 3]) {
    for t in 0..motion.frames() {
        let value = motion.vector(t, channels.clone());
        motion.set_vector(
            t,
            channels.clone(),
            [0, 1, 2].map(|axis| value[axis] + offset[axis]),
        );
    }
}

#[test]
fn coherent_phrases_pass() {
    for seed in 0..20 {
        let report = check(&random_phrase(seed, 60), &training());
        assert!(report.passed, "{report:#?}");
        // Two of the measures depend on the length.
        assert_eq!(report.checks.len(), 9 + MotionMeasure::ALL.len() - 2);
    }
}

#[test]
fn a_phrase_without_any_error_passes_bounds_of_zero() {
    let mut still = Phrase::new(vec![0.0; 120 * crate::CHANNELS]).unwrap();
    (0..120).for_each(|t| still.set_quaternion(t, Quaternion::IDENTITY));
    let training = crate::phrase_statistics([&still, &still]).unwrap();
    assert_eq!(training.rms_speed, Some(0.0));
    let report = check(&still, &training);
    assert!(report.passed, "{report:#?}");
}

#[test]
fn a_single_frame_of_wrong_norm_or_sign_fails() {
    let scale =
        |factor: f64| failing(move |m| m.set_quaternion(30, m.quaternion(30).scale(factor)));
    assert_eq!(scale(1.002), ["quaternion_norm"]);
    assert_eq!(scale(0.998), ["quaternion_norm"]);
    assert!(scale(1.0005).is_empty());
    assert_eq!(scale(-1.0), ["quaternion_sign"]);
}

#[test]
fn phase_outside_the_bar_fails() {
    // The error is in all frames, so no single step stands out.
    assert_eq!(
        failing(|m| (0..60).for_each(|t| m.frame_mut(t)[PHASE] += 0.018)),
        ["phase"]
    );
    assert_eq!(failing(|m| m.frame_mut(0)[PHASE] = -0.001), ["phase"]);
}

#[test]
fn errors_beyond_a_tenth_of_the_training_scale_fail() {
    let statistics = training();
    // The Euclidean norm counts: the offset has shares 0.6 and 0.8 along two axes.
    let offset = |share: f64, scale: f64| [0.6 * share * scale, 0.0, -0.8 * share * scale];
    let (speed, rate) = (
        statistics.rms_speed.unwrap(),
        statistics.rms_acceleration.unwrap(),
    );
    let velocity = |share| failing(|m| add_everywhere(m, VELOCITY, offset(share, speed)));
    assert!(velocity(0.099).is_empty());
    assert_eq!(velocity(0.101), ["velocity_coherence"]);
    let acceleration = |share| failing(|m| add_everywhere(m, ACCELERATION, offset(share, rate)));
    assert!(acceleration(0.099).is_empty());
    assert_eq!(acceleration(0.101), ["accel_coherence"]);
}

#[test]
fn trembling_fails() {
    let zigzag = |times: f64| {
        let size = times * training().jerk_p95.unwrap() / 30.0;
        failing(move |m| {
            (0..60).for_each(|t| m.set_vector(t, ACCELERATION, [0.0, size * (t % 2) as f64, 0.0]))
        })
    };
    assert!(zigzag(3.01).contains(&"jerk"));
    assert!(!zigzag(2.99).contains(&"jerk"));
}

/// A phrase with these poses; the other channels follow from the poses.
fn with_poses(
    pose: impl Fn(usize, [f64; 3], Quaternion, f64) -> ([f64; 3], Quaternion, f64),
) -> Phrase {
    let good = random_phrase(7, 60);
    let (mut positions, mut quaternions, mut phases) = (Vec::new(), Vec::new(), Vec::new());
    for t in 0..60 {
        let phase = f64::from(good.frame(t)[PHASE]);
        let pose = pose(t, good.vector(t, POSITION), good.quaternion(t), phase);
        positions.push(pose.0);
        quaternions.push(pose.1);
        phases.push(pose.2);
    }
    derive(&positions, &quaternions, &phases, &[[0.0; 8]; 60]).unwrap()
}

fn failed(motion: &Phrase) -> Vec<&'static str> {
    let report = check(motion, &training());
    let failed = report.checks.iter().filter(|check| !check.passed);
    failed.map(|check| check.name).collect()
}

#[test]
fn broken_movement_that_agrees_with_its_channels_fails_by_name() {
    assert!(failed(&with_poses(|_, p, q, phase| (p, q, phase))).is_empty());
    let first = random_phrase(7, 60);
    let (place, pose) = (first.vector(0, POSITION), first.quaternion(0));

    let frozen = failed(&with_poses(|_, _, _, phase| (place, pose, phase)));
    for name in ["path_speed", "path_acceleration", "path_jerk", "turn_rate"] {
        assert!(frozen.contains(&name), "{frozen:?}");
    }
    // A deterministic tremble of one centimetre.
    let tremble = |t: usize| 0.01 * ((t * 7919 % 13) as f64 / 6.0 - 1.0);
    let shaking = failed(&with_poses(|t, p, q, phase| {
        (p.map(|x| x + tremble(t)), q, phase)
    }));
    assert!(shaking.contains(&"path_jerk"), "{shaking:?}");
    // The heading jumps by 60 degrees and back in every tenth frame.
    let jumping = failed(&with_poses(|t, p, q, phase| {
        let jump = if t % 10 == 5 { 60f64.to_radians() } else { 0.0 };
        (p, Quaternion::from_yaw(jump) * q, phase)
    }));
    assert!(jumping.contains(&"largest_turn"), "{jumping:?}");
    assert!(jumping.contains(&"turn_acceleration"), "{jumping:?}");
    // The body spins at three turns per second.
    let spinning = failed(&with_poses(|t, p, q, phase| {
        (p, Quaternion::from_yaw(0.628 * t as f64) * q, phase)
    }));
    assert!(spinning.contains(&"turn_rate"), "{spinning:?}");
    let standing = failed(&with_poses(|_, p, q, _| (p, q, 0.5)));
    assert_eq!(standing, ["phase_rate"]);
    // The phase goes from 0.17 to 0.88 of the bar at the right tempo, then jumps over the rest.
    let leaping = failed(&with_poses(|_, p, q, phase| {
        (p, q, 0.17 + 0.71 * (phase + 0.5).fract())
    }));
    assert_eq!(leaping, ["largest_phase_step"]);
    let backwards = failed(&with_poses(|_, p, q, phase| (p, q, 1.0 - phase)));
    assert_eq!(backwards, ["phase_direction", "phase_rate"]);
    // The body moves away at twelve metres per second.
    let carried = failed(&with_poses(|t, [x, y, z], q, phase| {
        ([x + 0.4 * t as f64, y, z], q, phase)
    }));
    assert_eq!(carried, ["path_speed", "fastest_step", "travel"]);
    // A jump by 10 cm in one frame, and a stop for the second half.
    let jump = failed(&with_poses(|t, [x, y, z], q, phase| {
        ([x, y + if t == 30 { 0.1 } else { 0.0 }, z], q, phase)
    }));
    assert!(jump.contains(&"largest_acceleration"), "{jump:?}");
    let stopped = failed(&with_poses(|t, p, q, phase| match t {
        0..30 => (p, q, phase),
        _ => (first.vector(30, POSITION), first.quaternion(30), phase),
    }));
    assert!(stopped.contains(&"still_share"), "{stopped:?}");
    let slow = failed(&with_poses(|t, _, q, phase| {
        ([0.001 * t as f64, 1.0, 0.0], q, phase)
    }));
    assert!(slow.contains(&"path_speed"), "{slow:?}");
}

#[test]
fn a_body_that_falls_over_fails_and_a_slight_lean_never_does() {
    let failing = |tilt: f64, p99: f64| {
        let mut training = training();
        let bounds = [p99 / 2.0, p99];
        training.movement.insert("largest_tilt".into(), bounds);
        let lean = Quaternion::from_rotation_vector([tilt.to_radians(), 0.0, 0.0]);
        let leaning =
            with_poses(|t, p, _, phase| (p, Quaternion::from_yaw(0.05 * t as f64) * lean, phase));
        let report = check(&leaning, &training);
        !report.check("largest_tilt").unwrap().passed
    };
    assert!(failing(75.0, 37.0) && !failing(73.0, 37.0));
    assert!(failing(180.0, 37.0));
    assert!(failing(21.0, 0.0) && !failing(19.0, 0.0));
    // The dancers lie on the floor.
    assert!(failing(180.0, 95.0) && !failing(130.0, 95.0));
}

#[test]
fn no_part_of_a_long_motion_makes_up_for_another() {
    let training = training();
    let long = random_phrase(7, 600);
    let failed = |motion: &Phrase| {
        let report = check(motion, &training);
        report
            .checks
            .into_iter()
            .filter(|check| !check.passed)
            .map(|check| (check.name, check.message))
            .collect::<Vec<_>>()
    };
    assert_eq!(failed(&long), []);
    // The dancer stands for three seconds of twenty, from second 8 on, then continues.
    let standing = |t: usize| t.clamp(0, 240) + t.saturating_sub(330);
    let poses = (0..600).map(standing);
    let positions: Vec<_> = poses.clone().map(|t| long.vector(t, POSITION)).collect();
    let quaternions: Vec<_> = poses.map(|t| long.quaternion(t)).collect();
    let phases: Vec<_> = (0..600).map(|t| f64::from(long.frame(t)[PHASE])).collect();
    let motion = derive(&positions, &quaternions, &phases, &[[0.0; 8]; 600]).unwrap();
    let found = failed(&motion);
    let speed = found.iter().find(|(name, _)| *name == "path_speed");
    let (_, message) = speed.expect("a window that stands");
    assert!(
        message.contains("0.000 m/s in seconds 8.") || message.contains("in seconds 9."),
        "{message}"
    );
    // The mean over the whole phrase is within the bounds.
    assert!(
        means(&motion, &training)
            .iter()
            .all(|check| check.passed || check.name != "path_speed")
    );
}

#[test]
fn windows_cover_a_motion_and_are_as_long_as_training_phrases() {
    let training = training();
    for frames in [1, 59, 60, 61, 90, 91, 119, 120, 121, 600, 1001] {
        let windows = windows(frames, &training);
        assert_eq!((windows[0].start, windows.last().unwrap().end), (0, frames));
        assert_eq!(windows.len() == 1, frames <= 67, "{frames}");
        for pair in windows.windows(2) {
            assert_eq!(pair[1].len(), 60);
            assert!(pair[1].start > pair[0].start && pair[1].start <= pair[0].start + 8);
        }
    }
}

#[test]
fn channels_that_lie_about_the_movement_fail() {
    let lying = failing(|m| add_everywhere(m, ANGULAR_VELOCITY, [0.0, 0.2, 0.0]));
    assert_eq!(lying, ["rotation_coherence"]);
    // The path zigzags, while velocity, acceleration and jerk are those of a smooth path.
    let zigzag = failing(|m| {
        for t in (0..60).step_by(2) {
            let place = m.vector(t, POSITION);
            m.set_vector(t, POSITION, [place[0] + 0.03, place[1], place[2]]);
        }
    });
    assert!(zigzag.contains(&"path_jerk"), "{zigzag:?}");
    assert!(!zigzag.contains(&"jerk"));
}

#[test]
fn without_measures_of_movement_the_bounds_are_those_of_dancers() {
    let old = Statistics {
        movement: Default::default(),
        ..training()
    };
    let check =
        |statistics| super::super::check(&random_phrase(7, 60), Profile::Strict, statistics);
    let of_people = check(None);
    assert!(of_people.check("path_speed").is_some());
    assert_eq!(check(Some(&old)), of_people);
}

#[test]
fn a_root_at_a_wrong_height_fails() {
    let fails = |offset| failing(|m| add_everywhere(m, POSITION, [0.0, offset, 0.0]));
    assert_eq!(fails(-1.5), ["height", "lowest_height"]);
    assert_eq!(fails(1.0), ["height", "highest_height"]);
    assert!(fails(0.02).is_empty());
}
