//! Real-looking walks pass; motions that are broken on purpose fail by name.

use super::*;
use crate::humanml::walk::{Course, joints, joints_at};
use crate::humanml::{Extraction, Root};
use crate::representation::{JointFeatures, JointPositions, statistics_of};

const FRAMES: usize = 80;

type Frame<'a> = &'a mut [[f32; 3]];

fn representation() -> JointPositions {
    JointPositions {
        skeleton: Skeleton::humanml3d(),
    }
}

/// A walk in a wide arc at 1.1 m/s, `[frames, 22, 3]`.
fn walk() -> Vec<f32> {
    let course = Course {
        speed: Box::new(|_| 1.1),
        turning: Box::new(|time| 0.4 * (0.7 * time).sin()),
    };
    let places = joints(&course, &Skeleton::humanml3d(), FRAMES);
    places
        .as_flattened()
        .iter()
        .map(|value| *value as f32)
        .collect()
}

fn failed(report: Report) -> Vec<&'static str> {
    let failed = report.checks.into_iter().filter(|check| !check.passed);
    failed.map(|check| check.name).collect()
}

/// The checks that fail after `change` was applied to each frame of a walk, without statistics and
/// with those of the walk.
fn failing(change: impl Fn(usize, Frame<'_>)) -> [Vec<&'static str>; 2] {
    let (representation, good) = (representation(), walk());
    let training = statistics_of(&representation, [&good[..]]).expect("a clip");
    let mut rows = good;
    let (places, _) = rows.as_chunks_mut::<3>();
    for (t, frame) in places.chunks_exact_mut(22).enumerate() {
        change(t, frame);
    }
    [None, Some(&training)]
        .map(|training| failed(representation.check(&rows, Profile::Strict, training)))
}

/// The change fails the check of that name in both ways.
fn fails(name: &str, change: impl Fn(usize, Frame<'_>)) {
    for failing in failing(change) {
        assert!(failing.contains(&name), "{name}: {failing:?}");
    }
}

/// Moves all joints.
fn shift(frame: Frame<'_>, by: [f32; 3]) {
    for place in frame {
        (0..3).for_each(|axis| place[axis] += by[axis]);
    }
}

#[test]
fn a_walk_passes() {
    assert_eq!(failing(|_, _| ()), [Vec::<&str>::new(), Vec::new()]);
}

#[test]
fn broken_walks_fail_by_name() {
    fails("finite", |t, frame| {
        if t == 7 {
            frame[3][1] = f32::NAN;
        }
    });
    fails("bone_length", |t, frame| frame[20][0] += 0.004 * t as f32);
    fails("floating", |_, frame| shift(frame, [0.0, 0.5, 0.0]));
    fails("floor", |_, frame| shift(frame, [0.0, -0.3, 0.0]));
    fails("fastest_joint", |t, frame| {
        if t >= 40 {
            shift(frame, [4.0, 0.0, 0.0]);
        }
    });
    fails("fastest_root", |t, frame| {
        if t >= 40 {
            shift(frame, [4.0, 0.0, 0.0]);
        }
    });
    fails("largest_turn", |t, frame| {
        let root = frame[0];
        if t == 30 {
            for place in frame {
                place[0] = 2.0 * root[0] - place[0];
                place[2] = 2.0 * root[2] - place[2];
            }
        }
    });
    fails("jerk", |t, frame| {
        shift(frame, [0.0, 0.05 * (t % 2) as f32, 0.0])
    });
    fails("jerk_p99", |t, frame| frame[20][1] += 0.2 * (t % 2) as f32);
    for factor in [0.5, 2.0] {
        fails("leg_length", |_, frame| {
            (frame.as_flattened_mut().iter_mut()).for_each(|v| *v *= factor)
        });
    }
}

#[test]
fn walks_that_are_broken_a_little_fail_by_name() {
    fails("floating", |_, frame| shift(frame, [0.0, 0.16, 0.0]));
    fails("floor", |_, frame| shift(frame, [0.0, -0.08, 0.0]));
    // 2 m/s sideways.
    fails("skating", |t, frame| {
        shift(frame, [0.1 * t as f32, 0.0, 0.0])
    });
    let good = walk();
    fails("still_share", |t, frame| {
        let from = 66 * t.min(FRAMES / 2);
        (frame.as_flattened_mut()).copy_from_slice(&good[from..from + 66]);
    });
    fails("up_axis", |_, frame| {
        frame.iter_mut().for_each(|place| place[1] = 1.7 - place[1])
    });
}

#[test]
fn a_statue_fails() {
    let statue = walk()[..66].to_vec();
    let statue = |speed: f32| {
        let statue = statue.clone();
        move |t: usize, frame: Frame<'_>| {
            frame.as_flattened_mut().copy_from_slice(&statue);
            shift(frame, [0.0, 0.0, speed * t as f32 / 20.0]);
        }
    };
    fails("still_share", statue(0.0));
    fails("glide", statue(1.1));
    fails("skating", statue(1.1));
}

#[test]
fn a_statue_that_sways_or_is_carried_for_two_seconds_fails() {
    let statue = walk()[..66].to_vec();
    fails("statue", |t, frame| {
        frame.as_flattened_mut().copy_from_slice(&statue);
        shift(frame, [0.03 * (0.2 * t as f32).sin(), 0.0, 0.0]);
    });
    let good = walk();
    fails("statue", |t, frame| {
        if t < 41 {
            let (from, t) = (66 * 41, t as f32 - 41.0);
            (frame.as_flattened_mut()).copy_from_slice(&good[from..from + 66]);
            shift(frame, [0.0, 0.0, 0.02 * t]);
        }
    });
}

#[test]
fn a_walk_in_reverse_order_fails() {
    let (representation, skeleton) = (representation(), Skeleton::humanml3d());
    let course = Course {
        speed: Box::new(|_| 1.1),
        turning: Box::new(|_| 0.0),
    };
    // Time runs fastest at the end of each step, of which there are 1.87 in a second.
    let rate = 2.0 * std::f64::consts::TAU * 0.935;
    let times: Vec<f64> = (0..FRAMES)
        .map(|t| t as f64 / 20.0)
        .map(|time| time + 0.5 * (rate * time + 4.77).sin() / rate)
        .collect();
    let places = joints_at(&course, &skeleton, 5.0, &times);
    let places = places.as_flattened().iter();
    let rows: Vec<f32> = places.map(|value| *value as f32).collect();
    let training = statistics_of(&representation, [&rows[..]]).expect("a clip");
    let reversed: Vec<f32> = rows.rchunks_exact(66).flatten().copied().collect();
    for training in [None, Some(&training)] {
        let check = |rows| failed(representation.check(rows, Profile::Strict, training));
        assert_eq!(check(&rows), [""; 0]);
        assert_eq!(check(&reversed), ["time_direction"]);
    }
}

#[test]
fn other_units_and_axes_fail() {
    for unit in [100.0, 1000.0] {
        fails("units", |_, frame| {
            frame
                .as_flattened_mut()
                .iter_mut()
                .for_each(|value| *value *= unit);
        });
    }
    fails("up_axis", |_, frame| {
        frame.iter_mut().for_each(|place| place.swap(1, 2))
    });
    fails("up_axis", |_, frame| {
        frame.iter_mut().for_each(|place| place.swap(0, 1))
    });
    fails("up_axis", |_, frame| {
        (frame.iter_mut()).for_each(|place| *place = [place[0], place[2], -place[1]]);
    });
    // A body that lies on its back at the origin of the floor stands along no axis.
    let lying = failing(|_, frame| {
        frame.iter_mut().for_each(|place| place.swap(1, 2));
        let root = frame[0];
        shift(frame, [0.0, 0.1 - root[1], -root[2]]);
    });
    assert!(lying.iter().all(|failing| !failing.contains(&"up_axis")));
}

#[test]
fn the_features_of_reversed_frames_fail() {
    let skeleton = Skeleton::humanml3d();
    let joints = Joints::from_f32(&walk(), 22).expect("finite");
    let features = Extraction::default()
        .features(&skeleton, &joints)
        .expect("features");
    let representation = JointFeatures {
        skeleton,
        root: Root::Relative,
    };
    let rows = features.into_vec();
    let forward = failed(representation.check(&rows, Profile::Strict, None));
    assert!(forward.is_empty(), "{forward:?}");
    let reversed: Vec<f32> = rows.rchunks_exact(263).flatten().copied().collect();
    let reversed = failed(representation.check(&reversed, Profile::Strict, None));
    assert!(reversed.contains(&"velocity_coherence"), "{reversed:?}");
}

#[test]
fn extremes_name_frame_and_joint() {
    let representation = representation();
    let mut rows = walk();
    (31..FRAMES).for_each(|t| rows[(t * 22 + 20) * 3] += 2.0);
    let report = representation.check(&rows, Profile::Strict, None);
    let message = &report.check("fastest_joint").expect("a check").message;
    assert!(
        message.ends_with("in frame 31, joint left_wrist"),
        "{message}"
    );
}

#[test]
fn a_root_alone_has_speed_and_jerk() {
    let path = crate::representation::GroundPath { fps: 20.0 };
    let check = |step: f32| {
        let rows: Vec<f32> = (0..40).flat_map(|t| [step * t as f32, 0.0]).collect();
        failed(path.check(&rows, Profile::Strict, None))
    };
    assert!(check(0.06).is_empty());
    assert_eq!(check(1.5), ["fastest_root"]);
}

#[test]
fn a_jump_into_a_frame_has_its_largest_jerk_there() {
    let mut rows = walk();
    (31..FRAMES).for_each(|t| rows[(t * 22 + 20) * 3] += 2.0);
    let report = representation().check(&rows, Profile::Strict, None);
    let message = &report.check("largest_jerk").expect("a check").message;
    assert!(
        message.ends_with("in frame 31, joint left_wrist"),
        "{message}"
    );
    let joints = representation().joints(&rows).expect("finite");
    let skeleton = Skeleton::humanml3d();
    let far = BodyFinding::all(&joints, Some(&skeleton), 20.0, None);
    let far: Vec<&str> = far
        .iter()
        .filter(|finding| finding.is_far())
        .map(|finding| finding.measure.name())
        .collect();
    // 40 m/s is less than twice the bound.
    assert_eq!(far, ["largest_jerk"]);
}

#[test]
fn a_capture_is_checked_at_the_rate_of_its_file() {
    // Five frames for each of the reference rate, and a flip in one of those between.
    let course = Course {
        speed: Box::new(|_| 1.1),
        turning: Box::new(|_| 0.0),
    };
    let places = joints(&course, &Skeleton::humanml3d(), FRAMES);
    let coarse = Joints::new(places, 22).expect("finite");
    let frame = |t: usize| {
        let (from, part) = ((t / 5).min(FRAMES - 2), (t % 5) as f64 / 5.0);
        let pairs = coarse.frame(from).iter().zip(coarse.frame(from + 1));
        let between =
            pairs.map(|(a, b)| [0, 1, 2].map(|axis| a[axis] + part * (b[axis] - a[axis])));
        let mut places: Vec<[f64; 3]> = between.collect();
        if t == 202 {
            let [x, _, z] = places[0];
            for place in &mut places {
                (place[0], place[2]) = (2.0 * x - place[0], 2.0 * z - place[2]);
            }
        }
        places
    };
    let fine = Joints::new((0..5 * FRAMES - 9).flat_map(frame).collect(), 22).expect("finite");
    let skeleton = Skeleton::humanml3d();
    let names = &skeleton.description().joint_names;
    let checked = |skeleton, largest_turn| {
        let captured = crate::CapturedBody {
            joints: &fine,
            fps: 100.0,
            resampled: &coarse,
            resampled_fps: 20.0,
            joint_names: names,
            skeleton,
            largest_turn,
        };
        failed(crate::check_capture(&captured, None))
    };
    assert_eq!(
        checked(Some(&skeleton), None),
        ["fastest_joint", "largest_turn"]
    );
    // Without a skeleton, a turn that is measured elsewhere counts.
    assert_eq!(checked(None, None), ["fastest_joint"]);
    let turn = crate::BodyValue {
        value: 2000.0,
        frame: Some(202),
        joint: None,
    };
    assert_eq!(checked(None, Some(turn)), ["fastest_joint", "largest_turn"]);
}
