//! The estimates of `kinegrad train --dry-run` for memory and time, compared with trainings.

use std::thread::sleep;
use std::time::Duration;

use kinegrad_tests::sandbox::{SMALLEST, SMALLEST_WALKS, Sandbox};
use serde_json::Value;

/// Peak of main memory of a command, bytes.
fn most_memory(sandbox: &Sandbox, arguments: &str) -> u64 {
    let mut child = sandbox.start(arguments);
    let status = format!("/proc/{}/status", child.id());
    let mut most = 0;
    loop {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let number = line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok());
        most = most.max(number.unwrap_or(0) << 10);
        if let Some(status) = child.try_wait().expect("a status") {
            assert!(status.success(), "{arguments}: {status}");
            return most;
        }
        sleep(Duration::from_millis(1));
    }
}

fn plan(sandbox: &Sandbox, train: &str) -> Value {
    let plan = sandbox
        .run(&format!("{train} --dry-run --json"))
        .succeeded();
    serde_json::from_str(&plan.stdout).expect("one line of JSON")
}

#[test]
#[cfg(target_os = "linux")]
fn a_dry_run_states_the_memory_that_a_training_takes() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox.write("w.toml", SMALLEST_WALKS);
    for (name, train) in [
        ("least", "train c.toml"),
        (
            "batches",
            "train c.toml --set data.batch_size=48 --set data.synthetic.phrases=200 \
             --set validation.batch_size=40",
        ),
        (
            "wide",
            "train c.toml --set model.model_channels=96 --set data.target_frames=40",
        ),
        ("walks", "train w.toml"),
    ] {
        let train = format!(
            "{train} --name {name} --set train.max_steps=8 --set sampling.count_at_end=3 \
             --set sampling.sampler.num_inference_steps=3"
        );
        let planned = plan(&sandbox, &train)["memory_bytes"]
            .as_u64()
            .expect("a size");
        let taken = most_memory(&sandbox, &train);
        let share = planned as f64 / taken as f64;
        assert!(
            (share - 1.0).abs() < 0.15,
            "{name}: {} KiB planned, {} KiB taken",
            planned >> 10,
            taken >> 10
        );
    }
}

#[test]
#[cfg(target_os = "linux")]
fn activation_checkpointing_takes_less_memory_and_changes_no_bit() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox.write("w.toml", SMALLEST_WALKS);
    for (name, train) in [
        (
            "phrases",
            "train c.toml --set model.model_channels=64 --set model.num_res_blocks=3 \
             --set data.target_frames=40 --set data.batch_size=192 \
             --set data.synthetic.phrases=300",
        ),
        (
            "walks",
            "train w.toml --set model.latent_dim=64 --set data.target_frames=40 \
             --set model.padded_frames=44 --set data.batch_size=192 \
             --set data.synthetic.phrases=300",
        ),
    ] {
        let taken = ["stored", "recomputed"].map(|kind| {
            let train = format!(
                "{train} --name {name}-{kind} --set train.max_steps=3 \
                 --set sampling.count_at_end=0 --set validation.every_steps=0 \
                 --set model.activation_checkpointing={}",
                kind == "recomputed"
            );
            let planned = plan(&sandbox, &train)["memory_bytes"].as_u64();
            let taken = most_memory(&sandbox, &train);
            let share = planned.expect("a size") as f64 / taken as f64;
            assert!((share - 1.0).abs() < 0.15, "{name}-{kind}: {share}");
            taken
        });
        let share = taken[1] as f64 / taken[0] as f64;
        assert!(
            share < 0.9,
            "{name}: {} and {} KiB",
            taken[0] >> 10,
            taken[1] >> 10
        );
        let weights = |kind: &str| {
            let checkpoint = format!("runs/{name}-{kind}/checkpoints/step-00000003");
            std::fs::read(sandbox.path(&checkpoint).join("model.safetensors")).expect("weights")
        };
        assert!(weights("stored") == weights("recomputed"), "{name}");
    }
}

#[test]
fn a_dry_run_counts_validations() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    for (settings, validations) in [
        ("--set validation.every_steps=10", 4),
        ("--set validation.every_steps=9", 5),
        ("--set validation.every_steps=0", 0),
    ] {
        let plan = plan(&sandbox, &format!("train c.toml {settings}"));
        assert_eq!(plan["validations"], validations);
        let seconds = |key: &str| plan[key].as_f64().unwrap_or_default();
        assert_eq!(seconds("validation_seconds") > 0.0, validations > 0);
        let all =
            40.0 * seconds("step_seconds") + f64::from(validations) * seconds("validation_seconds");
        assert!((seconds("training_seconds") - all).abs() < 1e-9, "{plan}");
    }
    let said = sandbox.run("train c.toml --dry-run").succeeded();
    assert!(
        said.stdout.contains("for 40 steps and 4 validations of"),
        "{}",
        said.stdout
    );
}
