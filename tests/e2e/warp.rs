//! Motions moved onto paths: files and refusals.

use std::fs;

use kinegrad_data::{read_array, write_values};
use kinegrad_motion::humanml::{Features, Joints, Root, Skeleton};
use kinegrad_motion::metrics::BodyQuality;
use kinegrad_tests::sandbox::Sandbox;
use serde_json::Value;

/// A walk of the synthetic dataset as joints, 48 frames and more.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox
        .run("data synth --walks --phrases 4 --frames 60 --out walks")
        .succeeded();
    let clips = fs::read_dir(sandbox.path("walks/new_joint_vecs")).expect("clips");
    let mut clips: Vec<_> = clips.map(|entry| entry.expect("an entry").path()).collect();
    clips.sort();
    fs::copy(&clips[0], sandbox.path("walk.features.npy")).expect("copied");
    sandbox.write(
        "line.toml",
        "points = [[1, 1], [3.4, 4.2]]\ncurve = 'line'\n",
    );
    sandbox.write("corner.csv", "x,z\n0,0\n0,1.5\n2,1.5\n");
    sandbox.write(
        "circle.svg",
        "<svg xmlns='http://www.w3.org/2000/svg'><path d='M0 0 A 100 100 0 1 1 0 -200'/></svg>",
    );
    sandbox
}

fn frames(sandbox: &Sandbox, name: &str) -> Vec<Vec<[f32; 3]>> {
    let array = read_array(&sandbox.path(name)).expect("joints");
    assert_eq!(array.shape[1..], [22, 3]);
    let (places, _) = array.values.as_chunks::<3>();
    places.chunks(22).map(<[_]>::to_vec).collect()
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f32>().sqrt()
}

/// Two motions of two joints, as the programs of MDM save them.
const RESULTS: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../data/src/npy/results/protocol4.npy"
);

/// Ends of some bones: thighs, shins, spine, upper arms.
const BONES: [[usize; 2]; 6] = [[1, 4], [4, 7], [2, 5], [5, 8], [0, 3], [16, 18]];

/// Joints of the skeleton and their names in Mixamo's captures.
const MIXAMO: [(&str, &str); 22] = [
    ("pelvis", "Hips"),
    ("left_hip", "LeftUpLeg"),
    ("right_hip", "RightUpLeg"),
    ("spine1", "Spine"),
    ("left_knee", "LeftLeg"),
    ("right_knee", "RightLeg"),
    ("spine2", "Spine1"),
    ("left_ankle", "LeftFoot"),
    ("right_ankle", "RightFoot"),
    ("spine3", "Spine2"),
    ("left_foot", "LeftToeBase"),
    ("right_foot", "RightToeBase"),
    ("neck", "Neck"),
    ("left_collar", "LeftShoulder"),
    ("right_collar", "RightShoulder"),
    ("head", "Head"),
    ("left_shoulder", "LeftArm"),
    ("right_shoulder", "RightArm"),
    ("left_elbow", "LeftForeArm"),
    ("right_elbow", "RightForeArm"),
    ("left_wrist", "LeftHand"),
    ("right_wrist", "RightHand"),
];

#[test]
fn a_walk_follows_paths_of_every_kind() {
    let sandbox = sandbox();
    let warp = |arguments: &str| sandbox.run(&format!("warp {arguments}")).succeeded();
    let said = warp("walk.features.npy --path line.toml --out line");
    let last = said.stderr.lines().last();
    assert_eq!(last, Some("to play: kinegrad view line.npy"));
    let walked = frames(&sandbox, "line.npy");
    let (first, last) = (walked[0][0], walked[walked.len() - 1][0]);
    assert!((first[0] - 1.0).abs() < 1e-4 && (first[2] - 1.0).abs() < 1e-4);
    assert!((last[0] - 3.4).abs() < 1e-4 && (last[2] - 4.2).abs() < 1e-4);
    for frame in &walked {
        // On the line z = 1 + 4/3 (x - 1).
        let [x, _, z] = frame[0];
        assert!((z - 1.0 - 4.0 / 3.0 * (x - 1.0)).abs() < 1e-4);
        for [a, b] in BONES {
            let change = distance(frame[a], frame[b]) - distance(walked[0][a], walked[0][b]);
            assert!(change.abs() < 1e-5, "{a} to {b}: {change}");
        }
    }
    for name in ["line.features.npy", "line.bvh", "line.json"] {
        assert!(sandbox.path(name).is_file(), "{name}");
    }
    // Results are motions too: features above, positions here.
    warp("walk.features.npy --path corner.csv --out whole --lock-feet --along own");
    sandbox
        .run("check whole.features.npy whole.npy")
        .succeeded();
    warp("line.npy --path corner.csv --out corner --lock-feet --heading face --along own");
    let corner = frames(&sandbox, "corner.npy");
    assert!(corner.len() <= walked.len());
    for frame in &corner {
        let [x, _, z] = frame[0];
        assert!(x.abs() < 1e-4 || (z - 1.5).abs() < 1e-4, "{x} {z}");
    }
    let record = fs::read_to_string(sandbox.path("corner.json")).expect("a record");
    let record: Value = serde_json::from_str(&record).expect("JSON");
    assert!((record["speed_ratio"].as_f64().expect("a number") - 1.0).abs() < 1e-6);
    assert_eq!(record["warp"]["turning"], "face");
    assert!(
        record["after"]["largest_distance"]
            .as_f64()
            .expect("metres")
            < 1e-4
    );
    // A capture, here with the names of Mixamo.
    let capture = fs::read_to_string(sandbox.path("line.bvh")).expect("a capture");
    let capture = MIXAMO.iter().fold(capture, |text, (own, other)| {
        text.replace(&format!(" {own}\n"), &format!(" mixamorig7:{other}\n"))
    });
    sandbox.write("capture.bvh", capture);
    warp("capture.bvh --path line.toml --out captured");
    let captured = frames(&sandbox, "captured.npy");
    assert_eq!(captured.len(), walked.len());
    for (a, b) in captured.iter().zip(&walked) {
        for (a, b) in a.iter().zip(b) {
            assert!(distance(*a, *b) < 0.03, "{a:?} {b:?}");
        }
    }
    sandbox.write("crab.bvh", "HIERARCHY\nROOT Claw\n{ OFFSET 0 0 0\nCHANNELS 1 Xposition\n}\nMOTION\nFrames: 2\nFrame Time: 0.1\n0\n1\n");
    sandbox
        .run("warp crab.bvh --path line.toml --out claw")
        .failed(
            2,
            &[
                "crab.bvh: no built-in joint map fits",
                "kinegrad data prepare",
            ],
        );
    // A drawing: half a circle of a metre, ending two metres further up.
    warp("walk.features.npy --path circle.svg --metres-per-unit 0.01 --out circle");
    let circle = frames(&sandbox, "circle.npy");
    let last = circle[circle.len() - 1][0];
    assert!(
        last[0].abs() < 1e-2 && (last[2] - 2.0).abs() < 1e-2,
        "{last:?}"
    );
}

/// Joint positions of a walk's features, metres.
fn source(sandbox: &Sandbox) -> Joints {
    let rows = read_array(&sandbox.path("walk.features.npy")).expect("features");
    let layout = Skeleton::humanml3d().layout();
    let features = Features::new(rows.values, layout, Root::Relative).expect("features");
    features.joints()
}

/// Joint positions of a file, metres.
fn joints(sandbox: &Sandbox, name: &str) -> Joints {
    let places = frames(sandbox, name).concat().into_iter();
    let places = places.map(|place| place.map(f64::from));
    Joints::new(places.collect(), 22).expect("joints")
}

#[test]
fn locked_feet_stay_on_the_floor_and_catch_up_in_their_own_time() {
    let sandbox = sandbox();
    let skeleton = Skeleton::humanml3d();
    let before = source(&sandbox);
    let track = before.track(0);
    let steps = track
        .windows(2)
        .map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][2] - pair[0][2]));
    let walked: f64 = steps.sum();
    let own = BodyQuality::of(&before, &skeleton, 0.0);
    for ratio in [0.75, 1.0, 1.3, 1.45] {
        let path = format!(
            "points = [[0, 0], [0, {}]]\ncurve = 'line'\n",
            ratio * walked
        );
        sandbox.write("way.toml", path);
        let line = "warp walk.features.npy --path way.toml --lock-feet --out locked --overwrite";
        sandbox.run(line).succeeded();
        let moved = joints(&sandbox, "locked.npy");
        // No foot is lifted, which heights alone show.
        for t in 0..moved.frames() {
            let lowest = |joints: &Joints| {
                let heights = joints.frame(t).iter().map(|place| place[1]);
                heights.fold(f64::INFINITY, f64::min)
            };
            let raised = lowest(&moved) - lowest(&before);
            assert!(raised < 0.005, "{ratio}, frame {t}: {raised}");
        }
        let found = BodyQuality::of(&moved, &skeleton, 0.0);
        assert!(
            ratio > 1.4 || found.foot_skating.unwrap() < own.foot_skating.unwrap() + 0.1,
            "{ratio}: {found:?}"
        );
        let factor = if ratio < 1.1 { 1.3 } else { 2.5 };
        assert!(
            found.jerk_99.unwrap() < factor * own.jerk_99.unwrap(),
            "{ratio}: {found:?} {own:?}"
        );
        let record = fs::read_to_string(sandbox.path("locked.json")).expect("a record");
        let record: Value = serde_json::from_str(&record).expect("JSON");
        let number = |value: &Value| value.as_f64().expect("a number");
        assert!((number(&record["after"]["floating"]) - found.floating.unwrap()).abs() < 0.02);
        assert!((number(&record["after"]["travelled"]) / (ratio * walked) - 1.0).abs() < 0.02);
    }
    sandbox.write(
        "far.toml",
        format!("points = [[0, 0], [0, {}]]\n", 2.0 * walked),
    );
    let expected = format!(
        "the path is {:.2} m long and the motion walks {walked:.2} m",
        2.0 * walked
    );
    let line = "warp walk.features.npy --path far.toml --lock-feet --out far";
    sandbox.run(line).failed(2, &[&expected, "--along own"]);
    sandbox.run(&format!("{line} --along own")).succeeded();
    // Nothing stretches a body that stands.
    let still = before.frame(0).repeat(30);
    let still: Vec<f32> = still
        .into_iter()
        .flatten()
        .map(|value| value as f32)
        .collect();
    write_values(&sandbox.path("still.npy"), &[30, 22, 3], &still).expect("written");
    let line = "warp still.npy --path line.toml --out statue";
    sandbox.run(line).failed(2, &["walks 0.00 m"]);
}

#[test]
fn motion_idles_at_the_end_of_a_short_path_and_obeys_its_speed() {
    let sandbox = sandbox();
    sandbox.write(
        "short.toml",
        "points = [[0, 0], [0, 0.6]]\ncurve = 'line'\n",
    );
    sandbox.write(
        "slow.toml",
        "points = [[0, 0], [0, 9]]\ncurve = 'line'\nspeed = 0.5\n",
    );
    let count = source(&sandbox).frames();
    let end = |name: &str| {
        let all = frames(&sandbox, name);
        assert_eq!(all.len(), count, "{name}");
        all[count - 1][0][2]
    };
    let line = "warp walk.features.npy --path short.toml --along own --out idle";
    let said = sandbox.run(line).succeeded();
    assert!(
        said.stderr.contains("0.60 m, and stands there from frame"),
        "{}",
        said.stderr
    );
    assert!((end("idle.npy") - 0.6).abs() < 0.01);
    let all = frames(&sandbox, "idle.npy");
    let apart = all[count - 10].iter().zip(&all[count - 1]);
    assert!(apart.map(|(a, b)| distance(*a, *b)).fold(0.0, f32::max) < 1e-6);
    // Most of that motion stands; one that stands at its end alone is plausible.
    sandbox.write("near.toml", "points = [[0, 0], [0, 2.2]]\ncurve = 'line'\n");
    let line = "warp walk.features.npy --path near.toml --along own --lock-feet --out near";
    sandbox.run(line).succeeded();
    sandbox.run("check near.npy near.features.npy").succeeded();
    let line = "warp walk.features.npy --path slow.toml --out slow";
    sandbox.run(line).succeeded();
    let seconds = (count - 1) as f32 / 20.0;
    assert!((end("slow.npy") / (0.5 * seconds) - 1.0).abs() < 1e-3);
    sandbox.write(
        "fast.toml",
        "points = [[0, 0], [0, 9]]\ncurve = 'line'\nspeed = 9\n",
    );
    let line = "warp walk.features.npy --path fast.toml --out fast";
    sandbox
        .run(line)
        .failed(2, &["`speed` is 9.00 m/s", "set `speed` to at most"]);
    let said = sandbox.run(&format!("{line} --along own")).succeeded();
    assert!(
        said.stderr.contains("`speed` is ignored"),
        "{}",
        said.stderr
    );
}

#[test]
fn joints_with_the_frames_last_are_read() {
    let sandbox = sandbox();
    sandbox
        .run("warp walk.features.npy --path line.toml --out there")
        .succeeded();
    let walked = frames(&sandbox, "there.npy");
    let mut last = Vec::new();
    for joint in 0..22 {
        for axis in 0..3 {
            last.extend(walked.iter().map(|frame| frame[joint][axis]));
        }
    }
    let both = [vec![0.5; last.len()], last.clone()].concat();
    let count = walked.len();
    write_values(&sandbox.path("last.npy"), &[22, 3, count], &last).expect("written");
    write_values(&sandbox.path("both.npy"), &[2, 22, 3, count], &both).expect("written");
    for (file, out) in [
        ("there.npy", "a"),
        ("last.npy", "b"),
        ("both.npy --index 1", "c"),
    ] {
        sandbox
            .run(&format!(
                "warp {file} --path corner.csv --along own --out {out}"
            ))
            .succeeded();
        assert_eq!(
            frames(&sandbox, &format!("{out}.npy")),
            frames(&sandbox, "a.npy")
        );
    }
    fs::copy(RESULTS, sandbox.path("results.npy")).expect("copied");
    let said = sandbox.run("view results.npy --out page.html").succeeded();
    assert!(said.stderr.contains("has 2 motions"), "{}", said.stderr);
}

#[test]
fn what_cannot_be_warped_is_refused_and_nothing_is_written() {
    let sandbox = sandbox();
    sandbox.write("one.toml", "points = [[0, 0]]\n");
    sandbox.write("nan.toml", "points = [[0, 0], [nan, 1]]\n");
    write_values(&sandbox.path("phrase.npy"), &[9, 25], &[0.1; 9 * 25]).expect("written");
    write_values(&sandbox.path("single.npy"), &[1, 22, 3], &[0.1; 66]).expect("written");
    let mut pickled = b"\x93NUMPY\x01\x00".to_vec();
    let header = "{'descr': '|O', 'fortran_order': False, 'shape': (), }\n";
    pickled.extend((header.len() as u16).to_le_bytes());
    pickled.extend(header.as_bytes());
    pickled.extend([0x80, 4, 0x95]);
    sandbox.write("cut.npy", pickled);
    fs::copy(RESULTS, sandbox.path("results.npy")).expect("copied");
    for (arguments, expected) in [
        (
            "walk.features.npy --path one.toml",
            "one.toml: a path has 1 points",
        ),
        (
            "walk.features.npy --path nan.toml",
            "nan.toml:1: `points[1][0]`",
        ),
        ("walk.features.npy --path nowhere.toml", "nowhere.toml"),
        ("walk.features.npy --path circle.svg", "--metres-per-unit"),
        ("cut.npy --path line.toml", "its pickle is cut off"),
        ("results.npy --path line.toml", "[5, 2, 3]"),
        (
            "results.npy --index 2 --path line.toml",
            "`--index 2`, and results.npy has 2 motions",
        ),
        (
            "walk.features.npy --index 1 --path line.toml",
            "walk.features.npy has one motion",
        ),
        ("single.npy --path line.toml", "single frame"),
        ("phrase.npy --path line.toml", "has no body"),
    ] {
        let line = format!("warp {arguments} --out no");
        sandbox.run(&line).failed(2, &[expected]);
    }
    let line = "warp walk.features.npy --path line.toml --out yes";
    sandbox.run(line).succeeded();
    sandbox
        .run(line)
        .failed(2, &["exists already", "--overwrite"]);
    sandbox.run(&format!("{line} --overwrite")).succeeded();
    let line = "warp yes.npy --path line.toml --out yes --overwrite";
    sandbox.run(line).failed(2, &["is read itself"]);
    let left = sandbox.list(".");
    assert!(!left.iter().any(|name| name.starts_with("no.")), "{left:?}");
}

#[test]
fn a_motion_far_out_of_bounds_is_named_unusable() {
    let sandbox = sandbox();
    let line = "warp walk.features.npy --path line.toml --out line";
    sandbox.run(line).succeeded();
    // A wrist that jumps.
    let mut places = frames(&sandbox, "line.npy");
    for frame in &mut places[20..] {
        frame[20][1] += 3.0;
    }
    let values: Vec<f32> = places.concat().into_iter().flatten().collect();
    write_values(&sandbox.path("jump.npy"), &[places.len(), 22, 3], &values).expect("written");
    let line = "warp jump.npy --path line.toml --out far";
    let said = sandbox.run(line).failed(
        1,
        &[
            "warning: the moved motion is out of bounds: fastest_joint: ",
            "in frame 20, joint left_wrist",
            "this motion is not usable",
            "1 motion is not usable, named `.unusable`",
            "`--allow-unusable` gives it its usual name",
            "to play: kinegrad view far.unusable.npy",
        ],
    );
    let names = [".npy", ".features.npy", ".bvh", ".json"];
    let names = names.map(|ending| format!("far.unusable{ending}"));
    assert_eq!(said.stdout, names.join("\n") + "\n");
    for name in &names {
        assert!(sandbox.path(name).is_file(), "{name}");
    }
    assert!(!sandbox.path("far.npy").exists());
    // They are not replaced either.
    sandbox
        .run(line)
        .failed(2, &["far.unusable.npy exists already", "--overwrite"]);
    let allowed = "warp jump.npy --path line.toml --out anyway --allow-unusable --json";
    let record = sandbox.run(allowed).succeeded().stdout;
    let record: Value = serde_json::from_str(&record).expect("JSON");
    assert_eq!(record["body"]["far"], true);
    assert!(sandbox.path("anyway.npy").is_file());
}
