//! Pictures of every representation.

use std::fs;
use std::path::Path;

use kinegrad_data::write_values;

use crate::reports::{holds, sandbox};

/// Values of a small random walk.
fn wandering(count: usize) -> Vec<f32> {
    (0..count).map(|i| (i as f32 * 0.37).sin()).collect()
}

#[test]
fn every_representation_is_plotted() {
    let sandbox = sandbox();
    let write = |name: &str, shape: &[usize], values: Vec<f32>| {
        write_values(Path::new(&sandbox.path(name)), shape, &values).expect("written");
    };
    write("path.npy", &[20, 2], wandering(40));
    write("body.npy", &[20, 22, 3], wandering(20 * 66));
    sandbox
        .run("train w.toml --set sampling.count_at_end=1 --set train.max_steps=2")
        .succeeded();
    let samples = "runs/smallest/samples";
    let features = sandbox.list(samples);
    let features = features.iter().find(|name| name.ends_with(".features.npy"));
    let features = format!("{samples}/{}", features.expect("features"));
    sandbox.write(
        "goal.toml",
        "frames = 20\n[[keyframe]]\nframe = 7\nx = 1.0\nz = 2.0\n\
         [[obstacle]]\nkind = \"disc\"\nx = 3.0\nz = 0.0\nradius = 0.5\n\
         [[obstacle]]\nkind = \"polygon\"\nvertices = [[0.0, 4.0], [1.0, 4.0], [1.0, 5.0]]\n",
    );
    let plot = |arguments: &str| {
        let plot = format!("plot {arguments} --out p.svg --overwrite");
        sandbox.run(&plot).succeeded();
        fs::read_to_string(sandbox.path("p.svg")).expect("a picture")
    };
    let path = plot("path.npy");
    holds(
        &path,
        &["root path, top view", "position (m)", "speed on the ground"],
    );
    assert!(!path.contains("height (m)"));
    for body in ["body.npy", &features] {
        let picture = plot(&format!("{body} --goal goal.toml"));
        let texts = [
            "poses ",
            "root path, top view",
            "on the ground",
            "height (m)",
            "key frames",
            "frame 7",
            "obstacles",
            "<polygon",
        ];
        holds(&picture, &texts);
    }
    let pictured = "plot body.npy --goal goal.toml --out p.png";
    sandbox.run(pictured).succeeded();
    sandbox
        .run("plot runs/smallest --goal goal.toml --out q.svg")
        .failed(2, &["`--goal` with the folder runs/smallest"]);
    sandbox
        .run("plot body.npy --goal c.toml --out q.svg")
        .failed(2, &["c.toml", "goals.md"]);
    assert!(!sandbox.path("q.svg").exists());
}

#[test]
fn joints_of_any_skeleton_and_captures_are_plotted_and_not_checked() {
    let sandbox = sandbox();
    let plot = |arguments: &str| {
        let plot = format!("plot {arguments} --out p.svg --overwrite");
        let said = sandbox.run(&plot).succeeded().stderr;
        let picture = fs::read_to_string(sandbox.path("p.svg")).expect("a picture");
        (picture, said)
    };
    for (frames, joints) in [(1, 1), (20, 1), (1, 5), (20, 5), (12, 70)] {
        let values = wandering(frames * joints * 3);
        write_values(&sandbox.path("joints.npy"), &[frames, joints, 3], &values).expect("written");
        let (picture, _) = plot("joints.npy --fps 10");
        holds(&picture, &["root path, top view", "height (m)"]);
        assert!(!picture.contains("on the ground\n"), "no foot is known");
        assert_eq!(picture.contains("poses "), joints > 1, "{joints} joints");
        // A dot for each joint of each pose, in addition to the path's and those of lone points.
        let lone = 2 * usize::from(frames == 1);
        let dots = picture.matches("<circle").count() - 2 - lone;
        assert!(
            dots.is_multiple_of(joints) && (dots > 0) == (joints > 1),
            "{dots}"
        );
        let known = ["[T, 22, 3]", "[T, 21, 3]", "`kinegrad plot`"];
        let said = format!("{joints} joints of an unknown skeleton cannot be checked");
        let checked = sandbox.run("check joints.npy");
        checked.failed(2, &[&[said.as_str()][..], &known].concat());
    }
    sandbox
        .run("plot joints.npy --fps -2 --out q.svg")
        .failed(2, &["`--fps` is -2", "positive"]);
    let frames = (0..12).map(|t| format!("{t} 90 0 0 0 0 0 0 0\n"));
    let capture = "HIERARCHY\nROOT Hips\n{\n OFFSET 0 90 0\n CHANNELS 6 Xposition Yposition \
        Zposition Zrotation Xrotation Yrotation\n JOINT LeftFoot\n {\n  OFFSET 0 -85 0\n  \
        CHANNELS 3 Zrotation Xrotation Yrotation\n  End Site\n  {\n   OFFSET 0 0 5\n  }\n }\n}\n\
        MOTION\nFrames: 12\nFrame Time: 0.1\n";
    let capture = capture.to_string() + &frames.collect::<String>();
    sandbox.write("walk.bvh", capture);
    let (picture, said) = plot("walk.bvh");
    holds(
        &picture,
        &[
            "poses ",
            "root path, top view",
            "on the ground",
            "LeftFoot",
            "height (m)",
        ],
    );
    assert!(said.contains("--units"), "{said}");
    let (metres, said) = plot("walk.bvh --units m --up y");
    assert!(said.is_empty(), "{said}");
    assert!(metres.contains("poses "));
    let said = sandbox.run("check walk.bvh").succeeded();
    assert!(said.stdout.contains("fastest_joint"), "{}", said.stdout);
}

#[test]
fn schedules_of_configs_and_runs_are_plotted() {
    let sandbox = sandbox();
    let config = |name: &str, kind: &str| {
        let text = format!(
            "[run]\nname = \"{name}\"\n[train]\nrecipe = \"gmd_trajectory\"\n\
             [data]\nkind = \"synthetic_walks\"\n[diffusion]\nbeta_schedule = \"{kind}\"\n"
        );
        sandbox.write(&format!("{name}.toml"), text);
    };
    config("one", "cosine");
    config("two", "linear");
    config("three", "sqrt");
    let text = fs::read(sandbox.path("three.toml")).expect("a config");
    sandbox.write("runs/three/config.toml", text);
    let line = "plot --schedule one.toml two.toml runs/three --out schedule.svg";
    sandbox.run(line).succeeded();
    let picture = fs::read_to_string(sandbox.path("schedule.svg")).expect("a picture");
    for name in ["one", "two", "three"] {
        let titles = [
            format!("{name}: factors in x_t"),
            format!("{name}: share of the output in a step"),
        ];
        holds(&picture, &titles.each_ref().map(String::as_str));
    }
    holds(&picture, &["epsilon", "sample", "timestep"]);
    // Another schedule has other curves.
    let alone = |name: &str| {
        let line = format!("plot --schedule {name}.toml --out {name}.svg");
        sandbox.run(&line).succeeded();
        let picture = fs::read_to_string(sandbox.path(format!("{name}.svg"))).expect("a picture");
        picture.replace(&format!("{name}: "), "")
    };
    assert_ne!(alone("one"), alone("two"));
    sandbox.write(
        "flow.toml",
        "[train]\nrecipe = \"flow\"\n[data]\nkind = \"synthetic_walks\"\n",
    );
    sandbox
        .run("plot --schedule flow.toml --out flow.svg")
        .failed(2, &["flow.toml has no diffusion process"]);
    sandbox
        .run("plot --schedule body.npy --out q.svg")
        .failed(2, &["body.npy"]);
}
