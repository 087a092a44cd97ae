//! Fine-tuning with its earlier stages: stopped in one of them, started from elsewhere, and with
//! lost files.

use std::fs;
use std::path::PathBuf;

use kinegrad_tests::sandbox::{SMALLEST, Sandbox, finish};

const SETTINGS: &str = "--set train.recipe=e2e --set train.max_steps=4 \
    --set init.pretrain.diffusion_steps=4 --set init.pretrain.decoder_steps=8 \
    --set decoder.hidden_dim=32 --set decoder.coherence=projection --set rollout.steps=2";

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
}

fn weights(sandbox: &Sandbox) -> PathBuf {
    sandbox.path("runs/smallest/checkpoints/step-00000004/model.safetensors")
}

/// Removes the files that a run writes after its decoder's step 6, or after the decoder's config.
fn stop_in_the_decoder(sandbox: &Sandbox, after_checkpoint: bool) {
    let run = sandbox.path("runs/smallest");
    fs::remove_dir_all(run.join("checkpoints")).expect("checkpoints");
    let decoder = run.join("decoder/checkpoints");
    match after_checkpoint {
        true => fs::remove_dir_all(decoder.join("step-00000008")).expect("a checkpoint"),
        false => fs::remove_dir_all(decoder).expect("checkpoints"),
    }
}

#[test]
fn a_run_stopped_in_its_decoder_resumes_from_anywhere() {
    let sandbox = sandbox();
    let train = format!("train c.toml {SETTINGS}");
    // The files of a process that is killed before it writes its first config.
    for name in ["lock", ".writing-config.toml"] {
        sandbox.write(&format!("runs/smallest/base/{name}"), "");
    }
    sandbox.run(&train).succeeded();
    let whole = fs::read(weights(&sandbox)).expect("weights");
    let absolute = sandbox.path("runs").display().to_string();
    for (runs, after_checkpoint) in [("./runs", true), ("runs/", false), (&absolute, true)] {
        stop_in_the_decoder(&sandbox, after_checkpoint);
        let resume = format!("{train} --resume --runs-dir {runs}");
        let resumed = sandbox.run(&resume).succeeded();
        let continues = resumed.stderr.contains("continuing after step 6 of 8");
        assert_eq!(continues, after_checkpoint, "{}", resumed.stderr);
        assert!(
            whole == fs::read(weights(&sandbox)).expect("weights"),
            "{runs}"
        );
    }

    stop_in_the_decoder(&sandbox, true);
    fs::create_dir(sandbox.path("elsewhere")).expect("a folder");
    let resume = format!("train ../c.toml {SETTINGS} --resume --runs-dir ../runs");
    let mut command = sandbox.command(resume.split_whitespace());
    command.current_dir(sandbox.path("elsewhere"));
    finish(command).succeeded();
    assert!(whole == fs::read(weights(&sandbox)).expect("weights"));
}

#[test]
fn a_decoder_that_is_no_stage_keeps_the_path_it_was_given() {
    let sandbox = sandbox();
    let train = "train c.toml --set train.max_steps=2";
    sandbox.run(&format!("{train} --name base")).succeeded();
    let decoder = format!(
        "{train} --name decoder --set train.recipe=decoder --set init.diffusion=runs/base \
         --set decoder.hidden_dim=32 --set rollout.steps=2"
    );
    sandbox.run(&decoder).succeeded();
    for runs in ["runs", "./runs"] {
        let resume = format!("{decoder} --resume --runs-dir {runs}");
        sandbox.run(&resume).succeeded();
    }
    let other = decoder.replace("runs/base", "runs/decoder");
    sandbox.run(&format!("{other} --resume")).failed(
        2,
        &["`init.diffusion` is \"runs/decoder\"", "\"runs/base\""],
    );
}

#[test]
fn a_lost_config_of_a_base_model_is_no_lost_run() {
    let sandbox = sandbox();
    let train = format!("train c.toml {SETTINGS}");
    sandbox.run(&train).succeeded();
    let whole = fs::read(weights(&sandbox)).expect("weights");
    let base = sandbox.path("runs/smallest/base");
    stop_in_the_decoder(&sandbox, true);
    fs::remove_file(base.join("config.toml")).expect("a config");
    sandbox
        .run(&train)
        .failed(2, &["exists already", "--resume"]);
    // Its checkpoints contain its training settings.
    sandbox.run(&format!("{train} --resume")).succeeded();
    assert!(whole == fs::read(weights(&sandbox)).expect("weights"));

    stop_in_the_decoder(&sandbox, true);
    let kept = sandbox.path("kept");
    fs::rename(&base, &kept).expect("moved");
    fs::create_dir(&base).expect("an empty folder");
    let texts = [
        "runs/smallest/base/config.toml and the checkpoints next to it are missing",
        "put the folder runs/smallest/base back",
        "remove runs/smallest/decoder",
    ];
    sandbox.run(&format!("{train} --resume")).failed(2, &texts);
    assert!(sandbox.list("runs/smallest/base").is_empty());
    fs::remove_dir(&base).expect("an empty folder");
    sandbox.run(&format!("{train} --resume")).failed(2, &texts);
    fs::rename(&kept, &base).expect("moved back");
    sandbox.run(&format!("{train} --resume")).succeeded();
}

#[test]
fn a_start_that_a_recipe_does_not_use_is_refused_in_new_runs_alone() {
    let sandbox = sandbox();
    for (setting, texts) in [
        (
            "init.diffusion=runs/old",
            [
                "`init.diffusion` is \"runs/old\"",
                "recipe `diffusion` starts from new weights",
            ],
        ),
        (
            "init.decoder=runs/old",
            [
                "`init.decoder` is \"runs/old\"",
                "`decoder` and `e2e`, not `diffusion`",
            ],
        ),
    ] {
        sandbox
            .run(&format!("train c.toml --set {setting}"))
            .failed(2, &texts);
        assert!(!sandbox.path("runs").exists());
    }

    // A run with such a setting in its stored config.
    let train = "train c.toml --set train.max_steps=4";
    sandbox.run(train).succeeded();
    fs::remove_dir_all(sandbox.path("runs/smallest/checkpoints")).expect("checkpoints");
    let path = sandbox.path("runs/smallest/config.toml");
    let config = fs::read_to_string(&path).expect("a config");
    let old = config.replacen("diffusion = \"\"", "diffusion = \"runs/old\"", 1);
    assert_ne!(old, config);
    fs::write(&path, old).expect("written");
    let again = format!("{train} --set init.diffusion=runs/old --resume");
    sandbox.run(&again).succeeded();
    sandbox
        .run("sample runs/smallest --steps 2 --out s")
        .succeeded();
    sandbox
        .run(&again.replace("max_steps=4", "max_steps=6"))
        .succeeded();
}
