//! From full-body captures to training clips: `data prepare` with `[[capture]]`.

use std::fs;

use kinegrad_capture::Bvh;
use kinegrad_motion::humanml::walk::{self, Course};
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_tests::sandbox::{SMALLEST_WALKS, Sandbox};

const PLAN: &str = "output = \"set\"\n\
    [split]\nfraction = 0.2\n\
    [captions]\ntemplates = [\"a person {content} {style}\"]\n\
    words.content = { walk = \"walks\" }\nwords.style = { slow = \"slowly\" }\n\
    [[capture]]\nmotion = \"captures/*.bvh\"\nlabels.name = \"{content}_{style}_{take}\"\n";

/// Walks as BVH files with the joint names of kinegrad's skeleton, and their plan.
fn with_captures() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST_WALKS);
    sandbox.write("plan.toml", PLAN);
    fs::create_dir(sandbox.path("captures")).expect("a folder");
    for (take, frames) in [(1, 61), (2, 71), (3, 250), (4, 61), (5, 66), (6, 30)] {
        let name = format!("captures/walk_slow_{take:03}.bvh");
        sandbox.write(&name, walking(frames, 0.8 + 0.05 * f64::from(take)));
    }
    sandbox
}

fn walking(frames: usize, speed: f64) -> String {
    let skeleton = Skeleton::humanml3d();
    let course = Course {
        speed: Box::new(move |_| speed),
        turning: Box::new(|_| 0.0),
    };
    let joints = walk::joints(&course, &skeleton, frames);
    let joints = Joints::new(joints, skeleton.joints()).expect("whole frames");
    let bvh = Bvh::from_joints(&joints, &skeleton, 100.0).expect("a figure");
    bvh.to_text()
}

#[test]
fn captures_become_clips_that_train() {
    let sandbox = with_captures();
    let prepared = sandbox.run("data prepare plan.toml").succeeded();
    // 249 frames are two clips; each clip has its mirror image.
    for text in [
        "12 (",
        "train 10, val 2",
        "humanml3d 5",
        "walk_slow_006: 29 frames (1.45 s) left over; a clip has at least 40",
        "0 of 6",
    ] {
        assert!(
            prepared.stdout.contains(text),
            "no `{text}` in {}",
            prepared.stdout
        );
    }
    let again = sandbox.run("data prepare plan.toml --json").succeeded();
    let report: serde_json::Value = serde_json::from_str(&again.stdout).expect("JSON");
    assert_eq!((&report["kept"], &report["clips"]), (&6.into(), &12.into()));
    let inspected = sandbox.run("data inspect set").succeeded();
    // The take of 249 frames is cut in two.
    for text in ["HumanML3D", "10, 2", "60 to 125"] {
        assert!(
            inspected.stdout.contains(text),
            "no `{text}` in {}",
            inspected.stdout
        );
    }
    let captions = fs::read_to_string(sandbox.path("set/texts/walk_slow_001_00000.txt"));
    assert!(
        captions
            .expect("captions")
            .starts_with("a person walks slowly#")
    );
    sandbox
        .run(
            "train c.toml --name trained --set data.kind=humanml3d --set data.source=set \
             --set data.humanml3d.text_embeddings= --set train.max_steps=2 \
             --set sampling.count_at_end=0",
        )
        .succeeded();
}

#[test]
fn bodies_that_are_none_are_named_and_plans_make_one_kind() {
    let sandbox = with_captures();
    let crab = walking(61, 1.0).replace("left_knee", "claw");
    sandbox.write("captures/walk_slow_007.bvh", &crab);
    let prepared = sandbox.run("data prepare plan.toml");
    assert_eq!(prepared.code, Some(1), "{}", prepared.stderr);
    assert!(
        prepared.stdout.contains("left_knee (left_knee)"),
        "{}",
        prepared.stdout
    );
    let alone = PLAN
        .replace("*.bvh", "walk_slow_007.bvh")
        .replace("\"set\"", "\"other\"");
    sandbox.write("alone.toml", &alone);
    sandbox.run("data prepare alone.toml").failed(
        2,
        &["no take gave a clip", "left_knee (left_knee)", "hint:"],
    );
    assert!(!sandbox.path("other").exists());
    sandbox.write("mixed.toml", format!("{PLAN}[phrases]\nframes = 60\n"));
    sandbox
        .run("data prepare mixed.toml")
        .failed(2, &["`phrases` is for phrases", "two plans"]);
    sandbox.write("plan.toml", PLAN.replace("motion =", "motions ="));
    sandbox
        .run("data prepare plan.toml")
        .failed(2, &["unknown key `capture[0].motions`", "did you mean"]);
}
