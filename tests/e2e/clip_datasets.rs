//! Datasets of clips on disk: their lists, texts and bad files.

use std::fs;
use std::path::Path;

use kinegrad_data::humanml::write_walks;
use kinegrad_data::write_values;
use kinegrad_tests::sandbox::{Sandbox, smallest_walks_on_disk};
use serde_json::Value;

use super::goals::sandbox;

#[test]
fn goals_are_taken_from_the_list_that_is_named() {
    let sandbox = dataset();
    sandbox
        .run("train c.toml --set train.max_steps=2")
        .succeeded();
    let held_out = fs::read_to_string(sandbox.path("walks/val.txt")).expect("a list");
    let evaluate = |settings: &str| {
        let eval = "eval runs/smallest --json --steps 2 --set evaluation.goals=3";
        sandbox.run(&format!("{eval} {settings}"))
    };
    let test = "--set evaluation.split=test";
    evaluate(test).failed(2, &["walks/test.txt", "test_list"]);
    // A training clip cannot be evaluated.
    fs::copy(
        sandbox.path("walks/train.txt"),
        sandbox.path("walks/test.txt"),
    )
    .expect("a copy");
    evaluate(test).failed(2, &["walks/test.txt", "train.txt"]);
    fs::write(sandbox.path("walks/test.txt"), &held_out).expect("written");
    let report = |settings: &str| -> Value {
        let said = evaluate(settings).succeeded().stdout;
        let report: Value = serde_json::from_str(&said).expect("JSON");
        report["evaluations"][0].clone()
    };
    let (test, validation) = (report(test), report(""));
    assert_eq!(test["sampled"], validation["sampled"], "the same clips");
    // Other keyframes, and another seed.
    let error = |report: &Value| {
        report["sampled"]["average_error"]
            .as_f64()
            .expect("an error")
    };
    let even = report("--set evaluation.keyframe_placement=even");
    let other = report("--seed 3");
    assert_ne!(error(&even), error(&validation));
    assert_ne!(error(&other), error(&validation));
    // Two replications equal two seeds.
    let both = report("--set evaluation.replications=2");
    let next = report("--seed 1");
    let mean = (error(&validation) + error(&next)) / 2.0;
    assert!((error(&both) - mean).abs() < 1e-12);
    let half = (error(&validation) - error(&next)).abs() / 2.0;
    let interval = both["sampled"]["interval"]["average_error"].as_f64();
    assert!((interval.expect("an interval") - 1.96 * half / 2f64.sqrt()).abs() < 1e-12);
    assert!(validation["sampled"]["interval"].is_null());
    // Without goals a clip does not depend on its batch.
    let free = "--set evaluation.keyframes=0";
    let together = report(free);
    let alone = report(&format!("{free} --set evaluation.batch_size=1"));
    assert_eq!(together["sampled"], alone["sampled"]);
}

/// A dataset of walks on disk, and a config that reads it.
fn dataset() -> Sandbox {
    let sandbox = sandbox();
    write_walks(&sandbox.path("walks"), 8, 48, 3).expect("walks");
    sandbox.write("c.toml", smallest_walks_on_disk());
    sandbox
}

#[test]
fn a_dataset_on_disk_trains_and_is_looked_at() {
    let sandbox = dataset();
    sandbox
        .run("train c.toml --set train.max_steps=30")
        .succeeded();
    let said = sandbox.run("data inspect walks").succeeded();
    assert!(
        said.stdout.contains("captions with an embedding"),
        "{}",
        said.stdout
    );
    let listed = fs::read_to_string(sandbox.path("walks/train.txt")).expect("a list");
    let key = listed.lines().next().expect("a clip");
    let embedding = format!("walks/text_embeddings.safetensors#{key}");
    sandbox
        .run(&format!(
            "sample runs/smallest --text-embedding {embedding} --out with_text"
        ))
        .succeeded();
    sandbox
        .run("sample runs/smallest --out without_text")
        .succeeded();
    let bytes = |name: &str| fs::read(sandbox.path(name)).expect("a file");
    assert!(bytes("with_text.npy") != bytes("without_text.npy"));
}

#[test]
fn bad_clips_are_refused_before_anything_is_written() {
    let refused = |spoil: &dyn Fn(&Path), texts: &[&str]| {
        let sandbox = dataset();
        spoil(&sandbox.path("walks"));
        sandbox.run("train c.toml").failed(2, texts);
        assert!(!sandbox.path("runs").exists());
    };
    let first = |folder: &Path| {
        let listed = fs::read_to_string(folder.join("train.txt")).expect("a list");
        listed.lines().next().expect("a clip").to_string()
    };
    refused(
        &|folder| {
            let path = folder.join(format!("new_joint_vecs/{}.npy", first(folder)));
            write_values(&path, &[48, 251], &[0.0; 48 * 251]).expect("a file");
        },
        &["new_joint_vecs", "251", "263"],
    );
    refused(
        &|folder| {
            for name in ["Mean_abs_3d.npy", "Std_abs_3d.npy"] {
                write_values(&folder.join(name), &[251], &[1.0; 251]).expect("a file");
            }
        },
        &["Mean_abs_3d.npy", "251", "263"],
    );
    refused(
        &|folder| {
            for (name, value) in [("Mean_abs_3d.npy", 1e30), ("Std_abs_3d.npy", 1.0)] {
                write_values(&folder.join(name), &[263], &[value; 263]).expect("a file");
            }
        },
        &["Mean_abs_3d.npy", "channel root.", "from -1e6 to 1e6"],
    );
    refused(
        &|folder| {
            let path = folder.join(format!("new_joint_vecs/{}.npy", first(folder)));
            write_values(&path, &[48, 263], &[-1e30; 48 * 263]).expect("a file");
        },
        &["new_joint_vecs", "channel root.", "from -1e6 to 1e6"],
    );
    refused(
        &|folder| {
            let path = folder.join(format!("texts/{}.txt", first(folder)));
            fs::remove_file(path).expect("a file");
        },
        &["texts/", "caption"],
    );
}
