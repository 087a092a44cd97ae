//! New motion from examples of different skeletons, and of several figures.

use std::fs;

use kinegrad_capture::Bvh;
use kinegrad_tests::sandbox::Sandbox;
use serde_json::Value;

use crate::matching::walk;

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("walk.bvh", walk(200));
    sandbox
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).expect("JSON")
}

#[test]
fn examples_of_different_skeletons_are_matched_on_their_common_joints() {
    let sandbox = sandbox();
    // Other names.
    let other = walk(160)
        .replace("Hips", "pelvis")
        .replace("RightFoot", "foot_r");
    sandbox.write("other.bvh", other);
    sandbox.write(
        "map.toml",
        "[joints]\nHips = \"pelvis\"\nRightFoot = [\"foot_r\"]\nRightArm = []\n",
    );
    let line = "match walk.bvh other.bvh --out new.bvh --length 150";
    sandbox.run(line).failed(
        2,
        &["`pelvis`, `foot_r`", "`Hips`, `RightFoot`", "`--joint-map`"],
    );
    let said = sandbox
        .run(&format!("{line} --joint-map map.toml"))
        .succeeded();
    assert!(
        said.stderr
            .contains("matched on 8 joints, without 1 of other.bvh, 1 of walk.bvh"),
        "{}",
        said.stderr
    );
    let record = json(&fs::read_to_string(sandbox.path("new.json")).expect("a record"));
    assert_eq!(
        record["common_joints"]["left_out"]["walk.bvh"],
        serde_json::json!(["RightArm"])
    );
    let bytes = fs::read(sandbox.path("new.bvh")).expect("written");
    let new = Bvh::parse(&bytes, "new.bvh").expect("BVH");
    assert_eq!((new.joints().len(), new.frames()), (8, 150));
    assert!(new.joint("RightFoot").is_some() && new.joint("RightArm").is_none());
    for (map, texts) in [
        (
            "[joints]\nTail = \"pelvis\"\n",
            ["walk.bvh has no joint `Tail`", ""],
        ),
        (
            "[joints]\nHips = \"hip\"\n",
            ["no other file has a joint `hip`", ""],
        ),
        ("[joint]\n", ["bad.toml", "joint"]),
        ("[joints]\nHips = 3\n", ["bad.toml", "joints"]),
    ] {
        sandbox.write("bad.toml", map);
        let line = line.replace("new.bvh", "bad.bvh");
        sandbox
            .run(&format!("{line} --joint-map bad.toml"))
            .failed(2, &texts);
    }
}

#[test]
fn two_figures_are_matched_together_and_shown() {
    let sandbox = sandbox();
    let one = Bvh::parse(walk(200).as_bytes(), "walk.bvh").expect("BVH");
    let locals: Vec<_> = (0..200)
        .flat_map(|t| {
            let mut pose = one.locals(t);
            pose[0].position[0] += 100.0;
            pose
        })
        .collect();
    let two = one.reposed(one.frame_time(), &locals).expect("finite");
    sandbox.write("pair.bvh", Bvh::figures_to_text(&[one, two]));
    let said = sandbox.run("match pair.bvh --out new.bvh --length 180 --json --seed 1");
    let record = json(&said.succeeded().stdout);
    assert_eq!(record["frames"], 180);
    let bytes = fs::read(sandbox.path("new.bvh")).expect("written");
    let figures = Bvh::parse_figures(&bytes, "new.bvh").expect("two figures");
    assert_eq!(figures.len(), 2);
    for t in 0..180 {
        let [a, b] = [0, 1].map(|k: usize| figures[k].world(t)[0].position);
        assert!((b[0] - a[0] - 100.0).abs() < 10.0, "{a:?} {b:?}");
        assert!((b[2] - a[2]).abs() < 10.0, "{a:?} {b:?}");
    }
    sandbox
        .run("view new.bvh --out new.html --glb new.glb --bvh metres.bvh")
        .succeeded();
    let page = fs::read_to_string(sandbox.path("new.html")).expect("a page");
    assert!(page.contains("\"name\":\"new 1\"") && page.contains("\"name\":\"new 2\""));
    let bytes = fs::read(sandbox.path("metres.bvh")).expect("written");
    assert_eq!(
        Bvh::parse_figures(&bytes, "metres.bvh").expect("BVH").len(),
        2
    );
    for (line, texts) in [
        (
            "match walk.bvh pair.bvh --out x.bvh",
            ["pair.bvh has 2 figures", "walk.bvh 1"],
        ),
        (
            "match pair.bvh walk.bvh --out x.bvh",
            ["walk.bvh has 1 figure", "pair.bvh 2"],
        ),
        (
            "match pair.bvh --content walk.bvh --out x.bvh",
            ["walk.bvh has 1 figure", "pair.bvh 2"],
        ),
        ("check pair.bvh", ["pair.bvh", "a second ROOT"]),
    ] {
        sandbox.run(line).failed(2, &texts);
    }
}
