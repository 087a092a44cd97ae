//! Motions as matrices, and back.

use std::fmt::Write;

use kinegrad_motion::Quaternion;

use super::skeleton::root_joint;
use super::*;

/// The BVH text of hips and two legs below a fixed root, `frames` frames.
pub(crate) fn text(frames: usize, frame_time: f64) -> String {
    let mut text = "HIERARCHY\nROOT Root\n{\nOFFSET 0 0 0\n\
        CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
        JOINT Hips\n{\nOFFSET 0 90 0\n\
        CHANNELS 6 Xposition Yposition Zposition Yrotation Xrotation Zrotation\n"
        .to_string();
    for side in ["Left", "Right"] {
        let x = if side == "Left" { 9 } else { -9 };
        write!(
            text,
            "JOINT {side}Leg\n{{\nOFFSET {x} -5 0\nCHANNELS 3 Xrotation Yrotation Zrotation\n\
             JOINT {side}Foot\n{{\nOFFSET 0 -42.5 0\nCHANNELS 3 Zrotation Yrotation Xrotation\n\
             End Site\n{{\nOFFSET 0 -40 12\n}}\n}}\n}}\n"
        )
        .unwrap();
    }
    write!(
        text,
        "}}\n}}\nMOTION\nFrames: {frames}\nFrame Time: {frame_time}\n"
    )
    .unwrap();
    for t in 0..frames {
        let seconds = t as f64 * frame_time;
        let swing = |phase: f64| 30.0 * (5.0 * seconds + phase).sin();
        let (x, y) = (20.0 * seconds, 90.0 + 2.0 * (9.0 * seconds).cos());
        write!(
            text,
            "0 0 0 0 0 0 {x} {y} {} {} 0 3",
            80.0 * seconds,
            swing(1.0) / 3.0
        )
        .unwrap();
        for phase in [0.0, 3.1] {
            write!(text, " {} 0 0 0 0 {}", swing(phase), swing(phase + 0.7)).unwrap();
        }
        text.push('\n');
    }
    text
}

pub(crate) fn example(file: &str, frames: usize, frame_time: f64) -> Example {
    let bvh = Bvh::parse(text(frames, frame_time).as_bytes(), file).unwrap();
    Example {
        file: file.to_string(),
        bvh,
    }
}

fn layout(examples: &[Example]) -> MotionMatrix {
    MotionMatrix::new(examples, MatrixOptions::default()).unwrap()
}

#[test]
fn prefixes_of_joint_names_may_differ() {
    let renamed = |file: &str, prefix: &str| {
        let text = text(20, 1.0 / 30.0).replace("JOINT ", &format!("JOINT {prefix}"));
        let bvh = Bvh::parse(text.as_bytes(), file).unwrap();
        Example {
            file: file.to_string(),
            bvh,
        }
    };
    let files = [
        renamed("a.bvh", "mixamorig:"),
        renamed("b.bvh", "mixamorig7:"),
        renamed("c.bvh", ""),
    ];
    let layout = layout(&files);
    for file in &files {
        assert_eq!(layout.to_frames(file).unwrap().frames(), 20);
    }
}

#[test]
fn a_motion_comes_back_as_it_was() {
    let walk = example("walk.bvh", 60, 1.0 / 30.0);
    let layout = layout(std::slice::from_ref(&walk));
    assert_eq!(layout.joints()[layout.root_joint].name, "Hips");
    let frames = layout.to_frames(&walk).unwrap();
    assert_eq!((frames.frames(), frames.channels()), (60, 6 * 6 + 3));
    let back = layout.to_bvh(&frames).unwrap();
    assert_eq!(back.joints(), walk.bvh.joints());
    for t in 0..60 {
        for (found, value) in back.frame(t).iter().zip(walk.bvh.frame(t)) {
            assert!((found - value).abs() < 2e-3, "{t}: {found} {value}");
        }
    }
    // Frame 0 has the displacement of frame 1, and the height is absolute.
    let root = layout.root_channels();
    let first = &frames.frame(0)[root.clone()];
    assert_eq!(first[0], frames.frame(1)[root.start]);
    assert!((f64::from(first[1]) * 43.0 - 92.0).abs() < 1e-4);
}

#[test]
fn a_motion_seen_from_its_heading_comes_back_and_turns_do_not_matter() {
    let walk = example("walk.bvh", 60, 1.0 / 30.0);
    let by_heading = MatrixOptions {
        heading: true,
        ..MatrixOptions::default()
    };
    let of = |walk: &Example| {
        let layout = MotionMatrix::new(std::slice::from_ref(walk), by_heading.clone()).unwrap();
        let frames = layout.to_frames(walk).unwrap();
        (layout, frames)
    };
    // The same walk in another direction, with more than half a turn on the root.
    let mut turned = walk.clone();
    let mut locals: Vec<RootPose> = (0..60).flat_map(|t| walk.bvh.locals(t)).collect();
    let turn = Quaternion::from_yaw(2.0);
    for pose in locals.iter_mut().skip(1).step_by(6) {
        pose.position = turn.rotate(pose.position);
        pose.orientation = turn * pose.orientation;
    }
    turned.bvh = walk.bvh.reposed(1.0 / 30.0, &locals).unwrap();
    let ((layout, frames), (other, others)) = (of(&walk), of(&turned));
    assert_eq!(frames.channels(), 6 * 6 + 4);
    assert_eq!(layout.root_channels().len(), 4);
    for (a, b) in frames.values().iter().zip(others.values()) {
        assert!((a - b).abs() < 1e-4, "{a} {b}");
    }
    for (layout, frames, walk) in [(layout, frames, walk), (other, others, turned)] {
        let back = layout.to_bvh(&frames).unwrap();
        for t in 0..60 {
            for (found, pose) in back.world(t).iter().zip(walk.bvh.world(t)) {
                let apart = [0, 1, 2].map(|axis| found.position[axis] - pose.position[axis]);
                assert!(length(apart) < 0.01, "{t}: {apart:?}");
            }
        }
    }
}

#[test]
fn the_axis_that_points_up_keeps_its_place() {
    let walk = example("walk.bvh", 40, 1.0 / 30.0);
    let options = MatrixOptions {
        up: UpAxis::Z,
        ..MatrixOptions::default()
    };
    let layout = MotionMatrix::new(std::slice::from_ref(&walk), options).unwrap();
    assert_eq!(layout.height(), layout.channels() - 1);
    let frames = layout.to_frames(&walk).unwrap();
    let height = |t: usize| f64::from(frames.frame(t)[layout.height()]) * 43.0;
    assert!((height(30) - 80.0).abs() < 1e-3 && height(0).abs() < 1e-3);
    assert_eq!(layout.top_view([1.0, 2.0, 3.0]), (1.0, -2.0));
    let path = layout.path(&frames);
    assert_eq!(path.len(), 40);
    for (t, found) in path.iter().enumerate() {
        let place = walk.bvh.locals(t)[1].position;
        let apart = [0, 1, 2].map(|axis| found[axis] - place[axis]);
        assert!(length(apart) < 1e-2, "{t}: {apart:?}");
    }
}

#[test]
fn fast_captures_are_thinned_to_30_frames_a_second() {
    for (rate, every) in [(240.0, 8), (120.0, 4), (60.0, 2), (30.0, 1), (25.0, 1)] {
        let walk = example("walk.bvh", 97, 1.0 / rate);
        let layout = layout(std::slice::from_ref(&walk));
        let frames = layout.to_frames(&walk).unwrap().frames();
        assert_eq!(frames, 97usize.div_ceil(every), "{rate}");
        assert!((layout.frame_time() - every as f64 / rate).abs() < 1e-12);
    }
}

#[test]
fn motion_of_the_node_above_the_hips_is_theirs() {
    let walk = example("walk.bvh", 60, 1.0 / 30.0);
    let mut taken = walk.clone();
    let mut locals: Vec<RootPose> = (0..60).flat_map(|t| walk.bvh.locals(t)).collect();
    for pose in locals.chunks_exact_mut(6) {
        // The root is where the hips were; both turn.
        let turn = Quaternion::from_yaw(0.4);
        pose[0].position = pose[1].position;
        pose[0].orientation = turn;
        pose[1].position = [0.0; 3];
        pose[1].orientation = turn.conjugate() * pose[1].orientation;
    }
    taken.bvh = walk.bvh.reposed(1.0 / 30.0, &locals).unwrap();
    let layout = layout(&[walk.clone(), taken.clone()]);
    assert_eq!(layout.channels(), 6 * 6 + 3);
    let (own, other) = (
        layout.to_frames(&walk).unwrap(),
        layout.to_frames(&taken).unwrap(),
    );
    for (a, b) in own.values().iter().zip(other.values()) {
        assert!((a - b).abs() < 1e-4, "{a} {b}");
    }
}

#[test]
fn joints_whose_place_changes_keep_it() {
    let changed = text(20, 1.0 / 30.0).replace(
        "OFFSET -9 -5 0\nCHANNELS 3 ",
        "OFFSET -9 -5 0\nCHANNELS 6 Xposition Yposition Zposition ",
    );
    let changed: String = changed
        .lines()
        .enumerate()
        .map(|(index, line)| match line.split(' ').collect::<Vec<_>>() {
            words if words.len() == 24 => {
                let (before, behind) = words.split_at(18);
                let y = if index % 2 == 0 { "-5.25" } else { "-5" };
                format!("{} -9 {y} 0 {}\n", before.join(" "), behind.join(" "))
            }
            _ => format!("{line}\n"),
        })
        .collect();
    let walk = Example {
        file: "walk.bvh".to_string(),
        bvh: Bvh::parse(changed.as_bytes(), "walk.bvh").unwrap(),
    };
    let layout = layout(std::slice::from_ref(&walk));
    assert_eq!(layout.channels_of(4).len(), 9);
    assert_eq!(layout.channels_of(1).len(), 6);
    let back = layout.to_bvh(&layout.to_frames(&walk).unwrap()).unwrap();
    for t in 0..20 {
        let (found, place) = (back.locals(t)[4].position, walk.bvh.locals(t)[4].position);
        assert!((found[1] - place[1]).abs() < 1e-4, "{found:?} {place:?}");
    }
}

#[test]
fn feet_that_rest_are_in_contact() {
    let mut walk = example("walk.bvh", 40, 1.0 / 30.0);
    let with_contacts = MatrixOptions {
        contacts: vec![3, 5],
        ..MatrixOptions::default()
    };
    let layout = MotionMatrix::new(std::slice::from_ref(&walk), with_contacts).unwrap();
    let frames = layout.to_frames(&walk).unwrap();
    let channels = layout.channels_of(3);
    assert_eq!(channels.len(), 12);
    let contact = channels[6];
    assert_eq!(frames.frame(0)[contact], 0.0);
    // A layout that stands still.
    let still = walk.bvh.locals(7).repeat(12);
    walk.bvh = walk.bvh.reposed(1.0 / 30.0, &still).unwrap();
    let frames = layout.to_frames(&walk).unwrap();
    let rests: Vec<f32> = (0..12).map(|t| frames.frame(t)[contact]).collect();
    assert_eq!(rests[0], 0.0);
    assert!(rests[1..].iter().all(|&rest| rest == 1.0));
    assert!((0..12).all(|t| frames.frame(t)[contact + 1] == 0.0));
}

#[test]
fn other_skeletons_and_rates_are_named() {
    let walk = example("walk.bvh", 20, 1.0 / 30.0);
    let refused = |text: String| {
        let bvh = Bvh::parse(text.as_bytes(), "other.bvh").unwrap();
        let other = Example {
            file: "other.bvh".to_string(),
            bvh,
        };
        let examples = [walk.clone(), other];
        let error = MotionMatrix::new(&examples, MatrixOptions::default()).unwrap_err();
        error.to_string()
    };
    let message = refused(text(20, 1.0 / 30.0).replace("RightLeg", "RightKnee"));
    assert_eq!(
        message,
        "other.bvh: joint 5 is `RightKnee` below `Hips`, in walk.bvh `RightLeg` below `Hips`"
    );
    let message = refused(text(20, 1.0 / 25.0));
    assert_eq!(
        message,
        "other.bvh: 25.0000 frames a second, in walk.bvh 30.0000"
    );
    let flat: String = text(20, 1.0 / 30.0)
        .lines()
        .map(|line| match line.starts_with("OFFSET") {
            true => "OFFSET 0 0 0\n".to_string(),
            false => format!("{line}\n"),
        })
        .collect();
    let bvh = Bvh::parse(flat.as_bytes(), "flat.bvh").unwrap();
    let flat = Example {
        file: "flat.bvh".to_string(),
        bvh,
    };
    let error = MotionMatrix::new(&[flat], MatrixOptions::default()).unwrap_err();
    assert!(error.to_string().contains("every bone has the length 0"));
}

#[test]
fn a_sliding_limb_does_not_carry_the_body() {
    let bvh = example("walk.bvh", 20, 0.04).bvh;
    assert_eq!(root_joint(&bvh, &[0.0, 5.0, 9.0, 0.0, 9.0, 0.0]), 1);
    assert_eq!(root_joint(&bvh, &[0.0, 0.0, 9.0, 0.0, 0.0, 0.0]), 0);
    // Most of the body hangs on the second joint of five, but not all.
    let text = "HIERARCHY\nROOT Hips\n{\nOFFSET 0 1 0\nCHANNELS 0\nJOINT Spine\n{\nOFFSET 0 1 0\n\
        CHANNELS 3 Xposition Yposition Zposition\nJOINT Neck\n{\nOFFSET 0 1 0\nCHANNELS 0\n\
        JOINT Head\n{\nOFFSET 0 1 0\nCHANNELS 0\nEnd Site\n{\nOFFSET 0 1 0\n}\n}\n}\n}\nJOINT Tail\n{\nOFFSET 0 0 -1\nCHANNELS 0\n\
        End Site\n{\nOFFSET 0 0 -1\n}\n}\n}\nMOTION\nFrames: 1\nFrame Time: 0.03\n0 1 0\n";
    let bvh = Bvh::parse(text.as_bytes(), "sways.bvh").unwrap();
    assert_eq!(root_joint(&bvh, &[0.0, 0.4, 0.0, 0.0, 0.0]), 0);
}

#[test]
fn the_arc_of_headings_wraps() {
    let walk = example("walk.bvh", 60, 1.0 / 30.0);
    let of = |heading: bool, facing: &dyn Fn(f64) -> f64| {
        let options = MatrixOptions {
            heading,
            ..MatrixOptions::default()
        };
        let layout = MotionMatrix::new(std::slice::from_ref(&walk), options).unwrap();
        let mut frames = layout.to_frames(&walk).unwrap();
        let six = layout.rotation_of(layout.root_joint);
        for t in 0..60 {
            let turned = Quaternion::from_yaw(facing(t as f64 / 59.0));
            let values = rotation6d::from_quaternion(turned).map(|value| value as f32);
            frames.frame_mut(t)[six.clone()].copy_from_slice(&values);
        }
        layout.heading_arc(&[frames])
    };
    let near = |found: Option<f64>, expected: f64| (found.unwrap() - expected).abs() < 1e-3;
    assert!(near(of(false, &|part| 0.5 + part), 1.0));
    assert!(near(of(false, &|part| 2.9 + 0.6 * part), 0.6));
    assert!(near(of(false, &|part| -0.3 + 0.6 * part), 0.6));
    let circle = std::f64::consts::TAU * 59.0 / 60.0;
    assert!(near(of(false, &|part| circle * part), circle));
    assert_eq!(of(true, &|part| part), None);
}
