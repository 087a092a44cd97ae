//! Jobs.

use kinegrad_capture::RootPose;
use kinegrad_motion::Quaternion;
use kinegrad_motion::vector::{length, minus};

use super::*;
use crate::motion_matrix::tests::example;
use crate::{Preset, jerk_around};

fn job() -> Job {
    Job::default()
}

fn walk(frames: usize) -> Example {
    example("walk.bvh", frames, 1.0 / 30.0)
}

#[test]
fn a_motion_is_twice_its_examples_with_their_joints() {
    let made = job().make(&[walk(70), walk(50)]).unwrap();
    assert_eq!(made.bvh.frames(), 240);
    assert_eq!(made.bvh.joints(), walk(1).bvh.joints());
    assert_eq!(made.bvh.frame_time(), 1.0 / 30.0);
    let text = made.bvh.to_text();
    assert!(Bvh::parse(text.as_bytes(), "new.bvh").is_ok());
    let half = Job {
        length: Some(Length::Times(0.5)),
        ..job()
    };
    assert_eq!(half.make(&[walk(70)]).unwrap().bvh.frames(), 35);
    let long = Job {
        length: Some(Length::Seconds(4.0)),
        ..job()
    };
    assert_eq!(long.make(&[walk(70)]).unwrap().bvh.frames(), 120);
}

#[test]
fn the_paper_divides_the_body_and_matches_contacts() {
    let paper = Job {
        settings: Settings::of(Preset::Paper),
        contacts: true,
        parts: PartChoice::Automatic,
        ..job()
    };
    let made = paper.make(&[walk(70)]).unwrap();
    // Legs are matched with the root trajectory.
    assert_eq!(made.synthesis.origins.len(), 1);
    assert_eq!(made.layout.contacts, [3, 5]);
    assert_eq!(made.bvh.frames(), 140);
}

#[test]
fn fixed_parts_are_those_of_their_motion() {
    let legs = example("legs.bvh", 64, 1.0 / 30.0);
    let fixed = Fixed {
        part: "legs".to_string(),
        motion: legs.clone(),
    };
    let job = Job {
        fixed: vec![fixed.clone()],
        ..job()
    };
    let made = job.make(&[walk(70)]).unwrap();
    assert_eq!(made.bvh.frames(), 64);
    let legs_frames = made.layout.to_frames(&legs).unwrap();
    let channels = made.layout.channels_of(3);
    assert_eq!(
        made.synthesis.frames.columns(&channels),
        legs_frames.columns(&channels)
    );
    let longer = Job {
        length: Some(Length::Frames(80)),
        ..job.clone()
    };
    let message = longer.make(&[walk(70)]).unwrap_err().to_string();
    assert_eq!(message, "legs.bvh: has 64 frames, and option `length` 80");
    let unknown = Job {
        fixed: vec![Fixed {
            part: "wings".to_string(),
            ..fixed
        }],
        ..job
    };
    let message = unknown.make(&[walk(70)]).unwrap_err().to_string();
    assert!(message.contains("no part or joint `wings`"), "{message}");
}

#[test]
fn fixed_legs_stay_where_their_motion_has_them() {
    let mut legs = example("legs.bvh", 64, 1.0 / 30.0);
    let turn = Quaternion::from_rotation_vector([0.0, 0.8, 0.0]);
    let mut locals: Vec<RootPose> = (0..64).flat_map(|t| legs.bvh.locals(t)).collect();
    // The root joint is the second.
    for hips in locals.iter_mut().skip(1).step_by(legs.bvh.joints().len()) {
        let [x, y, z] = turn.rotate(hips.position);
        hips.position = [x + 310.0, y, z - 200.0];
        hips.orientation = turn * hips.orientation;
    }
    legs.bvh = legs.bvh.reposed(1.0 / 30.0, &locals).unwrap();
    for heading in [Heading::World, Heading::Relative] {
        let job = Job {
            fixed: vec![Fixed {
                part: "legs".to_string(),
                motion: legs.clone(),
            }],
            heading,
            ..job()
        };
        let made = job.make(&[walk(70)]).unwrap();
        for t in 0..64 {
            let (found, wanted) = (made.bvh.world(t), legs.bvh.world(t));
            for joint in 2..6 {
                for axis in 0..3 {
                    let off = found[joint].position[axis] - wanted[joint].position[axis];
                    assert!(
                        off.abs() < 0.05,
                        "{heading:?}, frame {t}, joint {joint}: {off}"
                    );
                }
            }
        }
    }
}

#[test]
fn key_frames_are_met() {
    let keyframe = Keyframe {
        time: 2.0,
        source_time: 0.5,
        file: None,
        part: None,
        place: None,
        reach: None,
        name: String::new(),
    };
    let job = Job {
        keyframes: vec![(keyframe, None)],
        ..job()
    };
    let made = job.make(&[walk(70)]).unwrap();
    let (found, pose) = (made.bvh.locals(60), walk(70).bvh.locals(15));
    for (found, pose) in found.iter().zip(&pose) {
        let turn = (found.orientation.conjugate() * pose.orientation).to_rotation_vector();
        assert!(turn.iter().all(|angle| angle.abs() < 1e-4));
    }
    assert!((found[1].position[1] - pose[1].position[1]).abs() < 1e-4);
}

#[test]
fn a_pose_from_a_wilder_motion_jerks_little_more_than_the_rest() {
    // The same walk at three times its speed.
    let mut text = crate::motion_matrix::tests::text(210, 1.0 / 10.0);
    text = text.replace("Frame Time: 0.1\n", "Frame Time: 0.03333333\n");
    let wild = Example {
        file: "wild.bvh".to_string(),
        bvh: Bvh::parse(text.as_bytes(), "wild.bvh").unwrap(),
    };
    let keyframe = Keyframe {
        time: 2.0,
        source_time: 3.0,
        file: None,
        part: None,
        place: None,
        reach: None,
        name: String::new(),
    };
    let job = Job {
        keyframes: vec![(keyframe, Some(wild.clone()))],
        ..job()
    };
    let made = job.make(&[walk(70)]).unwrap();
    let [near, rest] = jerk_around(&jerks(&made.bvh), 60.0, 30.0);
    assert!(near <= 1.5 * rest, "{near} {rest}");
    let source = made.layout.to_frames(&wild).unwrap();
    assert_eq!(
        made.synthesis.frames.frame(60)[..24],
        source.frame(90)[..24]
    );
}

#[test]
fn a_content_is_followed_in_the_manner_of_the_examples() {
    let mut content = walk(120);
    content.file = "content.bvh".to_string();
    let job = Job {
        content: Some(content.clone()),
        ..job()
    };
    let made = job.make(&[walk(70)]).unwrap();
    assert_eq!(made.bvh.frames(), 120);
    // The content is the examples' own walk, so its steps stay in time.
    let (channels, wanted) = (
        made.layout.channels_of(2),
        made.layout.to_frames(&content).unwrap(),
    );
    let apart = |t: usize| {
        let pairs = channels
            .iter()
            .map(|&c| made.synthesis.frames.frame(t)[c] - wanted.frame(t)[c]);
        pairs.map(|value| value * value).sum::<f32>().sqrt()
    };
    let mean = (0..120).map(apart).sum::<f32>() / 120.0;
    assert!(mean < 0.2, "{mean}");
    let longer = Job {
        length: Some(Length::Frames(80)),
        ..job
    };
    let message = longer.make(&[walk(70)]).unwrap_err().to_string();
    assert_eq!(
        message,
        "content.bvh: has 120 frames, and option `length` 80"
    );
}

#[test]
fn places_of_key_frames_are_passed() {
    for heading in [Heading::World, Heading::Relative] {
        let at = |time: f64, place| Keyframe {
            time,
            source_time: 0.5,
            file: None,
            part: None,
            place: Some(place),
            reach: None,
            name: String::new(),
        };
        let (one, two) = (at(3.0, [50.0, -80.0]), at(1.0, [-20.0, 30.0]));
        let job = Job {
            keyframes: vec![(one, None), (two, None)],
            heading,
            ..job()
        };
        let made = job.make(&[walk(70)]).unwrap();
        for (t, place) in [(90, [50.0, -80.0]), (30, [-20.0, 30.0])] {
            let [x, _, z] = made.bvh.locals(t)[1].position;
            assert!(
                (x - place[0]).abs() < 0.01 && (z - place[1]).abs() < 0.01,
                "{x} {z}"
            );
        }
        let start = made.bvh.locals(0)[1].position;
        assert!(start[0].abs() < 1e-3 && start[2].abs() < 1e-3);
    }
}

#[test]
fn a_motion_without_a_patch_is_refused() {
    let message = |frames: usize| {
        let error = job().make(&[walk(40), walk(frames)]).unwrap_err();
        error.to_string()
    };
    assert_eq!(
        message(1),
        "walk.bvh: frames: 1 at 30 a second, allowed: at least `patch_size`, which is 11"
    );
    assert!(message(10).contains("frames: 10 "));
    let short = Job {
        length: Some(Length::Frames(3)),
        ..job()
    };
    let message = short.make(&[walk(40)]).unwrap_err().to_string();
    assert!(message.contains("`length` is 3"), "{message}");
    assert!(job().make(&[]).is_err());
}

/// A body that sways above its feet; one foot rests while the other swings.
fn stepping() -> Example {
    swaying(25.0)
}

/// A body that sways, with feet that swing by an angle in degrees.
fn swaying(swing: f64) -> Example {
    let angles =
        |seconds: f64| [0.0, 3.1].map(|phase| swing * (5.0 * seconds + phase).sin().max(0.0));
    with_legs("steps.bvh", |seconds| 3.0 * (2.0 * seconds).sin(), angles)
}

/// A body that bows once, over feet that creep.
fn bow() -> Example {
    let mut bow = with_legs(
        "bow.bvh",
        |seconds| 0.2 * (2.1 * seconds).sin(),
        |_| [0.0; 2],
    );
    let spine = "JOINT Spine\n{\nOFFSET 0 20 0\nCHANNELS 3 Xrotation Yrotation Zrotation\nJOINT \
        Neck\n{\nOFFSET 0 40 0\nCHANNELS 0\nEnd Site\n{\nOFFSET 0 20 0\n}\n}\n}\n";
    let still = bow.bvh.to_text();
    let (hierarchy, frames) = still.split_once("MOTION").unwrap();
    let hierarchy = hierarchy.replacen("JOINT LeftThigh", &format!("{spine}JOINT LeftThigh"), 1);
    let mut lines = frames.lines();
    let head: Vec<&str> = lines.by_ref().take(3).collect();
    let mut text = format!("{hierarchy}MOTION{}\n", head.join("\n"));
    for (t, line) in lines.enumerate() {
        let share = ((t as f64 / 30.0 - 0.8) / 1.4).clamp(0.0, 1.0);
        let angle = 60.0 * (std::f64::consts::PI * share).sin().powi(2);
        let values: Vec<&str> = line.split_whitespace().collect();
        let (root, legs) = values.split_at(12);
        text += &format!("{} {angle} 0 0 {}\n", root.join(" "), legs.join(" "));
    }
    bow.bvh = Bvh::parse(text.as_bytes(), "bow.bvh").unwrap();
    bow
}

/// Three seconds of a body whose position and angles of both legs, in degrees, depend on the time.
fn with_legs(
    file: &str,
    position: impl Fn(f64) -> f64,
    angles: impl Fn(f64) -> [f64; 2],
) -> Example {
    let mut text = crate::motion_matrix::tests::text(1, 1.0 / 30.0);
    text = text.replace("Foot", "Shin").replace("Leg", "Thigh");
    for side in ["Left", "Right"] {
        let foot = format!(
            "JOINT {side}Foot\n{{\nOFFSET 0 -40 12.0\nCHANNELS 0\nEnd Site\n{{\nOFFSET 0 0 5\n}}\n}}\n"
        );
        text = text.replacen("End Site\n{\nOFFSET 0 -40 12\n}\n", &foot, 1);
    }
    let end = text.find("Frames").unwrap();
    text.truncate(end);
    text += "Frames: 90\nFrame Time: 0.0333333\n";
    for t in 0..90 {
        let seconds = f64::from(t) / 30.0;
        text += &format!("0 0 0 0 0 0 {} 90 0 0 0 0", position(seconds));
        for angle in angles(seconds) {
            text += &format!(" {} 0 0 0 0 {angle}", -angle);
        }
        text += "\n";
    }
    Example {
        file: file.to_string(),
        bvh: Bvh::parse(text.as_bytes(), file).unwrap(),
    }
}

#[test]
fn feet_are_locked_where_those_of_the_example_rest() {
    let feet = Job {
        lock_feet: true,
        ..job()
    };
    // Both feet of the walk have one bone above them, below the hips that they share.
    let message = feet.make(&[walk(70)]).unwrap_err().to_string();
    assert!(message.contains("no joint with two bones"), "{message}");
    let free = job().make(&[stepping()]).unwrap();
    let locked = feet.make(&[stepping()]).unwrap();
    assert!(free.sliding.is_none());
    let slid = locked.sliding.unwrap();
    assert!(slid.in_contact > 0.1 && slid.before > 1.0, "{slid:?}");
    assert!(slid.after < 0.05 * slid.before, "{slid:?}");
    // The file contains the locked feet, and nothing above the legs moves.
    let foot = locked.bvh.joint("LeftFoot").unwrap();
    let mut moved = 0;
    for t in 0..locked.bvh.frames() {
        let (new, old) = (locked.bvh.world(t), free.bvh.world(t));
        let apart = |joint: usize| {
            let axes = 0..3;
            let of = |axis: usize| (new[joint].position[axis] - old[joint].position[axis]).abs();
            axes.map(of).fold(0.0, f64::max)
        };
        assert!([0, 1, 2].into_iter().all(|joint| apart(joint) < 1e-6));
        moved += usize::from(apart(foot) > 1e-3);
    }
    assert!(moved > 0);
}

#[test]
fn feet_of_a_loop_are_locked_across_its_seam() {
    let standing = Job {
        lock_feet: true,
        ..job()
    };
    let mut example = swaying(0.0);
    example.bvh = standing.make(&[example.clone()]).unwrap().bvh;
    for seed in 0..3 {
        let job = Job {
            settings: Settings {
                looping: Looping::Even,
                ..job().settings
            },
            seed,
            adapts: true,
            ..standing.clone()
        };
        let made = job.make(&[example.clone()]).unwrap();
        let slid = made.sliding.unwrap();
        assert!(slid.after < 0.1 * slid.before, "{seed}: {slid:?}");
        let (foot, n) = (made.bvh.joint("LeftFoot").unwrap(), made.bvh.frames());
        let place = |t: usize| {
            let [x, _, z] = made.bvh.world(t % n)[foot].position;
            [x, 0.0, z]
        };
        let step = |t: usize| length(minus(place(t + 1), place(t)));
        let largest = (0..n - 1).map(step).fold(0.0, f64::max);
        assert!(step(n - 1) <= largest, "{seed}: {} {largest}", step(n - 1));
    }
}

#[test]
fn feet_that_creep_in_every_attempt_are_locked() {
    // A body that stands on locked feet and sways.
    let standing = Job {
        lock_feet: true,
        ..job()
    };
    let mut example = swaying(0.0);
    example.bvh = standing.make(&[example.clone()]).unwrap().bvh;
    for seed in 0..2 {
        let adapting = Job {
            seed,
            adapts: true,
            ..job()
        };
        let made = adapting.make(&[example.clone()]).unwrap();
        let slid = made.sliding.expect("locked feet");
        assert!(slid.before > 0.1 && slid.after < 1e-3, "{slid:?}");
        let free = Job { seed, ..job() }.make(&[example.clone()]).unwrap();
        assert!(made.quality.excess() < free.quality.excess());
    }
}

#[test]
fn a_loop_of_a_gesture_moves() {
    for seed in 0..4 {
        let job = Job {
            settings: Settings {
                looping: Looping::Even,
                ..job().settings
            },
            length: Some(Length::Seconds(8.0)),
            seed,
            adapts: true,
            ..job()
        };
        let made = job.make(&[bow()]).unwrap();
        let (motion, examples) = (&made.quality.motion, &made.quality.examples);
        assert!(
            motion.fastest_joint > 0.3 * examples.fastest_joint,
            "{seed}: {motion:?}"
        );
        assert!(
            motion.mean_speed > 0.6 * examples.mean_speed,
            "{seed}: {motion:?}"
        );
        assert!(
            made.quality.excess() < 2.0,
            "{seed}: {:?}",
            made.quality.beyond()
        );
        let seam = made.seam(Looping::Even).unwrap();
        assert!(seam.jump() < 1.0, "{seed}: {seam:?}");
        // The feet of the capture creep; the loop stays in its place.
        let path = made.layout.path(&made.synthesis.frames);
        let travelled = length(minus(path[path.len() - 1], path[0]));
        assert!(travelled < 0.1, "{seed}: {travelled}");
    }
}

#[test]
fn short_and_turning_examples_get_other_settings() {
    let walk = [walk(70)];
    let adapting = |seed| Job {
        seed,
        adapts: true,
        heading: Heading::Auto,
        ..job()
    };
    for seed in 0..3 {
        let plain = Job { seed, ..job() }.make(&walk).unwrap();
        let adapted = adapting(seed).make(&walk).unwrap();
        assert!(plain.adaptation.is_none() && !adapted.layout.is_relative());
        let [before, after] = [&plain, &adapted].map(|made| made.quality.excess());
        assert!(after <= 1.0 || after < before, "{seed}: {before} {after}");
        let quality = &adapted.quality;
        assert!(after > 1.0 || quality.beyond().is_empty(), "{quality:?}");
        assert_eq!(
            adapted.adaptation.is_none(),
            adapted.settings == job().settings
        );
    }
    // The walk turns once around.
    let mut turning = walk[0].clone();
    let mut locals: Vec<_> = (0..70).flat_map(|t| turning.bvh.locals(t)).collect();
    let joints = turning.bvh.joints().len();
    for (t, pose) in locals.chunks_mut(joints).enumerate() {
        let turn = kinegrad_motion::Quaternion::from_yaw(0.09 * t as f64);
        pose[1].orientation = turn * pose[1].orientation;
    }
    turning.bvh = turning.bvh.reposed(1.0 / 30.0, &locals).unwrap();
    let made = adapting(0).make(&[turning.clone()]).unwrap();
    assert!(made.layout.is_relative());
    assert!(made.quality.motion.largest_turn < 15.0);
    let world = Job {
        heading: Heading::World,
        ..adapting(0)
    };
    assert!(!world.make(&[turning]).unwrap().layout.is_relative());
}
