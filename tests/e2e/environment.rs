//! Environment variables that set config keys, and the origins that `config show` names.

use std::fs;

use kinegrad_tests::sandbox::{Finished, SMALLEST, Sandbox, finish};

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
}

fn run(sandbox: &Sandbox, variables: &[(&str, &str)], arguments: &str) -> Finished {
    let mut command = sandbox.command(arguments.split_whitespace());
    command.envs(variables.iter().copied());
    finish(command)
}

#[test]
fn each_value_is_shown_with_its_origin() {
    let sandbox = sandbox();
    let variables = [
        ("KINEGRAD_DEVICE", "auto"),
        ("KINEGRAD_DATA_SOURCE", "there"),
        ("KINEGRAD_DIFFUSION_CHECKPOINT", "runs/base"),
        ("KINEGRAD_RUNS_DIR", "elsewhere"),
    ];
    let show = "config show c.toml --set optim.warmup_steps=9";
    let shown = run(&sandbox, &variables, show).succeeded().stdout;
    for line in [
        "# runs folder: elsewhere  # environment, KINEGRAD_RUNS_DIR",
        "device = \"auto\"  # environment, KINEGRAD_DEVICE",
        "warmup_steps = 9  # command line",
        "target_frames = 24  # file",
        "patience = 0  # default",
    ] {
        assert!(shown.lines().any(|found| found == line), "{line}\n{shown}");
    }
    // Synthetic data has no source, and recipe `diffusion` no initial checkpoint.
    assert!(
        !shown.contains("there") && !shown.contains("runs/base"),
        "{shown}"
    );
    let set = format!("{show} --set run.device=cpu --set data.kind=phrases");
    let shown = run(&sandbox, &variables, &set).succeeded().stdout;
    for line in [
        "device = \"cpu\"  # command line",
        "source = \"there\"  # environment, KINEGRAD_DATA_SOURCE",
    ] {
        assert!(shown.lines().any(|found| found == line), "{line}\n{shown}");
    }
    let empty = run(&sandbox, &[("KINEGRAD_DEVICE", "")], show).succeeded();
    assert!(empty.stdout.contains("device = \"cpu\"  # file"));
    // The output is a config.
    sandbox.write("shown.toml", &shown);
    sandbox
        .run("config show shown.toml --set data.kind=synthetic")
        .succeeded();
}

#[test]
fn a_run_takes_device_folder_and_initial_checkpoints_from_the_environment() {
    let sandbox = sandbox();
    let length = "--set train.max_steps=2 --set validation.every_steps=0";
    let folder = ("KINEGRAD_RUNS_DIR", "elsewhere");
    let train = format!("train c.toml --name base {length}");
    run(&sandbox, &[folder], &train).succeeded();
    assert!(sandbox.path("elsewhere/base/config.toml").exists());
    assert!(!sandbox.path("runs").exists());
    let listed = run(&sandbox, &[folder], "runs").succeeded().stdout;
    assert!(listed.contains("base"), "{listed}");

    let base = ("KINEGRAD_DIFFUSION_CHECKPOINT", "elsewhere/base");
    let decoder = format!(
        "train c.toml --name decoder --set train.recipe=decoder --set rollout.steps=2 {length}"
    );
    sandbox.run(&decoder).failed(2, &["init.diffusion"]);
    run(&sandbox, &[base, folder], &decoder).succeeded();
    let path = sandbox.path("elsewhere/decoder/config.toml");
    let config = fs::read_to_string(path).expect("a config");
    assert!(
        config.contains("diffusion = \"elsewhere/base\""),
        "{config}"
    );
    // A resumed run keeps its initial checkpoint.
    let other = ("KINEGRAD_DIFFUSION_CHECKPOINT", "gone");
    let resume = "train --resume elsewhere/decoder --set train.max_steps=3";
    run(&sandbox, &[other], resume).succeeded();

    let quantum = ("KINEGRAD_DEVICE", "quantum");
    let train = format!("{train} --runs-dir runs");
    run(&sandbox, &[quantum], &train).failed(2, &["quantum"]);
    let sample = "sample elsewhere/base --out x --frames 8 --steps 2";
    run(&sandbox, &[quantum], sample).failed(2, &["quantum"]);
    run(&sandbox, &[quantum], &format!("{sample} --device cpu")).succeeded();
    run(&sandbox, &[quantum], &format!("{train} --device cpu")).succeeded();
}
