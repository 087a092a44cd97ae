//! A folder of motions that are broken on purpose: `check` fails each by name, against captured
//! people. Phrases, joint positions, joint features and BVH files.

use std::f64::consts::PI;
use std::fs;

use kinegrad_capture::Bvh;
use kinegrad_data::{motion_path, read_motion, synthetic, write_motion, write_values};
use kinegrad_motion::humanml::walk::{Course, joints, joints_at};
use kinegrad_motion::humanml::{Extraction, Joints, Skeleton};
use kinegrad_motion::phrase::{PHASE, POSITION};
use kinegrad_motion::{Phrase, Quaternion, derive};
use kinegrad_tests::sandbox::Sandbox;
use serde_json::Value;

const FRAMES: usize = 80;

fn sandbox() -> Sandbox {
    Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"))
}

/// Checks the folder `broken` with `options`: each file fails the check of its name, up to a `.`.
/// The file `good` passes.
fn must_fail_by_name(sandbox: &Sandbox, options: &str, all: usize) {
    let said = sandbox.run(&format!("check broken --json {options}"));
    let said: Value = serde_json::from_str(&said.failed(1, &[]).stdout).expect("JSON");
    assert_eq!(said["files"].as_array().expect("files").len(), all);
    for file in said["files"].as_array().expect("files") {
        let path = file["path"].as_str().expect("a path");
        let checks = file["checks"].as_array().expect("checks").iter();
        let failed = checks.filter(|check| check["passed"] == false);
        let failed: Vec<&str> = failed
            .map(|check| check["name"].as_str().expect("a name"))
            .collect();
        match path.trim_start_matches("broken/").split('.').next() {
            Some("good") => assert!(failed.is_empty(), "{path}: {failed:?}"),
            Some(name) => assert!(failed.contains(&name), "{path}: {failed:?}"),
            None => unreachable!("a name"),
        }
    }
}

/// A walk in a wide arc, `[frames, 22]`.
fn walk() -> Vec<[[f64; 3]; 22]> {
    let course = Course {
        speed: Box::new(|_| 1.1),
        turning: Box::new(|time| 0.4 * (0.7 * time).sin()),
    };
    let places = joints(&course, &Skeleton::humanml3d(), FRAMES);
    let (frames, _) = places.as_chunks::<22>();
    frames.to_vec()
}

/// The walk after a change of each frame.
fn changed(change: impl Fn(usize, &mut [[f64; 3]; 22])) -> Vec<[[f64; 3]; 22]> {
    let mut walk = walk();
    let each = walk.iter_mut().enumerate();
    each.for_each(|(t, frame)| change(t, frame));
    walk
}

fn moved(by: impl Fn(usize) -> [f64; 3]) -> Vec<[[f64; 3]; 22]> {
    changed(|t, frame| {
        for place in frame {
            *place = [0, 1, 2].map(|axis| place[axis] + by(t)[axis]);
        }
    })
}

/// Turns a frame about its root's vertical axis by an angle in radians.
fn turn(frame: &mut [[f64; 3]; 22], angle: f64) {
    let ([x, _, z], (sin, cos)) = (frame[0], angle.sin_cos());
    for place in frame {
        let (ahead, aside) = (place[2] - z, place[0] - x);
        (place[0], place[2]) = (x + cos * aside + sin * ahead, z + cos * ahead - sin * aside);
    }
}

/// A straight walk whose feet land faster than they lift: time runs fastest at the end of each step.
fn landing_walk() -> Vec<[[f64; 3]; 22]> {
    let course = Course {
        speed: Box::new(|_| 1.1),
        turning: Box::new(|_| 0.0),
    };
    let rate = 4.0 * PI * 0.935;
    let times: Vec<f64> = (0..FRAMES)
        .map(|t| t as f64 / 20.0)
        .map(|time| time + 0.5 * (rate * time + 4.77).sin() / rate)
        .collect();
    let places = joints_at(&course, &Skeleton::humanml3d(), 5.0, &times);
    let (frames, _) = places.as_chunks::<22>();
    frames.to_vec()
}

/// Broken walks, each under the name of the check that fails.
fn broken_bodies() -> Vec<(&'static str, Vec<[[f64; 3]; 22]>)> {
    let statue = walk()[30];
    vec![
        ("good", walk()),
        ("good.landing", landing_walk()),
        (
            "time_direction.in_reverse",
            landing_walk().into_iter().rev().collect(),
        ),
        (
            "statue.sways",
            changed(|t, frame| {
                let by = 0.05 * (0.2 * t as f64).sin();
                *frame = statue.map(|[x, y, z]| [x + by, y, z]);
            }),
        ),
        ("floating", moved(|_| [0.0, 0.4, 0.0])),
        ("floating.high", moved(|_| [0.0, 1.0, 0.0])),
        ("floor", moved(|_| [0.0, -0.2, 0.0])),
        ("floor.pelvis_at_0.1_m", moved(|_| [0.0, -0.8, 0.0])),
        ("floor.deep", moved(|_| [0.0, -1.5, 0.0])),
        (
            "fastest_root",
            moved(|t| [if t < 40 { 0.0 } else { 3.0 }, 0.0, 0.0]),
        ),
        (
            "fastest_joint",
            moved(|t| [0.0, 0.0, if t == 40 { 3.0 } else { 0.0 }]),
        ),
        (
            "root_acceleration.teleport_of_30_cm",
            moved(|t| [if t < 40 { 0.0 } else { 0.3 }, 0.0, 0.0]),
        ),
        (
            "turn_acceleration.60_degrees_in_a_frame",
            changed(|t, frame| {
                if t >= 40 {
                    turn(frame, PI / 3.0);
                }
            }),
        ),
        (
            "flight.half_the_time",
            moved(|t| {
                [
                    0.0,
                    (0.05 * t as f64).clamp(0.0, 2.0) * f64::from(u8::from(t < 38)),
                    0.0,
                ]
            }),
        ),
        ("still_share", changed(|_, frame| *frame = statue)),
        (
            "glide",
            changed(|t, frame| {
                *frame = statue.map(|[x, y, z]| [x, y, z + 0.06 * t as f64]);
            }),
        ),
        (
            "largest_turn",
            changed(|t, frame| {
                if t == 40 {
                    turn(frame, PI);
                }
            }),
        ),
        ("jerk", moved(|t| [0.0, 0.06 * (t % 2) as f64, 0.0])),
    ]
}

fn as_joints(frames: &[[[f64; 3]; 22]]) -> Joints {
    Joints::new(frames.as_flattened().to_vec(), 22).expect("finite")
}

#[test]
fn broken_bodies_fail_by_name() {
    let sandbox = sandbox();
    fs::create_dir(sandbox.path("broken")).expect("a folder");
    let skeleton = Skeleton::humanml3d();
    let scaled = |factor: f64| {
        changed(move |_, frame| {
            *frame = frame.map(|place| place.map(|value| factor * value));
        })
    };
    let of_arrays = [
        ("units.cm", scaled(100.0)),
        ("units.mm", scaled(1000.0)),
        (
            "up_axis",
            changed(|_, frame| *frame = frame.map(|[x, y, z]| [x, -z, y])),
        ),
    ];
    let mut all = broken_bodies();
    all.extend(of_arrays);
    for (name, frames) in &all {
        let path = sandbox.path(format!("broken/{name}.npy"));
        write_values(&path, &[FRAMES, 22, 3], &as_joints(frames).to_f32()).expect("npy");
    }
    // Features say how each joint moves: in reverse order they contradict the positions.
    let features = Extraction::default()
        .features(&skeleton, &as_joints(&walk()))
        .expect("features")
        .into_vec();
    let reversed: Vec<f32> = features.rchunks_exact(263).flatten().copied().collect();
    let changed = |channels: std::ops::Range<usize>, change: fn(f32) -> f32| {
        let mut rows = features.clone();
        for row in rows.chunks_exact_mut(263) {
            row[channels.clone()]
                .iter_mut()
                .for_each(|value| *value = change(*value));
        }
        rows
    };
    let layout = skeleton.layout();
    let no_rotations = changed(layout.rotations(), |_| 0.0);
    let inverted = changed(layout.contacts(), |contact| 1.0 - contact);
    let of_features = [
        ("good.walk", &features),
        ("velocity_coherence.in_reverse", &reversed),
        ("rotation_columns.zeros", &no_rotations),
        ("contacts.inverted", &inverted),
    ];
    for (name, rows) in of_features {
        let path = sandbox.path(format!("broken/{name}.npy"));
        write_values(&path, &[rows.len() / 263, 263], rows).expect("npy");
    }
    must_fail_by_name(&sandbox, "", all.len() + of_features.len());
}

#[test]
fn broken_bvh_files_fail_by_name() {
    let sandbox = sandbox();
    fs::create_dir(sandbox.path("broken")).expect("a folder");
    let skeleton = Skeleton::humanml3d();
    let all = broken_bodies();
    for (name, frames) in &all {
        let bvh = Bvh::from_joints(&as_joints(frames), &skeleton, 100.0).expect("a body");
        sandbox.write(&format!("broken/{name}.bvh"), bvh.to_text());
    }
    must_fail_by_name(&sandbox, "", all.len());
    for (line, failure) in [
        ("check broken/good.bvh --units m", "FAIL leg_length: "),
        ("check broken/good.bvh --up z", "FAIL up_axis: "),
        ("check broken/largest_turn.bvh", "FAIL largest_turn: "),
        (
            "check broken/fastest_root.bvh",
            " m/s in frame 40, joint pelvis",
        ),
    ] {
        let said = sandbox.run(line).failed(1, &[]);
        assert!(said.stdout.contains(failure), "{line}: {}", said.stdout);
    }
    let said = sandbox.run("check broken/good.bvh --profile ccmotion");
    said.failed(2, &["ccmotion", "hint:"]);
}

#[test]
fn a_bvh_file_of_another_skeleton_is_checked_by_what_is_measurable() {
    let sandbox = sandbox();
    fs::create_dir(sandbox.path("broken")).expect("a folder");
    let header = "HIERARCHY\nROOT Body\n{\n OFFSET 0 0 0\n CHANNELS 6 Xposition Yposition \
        Zposition Zrotation Xrotation Yrotation\n JOINT Tail\n {\n  OFFSET 0 10 -40\n  CHANNELS 3 \
        Zrotation Xrotation Yrotation\n  End Site\n  {\n   OFFSET 0 0 -5\n  }\n }\n JOINT Foot\n \
        {\n  OFFSET 0 -50 0\n  CHANNELS 3 Zrotation Xrotation Yrotation\n  End Site\n  {\n   \
        OFFSET 0 0 5\n  }\n }\n}\nMOTION\nFrames: 90\nFrame Time: 0.0333333\n";
    // x, y, z and heading of the body; the angle of the tail.
    let write = |name: &str, pose: &dyn Fn(usize) -> [f64; 5]| {
        let frames = (0..90).map(|t| {
            let [x, y, z, heading, tail] = pose(t);
            format!("{x} {y} {z} 0 0 {heading} 0 0 {tail} 0 0 0\n")
        });
        let text = header.to_owned() + &frames.collect::<String>();
        sandbox.write(&format!("broken/{name}.bvh"), text);
    };
    let tail = |t: usize| 30.0 * (0.3 * t as f64).sin();
    let along = |t: usize| 0.5 * t as f64;
    write("good", &|t| [0.0, 52.0, along(t), 0.0, tail(t)]);
    write("floating", &|t| [0.0, 152.0, along(t), 0.0, tail(t)]);
    write("floor", &|t| [0.0, 12.0, along(t), 0.0, tail(t)]);
    write("still_share", &|_| [0.0, 52.0, 0.0, 0.0, 0.0]);
    write("fastest_root", &|t| {
        let jump = if t < 40 { 0.0 } else { 300.0 };
        [jump, 52.0, along(t), 0.0, tail(t)]
    });
    write("largest_turn", &|t| {
        let heading = if t == 40 { 180.0 } else { 0.0 };
        [0.0, 52.0, along(t), heading, tail(t)]
    });
    must_fail_by_name(&sandbox, "--units cm --up y", 6);
    let said = sandbox.run("check broken/good.bvh");
    assert!(said.stderr.contains("without the joints of HumanML3D"));
}

/// The phrase with other poses and consistent channels.
fn posed(
    motion: &Phrase,
    pose: impl Fn(usize, [f64; 3], Quaternion) -> ([f64; 3], Quaternion),
) -> Phrase {
    let of = |t| pose(t, motion.vector(t, POSITION), motion.quaternion(t));
    let (positions, quaternions): (Vec<_>, Vec<_>) = (0..motion.frames()).map(of).unzip();
    let style = vec![[0.0; 8]; motion.frames()];
    derive(&positions, &quaternions, &motion.column(PHASE), &style).expect("a phrase")
}

#[test]
fn broken_phrases_fail_by_name() {
    let sandbox = sandbox();
    sandbox
        .run("data synth --out set --phrases 12 --frames 120 --seed 4")
        .succeeded();
    // Captured dancers are the reference of all of them.
    let said = sandbox.run("check set/motion").succeeded();
    assert!(said.stdout.contains("12 of 12 pass"), "{}", said.stdout);
    fs::create_dir(sandbox.path("broken")).expect("a folder");
    let path = sandbox.path(format!("set/{}", motion_path(&synthetic::id(3))));
    let good = read_motion(&path).expect("a phrase");
    let (place, heading) = (good.vector(0, POSITION), good.quaternion(0));
    let quarter = Quaternion::from_rotation_vector([PI / 2.0, 0.0, 0.0]);
    let half = Quaternion::from_yaw(PI);
    let held = |height: f64| posed(&good, move |_, [x, _, z], q| ([x, height, z], q));
    let raised = |by: f64| posed(&good, move |_, [x, y, z], q| ([x, y + by, z], q));
    let rows: Vec<f32> = good
        .as_slice()
        .rchunks_exact(25)
        .flatten()
        .copied()
        .collect();
    let all = [
        ("good", good.clone()),
        ("height.pelvis_at_0.1_m", held(0.1)),
        ("height.hovering", raised(1.0)),
        ("height.sunk", raised(-1.5)),
        (
            "height.cm",
            posed(&good, |_, p, q| (p.map(|value| 100.0 * value), q)),
        ),
        (
            "height.z_up",
            posed(&good, |_, [x, y, z], q| ([x, -z, y], quarter * q)),
        ),
        (
            "phase_direction.in_reverse",
            Phrase::new(rows).expect("rows"),
        ),
        (
            "fastest_step.teleport",
            posed(&good, |t, [x, y, z], q| {
                ([if t < 60 { x } else { x + 1.0 }, y, z], q)
            }),
        ),
        (
            "path_speed.statue",
            posed(&good, |_, _, _| (place, heading)),
        ),
        (
            "largest_turn.one_frame",
            posed(&good, |t, p, q| (p, if t == 60 { half * q } else { q })),
        ),
        (
            "largest_turn.every_frame",
            posed(&good, |t, p, q| (p, if t % 2 == 1 { half * q } else { q })),
        ),
        (
            "jerk.thousands",
            posed(&good, |t, [x, y, z], q| {
                ([x, y + 0.04 * (t % 2) as f64, z], q)
            }),
        ),
    ];
    for (name, motion) in &all {
        write_motion(&sandbox.path(format!("broken/{name}.npy")), motion).expect("npy");
    }
    must_fail_by_name(&sandbox, "", all.len());
}
