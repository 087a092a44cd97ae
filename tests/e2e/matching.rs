//! New motion from examples: files and refusals.

use std::fmt::Write;
use std::fs;

use kinegrad_data::{read_array, write_values};
use kinegrad_tests::sandbox::Sandbox;

/// Joints of a small body with their parents and offsets in centimetres.
const JOINTS: [(&str, Option<usize>, [i32; 3]); 9] = [
    ("Hips", None, [0, 95, 0]),
    ("LeftLeg", Some(0), [9, -5, 0]),
    ("LeftFoot", Some(1), [0, -80, 0]),
    ("RightLeg", Some(0), [-9, -5, 0]),
    ("RightFoot", Some(3), [0, -80, 0]),
    ("Spine", Some(0), [0, 45, 0]),
    ("Head", Some(5), [0, 20, 0]),
    ("LeftArm", Some(5), [18, 0, 0]),
    ("RightArm", Some(5), [-18, 0, 0]),
];

/// A walk as BVH, at 60 frames per second.
pub fn walk(frames: usize) -> String {
    let mut text = "HIERARCHY\n".to_string();
    let mut open: Vec<usize> = Vec::new();
    for (index, (name, parent, [x, y, z])) in JOINTS.iter().enumerate() {
        while open.last().copied() != *parent {
            text += "End Site\n{\nOFFSET 0 -60 5\n}\n}\n";
            open.pop();
            if open.last().copied() != *parent {
                text += "}\n";
                open.pop();
            }
        }
        let (kind, places) = match parent {
            None => ("ROOT", "6 Xposition Yposition Zposition "),
            Some(_) => ("JOINT", "3 "),
        };
        writeln!(text, "{kind} {name}\n{{\nOFFSET {x} {y} {z}").expect("text");
        writeln!(text, "CHANNELS {places}Zrotation Yrotation Xrotation").expect("text");
        open.push(index);
    }
    text += "End Site\n{\nOFFSET 0 -60 5\n}\n";
    text += &"}\n".repeat(open.len());
    writeln!(text, "MOTION\nFrames: {frames}\nFrame Time: 0.016667").expect("text");
    for t in 0..frames {
        let seconds = t as f64 / 60.0;
        write!(
            text,
            "{} 94.5 {}",
            4.0 * (2.1 * seconds).sin(),
            110.0 * seconds
        )
        .expect("text");
        for joint in 0..JOINTS.len() {
            let phase = if joint == 3 || joint == 7 { 3.1 } else { 0.0 };
            let swing = 25.0 * (5.0 * seconds + phase + 0.2 * joint as f64).sin();
            write!(
                text,
                " {} {} {swing}",
                0.2 * swing,
                3.0 * (1.3 * seconds).cos()
            )
            .expect("text");
        }
        text.push('\n');
    }
    text
}

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("dance.bvh", walk(300));
    sandbox
}

/// The lines of a BVH file above its frames, and the number of frames.
pub fn head(text: &str) -> (String, usize) {
    let (hierarchy, motion) = text.split_once("MOTION").expect("a motion");
    let mut lines = motion.trim().lines();
    let frames = lines.next().and_then(|line| line.strip_prefix("Frames: "));
    let frames: usize = frames
        .and_then(|n| n.parse().ok())
        .expect("a number of frames");
    assert_eq!(lines.count(), frames + 1);
    (
        hierarchy.split_whitespace().collect::<Vec<_>>().join(" "),
        frames,
    )
}

#[test]
fn a_motion_is_written_with_its_record_and_not_over_another() {
    let sandbox = sandbox();
    let said = sandbox
        .run("match dance.bvh --out new/one.bvh --svg new/one.svg")
        .succeeded();
    assert_eq!(said.stdout, "new/one.bvh\nnew/one.json\nnew/one.svg\n");
    assert!(said.stderr.contains("coverage"), "{}", said.stderr);
    let last = said.stderr.lines().last();
    assert_eq!(last, Some("to play: kinegrad view new/one.bvh"));
    let read = |name: &str| fs::read_to_string(sandbox.path(name)).expect("written");
    let (new, example) = (read("new/one.bvh"), walk(300));
    let ((hierarchy, frames), (of_example, _)) = (head(&new), head(&example));
    // Offsets are written with six decimals.
    assert_eq!(hierarchy.replace(".000000", ""), of_example);
    assert_eq!(frames, 300);
    assert!(new.contains("Frame Time: 0.033334"), "{new}");
    let record: serde_json::Value = serde_json::from_str(&read("new/one.json")).expect("JSON");
    assert_eq!(record["settings"]["patch_size"], 11);
    // A short example has a longer coarsest level than the default of 5 patches.
    assert_eq!(record["settings"]["coarse_ratio"], "2x");
    assert!(record["measures"]["coverage"].as_f64().expect("a number") > 0.5);
    assert!(read("new/one.svg").starts_with("<svg"));

    let again = sandbox.run("match dance.bvh --out new/one.bvh --seed 1");
    again.failed(2, &["new/one.bvh exists already", "`--overwrite`"]);
    assert_eq!(read("new/one.bvh"), new);
    sandbox
        .run("match dance.bvh --out new/one.bvh --seed 1 --overwrite")
        .succeeded();
    assert_ne!(read("new/one.bvh"), new);
    sandbox.run("match dance.bvh --out same.bvh").succeeded();
    assert_eq!(read("same.bvh"), new, "the same seed gives the same motion");
}

#[test]
fn lengths_examples_and_uses_of_all_kinds_work() {
    let sandbox = sandbox();
    sandbox.write("other.bvh", walk(170));
    sandbox.write(
        "parts.toml",
        "[[part]]\nname = 'upper'\nbelow = ['Spine']\n",
    );
    sandbox.write("k.toml", "[[keyframe]]\ntime = 2.0\nsource_time = 1.0\n");
    for (options, frames) in [
        ("dance.bvh other.bvh", 470),
        ("dance.bvh --length 120", 120),
        ("dance.bvh --length 2.5s", 75),
        ("dance.bvh --length 0.5x --loop", 75),
        ("dance.bvh --preset paper", 300),
        ("dance.bvh --parts parts.toml --heading", 300),
        (
            "dance.bvh --coherence 0.8 --patch-size 7 --num-steps 2",
            300,
        ),
        ("dance.bvh --alpha none --sigma 0 --coarse-ratio 0.3", 300),
        ("dance.bvh --keyframes k.toml", 300),
        ("dance.bvh --fix legs=other.bvh", 85),
        ("dance.bvh --content other.bvh", 85),
    ] {
        let run = sandbox.run(&format!("match {options} --out new.bvh --overwrite --json"));
        let record: serde_json::Value =
            serde_json::from_str(&run.succeeded().stdout).expect("JSON");
        assert_eq!(record["frames"], frames, "{options}");
        let text = fs::read_to_string(sandbox.path("new.bvh")).expect("written");
        assert_eq!(head(&text).1, frames, "{options}");
    }
}

/// Writes an array of single precision, `[frames, channels]`.
fn write_clip(
    sandbox: &Sandbox,
    name: &str,
    frames: usize,
    channels: usize,
    value: impl Fn(usize, usize) -> f32,
) {
    let pairs = (0..frames).flat_map(|t| (0..channels).map(move |channel| (t, channel)));
    let values: Vec<f32> = pairs.map(|(t, channel)| value(t, channel)).collect();
    write_values(&sandbox.path(name), &[frames, channels], &values).expect("an array");
}

#[test]
fn clips_of_joint_features_are_matched_and_written() {
    let sandbox = sandbox();
    let said = sandbox.run("data synth --walks --phrases 2 --frames 120 --seed 3 --out synth");
    said.succeeded();
    let walks = "synth/new_joint_vecs/walk_00000.npy synth/new_joint_vecs/walk_00001.npy";
    let run = sandbox.run(&format!("match {walks} --out new.npy --json"));
    let record: serde_json::Value = serde_json::from_str(&run.succeeded().stdout).expect("JSON");
    let examples = walks
        .split(' ')
        .map(|walk| read_array(&sandbox.path(walk)).expect("a clip"));
    let rows: Vec<usize> = examples.map(|clip| clip.shape[0]).collect();
    let frames = 2 * (rows[0] + rows[1]);
    assert_eq!(record["frames"], frames);
    assert_eq!(record["example_frames"], serde_json::json!(rows));
    let runs = record["parts"][0]["runs"].as_array().expect("runs");
    let sum: u64 = runs
        .iter()
        .map(|run| run[3].as_u64().expect("a number"))
        .sum();
    assert_eq!(sum, frames as u64);
    let new = read_array(&sandbox.path("new.npy")).expect("a clip");
    assert_eq!(new.shape, [frames, 263]);
    // It is plausible and coherent motion.
    sandbox.run("check new.npy").succeeded();
    // The BVH file differs by its decimals only.
    let options = "--overwrite --seed 0";
    sandbox
        .run(&format!("match {walks} --out new.bvh {options}"))
        .succeeded();
    assert_eq!(
        head(&fs::read_to_string(sandbox.path("new.bvh")).expect("written")).1,
        frames
    );
    sandbox.run("view new.npy --out new.html").succeeded();
    let page = fs::read_to_string(sandbox.path("new.html")).expect("written");
    assert!(
        page.contains("\"name\":\"walk_00001\""),
        "its origins are shown"
    );
}

#[test]
fn what_cannot_be_matched_is_refused_and_leaves_nothing() {
    let sandbox = sandbox();
    sandbox.write("one.bvh", walk(1));
    sandbox.write("short.bvh", walk(18));
    sandbox.write("other.bvh", walk(300).replace("RightFoot", "RightToe"));
    sandbox.write("nan.bvh", walk(300).replacen("94.5", "nan", 1));
    sandbox.write("cut.bvh", &walk(300)[..2000]);
    let flat: Vec<String> = walk(300)
        .lines()
        .map(|line| match line.starts_with("OFFSET") {
            true => "OFFSET 0 0 0".to_string(),
            false => line.to_string(),
        })
        .collect();
    sandbox.write("flat.bvh", flat.join("\n"));
    write_clip(&sandbox, "clip.npy", 40, 263, |_, _| 0.1);
    write_clip(&sandbox, "short.npy", 1, 263, |_, _| 0.1);
    write_clip(&sandbox, "phrase.npy", 40, 25, |_, _| 0.1);
    write_clip(&sandbox, "odd.npy", 40, 7, |_, _| 0.1);
    let gap = |t, channel| {
        if (t, channel) == (3, 30) {
            f32::NAN
        } else {
            0.1
        }
    };
    write_clip(&sandbox, "gap.npy", 40, 263, gap);
    sandbox.write("parts.toml", "[[part]]\nname = 'wing'\njoints = ['Wing']\n");
    sandbox.write(
        "late.toml",
        "[[keyframe]]\ntime = 90.0\nsource_time = 1.0\n",
    );
    sandbox.write(
        "from.toml",
        "[[keyframe]]\ntime = 1.0\nsource_time = 0.0\nfile = 'one.bvh'\n",
    );
    sandbox.write("from.svg", "[[part]]\nname = 'leg'\nbelow = ['LeftLeg']\n");
    sandbox.write("empty.toml", "keyframe = []\n");
    sandbox.write("nothing.toml", "part = []\n");
    let leg = "[[part]]\nname = 'leg'\nbelow = ['LeftLeg']\n";
    sandbox.write("twice.toml", leg.repeat(2));
    let before = sandbox.list(".");
    for (options, texts) in [
        ("none.bvh", &["none.bvh cannot be read"][..]),
        ("dance.c3d", &["dance.c3d is not a .bvh or .npy file"]),
        ("none.npy", &["none.npy"]),
        ("phrase.npy", &["phrase.npy", "has no body"]),
        ("odd.npy", &["odd.npy: an array of shape [40, 7]"]),
        ("gap.npy", &["gap.npy: a position is not finite"]),
        ("clip.npy short.npy", &["short.npy: frames: 1 at 20"]),
        (
            "dance.bvh clip.npy",
            &["clip.npy: the skeletons differ", "`pelvis`", "--joint-map"],
        ),
        (
            "dance.bvh --content one.bvh",
            &["one.bvh: frames: 1 at 30", "`patch_size`"],
        ),
        (
            "dance.bvh --content dance.bvh --length 3x",
            &["dance.bvh: has 150 frames, and `--length` 450"],
        ),
        (
            "dance.bvh --content dance.bvh --seed 1",
            &["--seed", "cannot be used with", "--content"],
        ),
        (
            "dance.bvh --content dance.bvh --sigma 1",
            &["--sigma", "cannot be used with", "--content"],
        ),
        ("dance.bvh --num-steps 0", &["`num_steps` is 0"]),
        (
            "dance.bvh --keyframes empty.toml",
            &["empty.toml: has no `[[keyframe]]`"],
        ),
        (
            "dance.bvh --parts nothing.toml",
            &["nothing.toml: has no `[[part]]`"],
        ),
        (
            "dance.bvh --parts twice.toml",
            &["twice.toml: two parts are called `leg`"],
        ),
        (
            "one.bvh",
            &["one.bvh: frames: 1 at 30", "`patch_size`, which is 11"],
        ),
        (
            "dance.bvh short.bvh",
            &["short.bvh: frames: 9 at 30", "`--patch-size`"],
        ),
        (
            "dance.bvh other.bvh",
            &[
                "other.bvh: the skeletons differ: 1 of its joints are not in dance.bvh (`RightToe`)",
                "(`RightFoot`)",
            ],
        ),
        ("nan.bvh", &["nan.bvh", "line", "`nan`", "a finite number"]),
        ("cut.bvh", &["cut.bvh", "line"]),
        ("flat.bvh", &["flat.bvh: every bone has the length 0"]),
        (
            "dance.bvh --patch-size 10",
            &["`patch_size` is 10", "an odd number from 3"],
        ),
        ("dance.bvh --alpha 0", &["`alpha` is 0"]),
        ("dance.bvh --coarse-ratio 0x", &["`coarse_ratio` is 0"]),
        ("dance.bvh --coherence 2", &["`coherence` is 2"]),
        ("dance.bvh --coherence 1 --alpha 1", &["--alpha"]),
        ("dance.bvh --length 3", &["`length` is 3"]),
        ("dance.bvh --length soon", &["times all examples, as 2x"]),
        (
            "dance.bvh --parts parts.toml",
            &["parts.toml: no joint is named `Wing`"],
        ),
        ("dance.bvh --parts none.toml", &["none.toml cannot be read"]),
        (
            "dance.bvh --keyframes late.toml",
            &["`time` is 90, allowed: 0 to 9.97"],
        ),
        (
            "dance.bvh --fix wings=dance.bvh",
            &["no part or joint `wings`"],
        ),
        (
            "dance.bvh --fix legs=one.bvh",
            &["one.bvh: frames: 1 at 30"],
        ),
        ("dance.bvh --fix legs", &["legs=walk.bvh"]),
        (
            "dance.bvh --loop --fix legs=dance.bvh",
            &["dance.bvh: `legs` follows it, whose end need not lead into its beginning"],
        ),
    ] {
        sandbox
            .run(&format!("match {options} --out new.bvh"))
            .failed(2, texts);
    }
    for (out, texts) in [
        ("new.glb", &["does not end in .bvh or .npy"][..]),
        (
            "new.npy",
            &["is a clip of joint features, but the example dance.bvh is not"],
        ),
        ("dance.bvh", &["dance.bvh is read itself"]),
        ("./dance.bvh --overwrite", &["./dance.bvh is read itself"]),
        (
            "one.bvh --overwrite --keyframes from.toml",
            &["one.bvh is read itself"],
        ),
        (
            "new.bvh --svg from.svg --parts from.svg --overwrite",
            &["from.svg is read itself"],
        ),
    ] {
        sandbox
            .run(&format!("match dance.bvh --out {out}"))
            .failed(2, texts);
    }
    assert_eq!(sandbox.list("."), before);
}

#[test]
fn a_motion_far_livelier_than_its_examples_is_named_unusable() {
    let sandbox = sandbox();
    // A hundred metres from one key frame to the next.
    let frame = |time: f64, place: f64| {
        format!("[[keyframe]]\ntime = {time}\nsource_time = 1.0\nplace = [{place}, 0.0]\n")
    };
    sandbox.write("far.toml", frame(4.0, 0.0) + &frame(4.2, 10000.0));
    let line = "match dance.bvh --keyframes far.toml --out new.bvh --svg new.svg";
    let said = sandbox.run(line).failed(
        1,
        &[
            "warning: fastest joint ",
            ", frame 12",
            "this motion is not usable",
            "1 motion is not usable, named `.unusable`",
            "to play: kinegrad view new.unusable.bvh",
        ],
    );
    let names = ["new.unusable.bvh", "new.unusable.json", "new.unusable.svg"];
    assert_eq!(said.stdout, names.join("\n") + "\n");
    assert!(!sandbox.path("new.bvh").exists() && !sandbox.path("new.svg").exists());
    sandbox
        .run(line)
        .failed(2, &["new.unusable.bvh exists already", "--overwrite"]);
    let allowed = "match dance.bvh --keyframes far.toml --out anyway.bvh --allow-unusable --json";
    let record = sandbox.run(allowed).succeeded().stdout;
    let record: serde_json::Value = serde_json::from_str(&record).expect("JSON");
    assert_eq!(record["far"], true);
    assert!(sandbox.path("anyway.bvh").is_file());
    let usual = sandbox.run("match dance.bvh --out usual.bvh --json");
    let record: serde_json::Value = serde_json::from_str(&usual.succeeded().stdout).expect("JSON");
    assert_eq!(record["far"], false);
}
