//! The files of a folder that are checked, and the detected kind of a folder.

use std::fs;

use kinegrad_data::write_values;
use kinegrad_tests::sandbox::Sandbox;

fn sandbox() -> Sandbox {
    Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"))
}

/// The files that a check of the folder `samples` names.
fn checked(sandbox: &Sandbox, options: &str) -> Vec<String> {
    let said = sandbox
        .run(&format!("check samples --json {options}"))
        .stdout;
    let said: serde_json::Value = serde_json::from_str(&said).expect("JSON");
    let files = said["files"].as_array().expect("files").iter();
    let path = |file: &serde_json::Value| file["path"].as_str().expect("a path").to_owned();
    files.map(path).collect()
}

#[test]
fn each_sample_of_a_folder_is_checked_once() {
    let sandbox = sandbox();
    fs::create_dir(sandbox.path("samples")).expect("a folder");
    for (name, channels) in [
        ("dance.npy", 25),
        ("dance.raw.npy", 25),
        ("only.raw.npy", 25),
        ("walk.features.npy", 263),
        ("walk.path.npy", 2),
        ("lone.features.npy", 263),
    ] {
        let values = vec![0.5; 40 * channels];
        write_values(
            &sandbox.path("samples").join(name),
            &[40, channels],
            &values,
        )
        .expect("npy");
    }
    let walk = vec![0.5; 40 * 22 * 3];
    write_values(&sandbox.path("samples/walk.npy"), &[40, 22, 3], &walk).expect("npy");
    let motions = ["dance.npy", "lone.features.npy", "only.raw.npy", "walk.npy"];
    let motions = motions.map(|name| format!("samples/{name}"));
    assert_eq!(checked(&sandbox, ""), motions);
    let with_raw = checked(&sandbox, "--raw");
    assert_eq!(with_raw.len(), 5);
    assert!(with_raw.contains(&"samples/dance.raw.npy".to_owned()));
    // A named file is checked.
    let named = sandbox.run("check samples/dance.raw.npy --json").stdout;
    assert!(named.contains("dance.raw.npy"), "{named}");
}

#[test]
fn the_bounds_of_the_five_checks_are_read_from_a_file() {
    let sandbox = sandbox();
    sandbox
        .run("data synth --out set --phrases 1 --frames 60")
        .succeeded();
    let check = "check set/motion --profile ccmotion";
    sandbox.run(check).succeeded();
    sandbox.write("strict.toml", "max_jerk = 0.5\n");
    let said = sandbox.run(&format!("{check} --thresholds strict.toml"));
    let said = said.failed(1, &[]);
    assert!(said.stdout.contains("FAIL jerk"), "{}", said.stdout);
    for (text, expected) in [
        ("max_jerks = 1", "unknown key `max_jerks`"),
        ("max_jerk = -1", "`max_jerk` is -1"),
        ("phase_min = 2", "`phase_min` is 2"),
    ] {
        sandbox.write("wrong.toml", text);
        let said = sandbox.run(&format!("{check} --thresholds wrong.toml"));
        said.failed(2, &["wrong.toml:1", expected]);
    }
    sandbox
        .run("check set/motion --thresholds strict.toml")
        .failed(2, &["--thresholds", "--profile"]);
    let walk = vec![0.5; 40 * 22 * 3];
    write_values(&sandbox.path("walk.npy"), &[40, 22, 3], &walk).expect("npy");
    sandbox
        .run("check walk.npy --profile ccmotion --thresholds strict.toml")
        .failed(2, &["is for phrases alone"]);
}

#[test]
fn inspect_finds_out_what_a_folder_holds() {
    let sandbox = sandbox();
    sandbox
        .run("data synth --out set --phrases 4 --frames 60")
        .succeeded();
    sandbox
        .run("data synth --out walks --walks --phrases 4 --frames 60")
        .succeeded();
    let said = |line: &str| sandbox.run(line).stdout;
    assert!(said("data inspect set").contains("phrases"));
    let walks = said("data inspect walks");
    assert!(
        walks.contains("HumanML3D layout, skeleton humanml3d"),
        "{walks}"
    );
    assert_eq!(said("data inspect walks --humanml3d"), walks);
    // KIT-ML has 251 features.
    for clip in fs::read_dir(sandbox.path("walks/new_joint_vecs"))
        .expect("clips")
        .flatten()
    {
        write_values(&clip.path(), &[60, 251], &vec![0.0; 60 * 251]).expect("npy");
    }
    for statistics in ["Mean.npy", "Std.npy"] {
        let _ = fs::remove_file(sandbox.path("walks").join(statistics));
    }
    let kit = said("data inspect walks");
    assert!(
        kit.contains("skeleton kit") && kit.contains("12.5 fps"),
        "{kit}"
    );
    sandbox
        .run("data inspect set --humanml3d")
        .failed(2, &["new_joint_vecs", "hint:"]);
}
