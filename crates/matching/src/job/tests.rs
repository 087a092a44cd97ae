//! Whole jobs.

use super::*;
use crate::Preset;
use crate::figure::tests::example;

fn job() -> Job {
    Job {
        settings: Settings::of(Preset::Published),
        length: None,
        seed: 0,
        up: UpAxis::Y,
        contacts: false,
        heading: false,
        parts: PartChoice::Whole,
        keyframes: Vec::new(),
        fixed: Vec::new(),
    }
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
    assert_eq!(made.synthesis.origins.len(), 3);
    assert_eq!(made.figure.contacts(), [3, 5]);
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
    let held = made.figure.frames(&legs).unwrap();
    let channels = made.figure.channels_of(3);
    assert_eq!(
        made.synthesis.frames.columns(&channels),
        held.columns(&channels)
    );
    let longer = Job {
        length: Some(Length::Frames(80)),
        ..job.clone()
    };
    let said = longer.make(&[walk(70)]).unwrap_err().to_string();
    assert_eq!(
        said,
        "legs.bvh: has 64 frames, and another length asked for is 80"
    );
    let unknown = Job {
        fixed: vec![Fixed {
            part: "wings".to_string(),
            ..fixed
        }],
        ..job
    };
    let said = unknown.make(&[walk(70)]).unwrap_err().to_string();
    assert!(said.contains("no part or joint `wings`"), "{said}");
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
fn places_of_key_frames_are_passed() {
    for heading in [false, true] {
        let at = |time: f64, place| Keyframe {
            time,
            source_time: 0.5,
            file: None,
            part: None,
            place: Some(place),
            reach: None,
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
    let said = |frames: usize| {
        let error = job().make(&[walk(40), walk(frames)]).unwrap_err();
        error.to_string()
    };
    assert_eq!(
        said(1),
        "walk.bvh: frames: 1 at 30 a second, allowed: at least `patch_size`, which is 11"
    );
    assert!(said(10).contains("frames: 10 "));
    let short = Job {
        length: Some(Length::Frames(3)),
        ..job()
    };
    let said = short.make(&[walk(40)]).unwrap_err().to_string();
    assert!(said.contains("`length` is 3"), "{said}");
    assert!(job().make(&[]).is_err());
}
