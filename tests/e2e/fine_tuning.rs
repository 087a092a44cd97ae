//! Decoder training, fine-tuning through the sampler, adapters: from a base run to samples, and
//! refusals.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use kinegrad_data::read_motion;
use kinegrad_motion::derivatives::{acceleration_errors, mean_norm, velocity_errors};
use kinegrad_tests::sandbox::{SMALLEST, Sandbox};
use safetensors::SafeTensors;
use serde_json::Value;

/// A sandbox with a trained base, runs/base, and a decoder on it, runs/decoder.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
        .run("train c.toml --name base --set train.max_steps=8 --set validation.every_steps=8")
        .succeeded();
    sandbox.run(&decoder("decoder", "")).succeeded();
    sandbox
}

fn decoder(name: &str, settings: &str) -> String {
    format!(
        "train c.toml --name {name} --set train.recipe=decoder --set init.diffusion=runs/base \
         --set decoder.hidden_dim=32 --set rollout.steps=3 --set train.max_steps=6 {settings}"
    )
}

fn e2e(name: &str, settings: &str) -> String {
    format!(
        "train c.toml --name {name} --set train.recipe=e2e --set init.diffusion=runs/base \
         --set init.decoder=runs/decoder --set rollout.steps=3 --set train.max_steps=4 {settings}"
    )
}

/// The tensors of the last checkpoint's `file`, as bytes.
fn tensors(run: &Path, file: &str) -> BTreeMap<String, Vec<u8>> {
    let mut steps: Vec<_> = fs::read_dir(run.join("checkpoints"))
        .expect("checkpoints")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.is_dir())
        .collect();
    steps.sort();
    let bytes = fs::read(steps.last().expect("a checkpoint").join(file)).expect("a file");
    let parsed = SafeTensors::deserialize(&bytes).expect("tensors");
    parsed
        .iter()
        .map(|(name, view)| (name.to_string(), view.data().to_vec()))
        .collect()
}

fn metrics(run: &Path) -> Vec<Value> {
    let text = fs::read_to_string(run.join("metrics.jsonl")).expect("metrics");
    let lines = text.lines();
    lines
        .map(|l| serde_json::from_str(l).expect("JSON"))
        .collect()
}

#[test]
fn a_decoder_learns_on_a_denoiser_that_stays_as_it_is() {
    let sandbox = sandbox();
    let base = tensors(&sandbox.path("runs/base"), "ema.safetensors");
    let found = tensors(&sandbox.path("runs/decoder"), "model.safetensors");
    for (name, bytes) in &base {
        assert!(&found[&format!("unet.{name}")] == bytes, "{name} changed");
    }
    assert!(found.contains_key("decoder.blocks.2.layers.4.weight"));
    let moments = tensors(&sandbox.path("runs/decoder"), "optimizer.safetensors");
    assert!(moments.keys().all(|name| name.starts_with("decoder.")));
    let lines = metrics(&sandbox.path("runs/decoder"));
    let first = lines.first().expect("lines");
    assert_eq!(first["step"], 0, "measured before the first step");
    let last = |key: &str| lines.last().expect("lines")[key].as_f64();
    assert!(last("val_loss") < first["val_loss"].as_f64());
    assert!(lines[1]["lr_decoder"].is_number());
}

#[test]
fn a_fine_tuning_that_gets_worse_says_that_the_start_is_kept() {
    let sandbox = sandbox();
    let settings = "--set optim.learning_rate=0.5 --set optim.warmup_steps=0";
    let said = sandbox.run(&e2e("worse", settings)).succeeded().stdout;
    assert!(
        said.contains("no step was better, so the start is kept"),
        "{said}"
    );
    let listed = sandbox.run("runs").succeeded().stdout;
    assert!(listed.contains("at the start"), "{listed}");
}

#[test]
fn fine_tuning_trains_both_networks_at_their_own_rates() {
    let sandbox = sandbox();
    let settings = "--set optim.groups.unet=1e-6 --set optim.groups.decoder=5e-5 \
                    --set decoder.coherence=projection";
    sandbox.run(&e2e("tuned", settings)).succeeded();
    let run = sandbox.path("runs/tuned");
    let before = tensors(&sandbox.path("runs/decoder"), "ema.safetensors");
    let after = tensors(&run, "model.safetensors");
    assert_eq!(before.len(), after.len());
    for part in ["unet.", "decoder."] {
        let changed =
            |(name, bytes): (&String, &Vec<u8>)| name.starts_with(part) && before[name] != *bytes;
        assert!(after.iter().any(changed), "nothing of {part} was trained");
    }
    let lines = metrics(&run);
    let trained = &lines[2];
    // The initial decoder has no projection; the run's decoder has one.
    for line in &lines {
        let coherence = line.get("loss_velocity_coherence");
        assert!(
            coherence.and_then(Value::as_f64).unwrap_or(0.0) < 1e-9,
            "{line}"
        );
    }
    assert_eq!(trained["lr_unet"].as_f64(), Some(1e-6 / 5.0));
    assert_eq!(trained["lr_decoder"].as_f64(), Some(5e-5 / 5.0));
    for term in [
        "diffusion",
        "position",
        "quaternion",
        "jerk",
        "velocity_coherence",
    ] {
        assert!(trained[format!("loss_{term}")].is_number(), "{trained}");
    }

    // Samples of a projecting decoder are coherent before any post-processing.
    sandbox.run("sample runs/tuned --out dance").succeeded();
    let raw = read_motion(&sandbox.path("dance.raw.npy")).expect("a motion");
    assert!(mean_norm(&velocity_errors(&raw)) < 1e-4);
    assert!(mean_norm(&acceleration_errors(&raw)) < 1e-2);

    // The run is self-contained: it resumes and samples without its initial checkpoints.
    for start in ["base", "decoder"] {
        fs::remove_dir_all(sandbox.path(format!("runs/{start}"))).expect("removed");
    }
    let longer = e2e("tuned", settings).replace("max_steps=4", "max_steps=6");
    sandbox.run(&format!("{longer} --resume")).succeeded();
    assert_eq!(metrics(&run).last().expect("lines")["step"], 6);
}

#[test]
fn a_resumed_fine_tuning_keeps_what_it_set_anew() {
    let sandbox = sandbox();
    let settings = "--set model.dropout=0.3 --set decoder.dropout=0.2 \
                    --set decoder.coherence=projection --set optim.lr_schedule=constant";
    sandbox.run(&e2e("whole", settings)).succeeded();
    let halved = e2e("halved", settings).replace("max_steps=4", "max_steps=2");
    sandbox.run(&halved).succeeded();
    sandbox
        .run(&format!("{} --resume", e2e("halved", settings)))
        .succeeded();
    for file in [
        "model.safetensors",
        "ema.safetensors",
        "optimizer.safetensors",
    ] {
        let [whole, halved] =
            ["whole", "halved"].map(|run| tensors(&sandbox.path(format!("runs/{run}")), file));
        assert!(whole == halved, "{file}");
    }
}

#[test]
fn without_a_start_base_and_decoder_are_trained_first() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    let done = sandbox
        .run(
            "train c.toml --set train.recipe=e2e --set train.max_steps=3 \
             --set init.pretrain.diffusion_steps=4 --set init.pretrain.decoder_steps=3 \
             --set decoder.hidden_dim=32 --set rollout.steps=2",
        )
        .succeeded();
    assert!(
        done.stderr.contains("a base model is trained first"),
        "{}",
        done.stderr
    );
    for (run, steps) in [("base/", 4), ("decoder/", 3), ("", 3)] {
        let lines = metrics(&sandbox.path(format!("runs/smallest/{run}")));
        assert_eq!(lines.last().expect("lines")["step"], steps, "{run}");
    }
    sandbox
        .run("train c.toml --set train.recipe=e2e")
        .failed(2, &["the run `smallest` exists already"]);
}

#[test]
fn the_memory_modes_agree() {
    let sandbox = sandbox();
    let run = |mode: &str| {
        let name = format!("r{}", mode.len());
        let settings = format!("--set rollout.mode={mode} --set model.dropout=0");
        sandbox.run(&e2e(&name, &settings)).succeeded();
        metrics(&sandbox.path(format!("runs/{name}")))
    };
    let full = run("full");
    let recomputed = "checkpointed --set model.activation_checkpointing=true";
    for mode in ["checkpointed", recomputed] {
        let other = run(mode);
        assert_eq!(full.len(), other.len());
        for (full, other) in full.iter().zip(&other) {
            for key in ["loss", "val_loss"] {
                let (a, b) = (full[key].as_f64(), other[key].as_f64());
                if let (Some(a), Some(b)) = (a, b) {
                    assert!((a - b).abs() <= 1e-3 * a.abs(), "{full} {other}");
                }
            }
        }
    }
}

#[test]
fn networks_and_process_come_from_the_start() {
    let sandbox = sandbox();
    sandbox.write(
        "short.toml",
        "[data]\nkind = \"synthetic\"\n[train]\nrecipe = \"e2e\"\n[init]\ndiffusion = \"runs/base\"\ndecoder = \"runs/decoder\"\n",
    );
    let shown = sandbox.run("config show short.toml").succeeded().stdout;
    for line in [
        "size = \"tiny\"",
        "channel_mult = [1, 1]",
        "hidden_dim = 32",
    ] {
        assert!(shown.contains(line), "{shown}");
    }
}

#[test]
fn adapters_alone_are_trained_and_merge_into_plain_weights() {
    let sandbox = sandbox();
    sandbox
        .run(&e2e(
            "adapted",
            "--set lora.rank=2 --set optim.groups.unet=1e-2",
        ))
        .succeeded();
    let before = tensors(&sandbox.path("runs/decoder"), "ema.safetensors");
    let after = tensors(&sandbox.path("runs/adapted"), "model.safetensors");
    let plain = |name: &&String| name.starts_with("unet.") && !name.contains(".lora.");
    for name in after.keys().filter(plain) {
        assert!(after[name] == before[name], "{name} changed");
    }
    let adapters = after.keys().filter(|name| name.ends_with(".lora.b"));
    assert!(adapters.clone().count() > 10);
    assert!(
        adapters
            .clone()
            .any(|name| after[name].iter().any(|byte| *byte != 0))
    );
    let moments = tensors(&sandbox.path("runs/adapted"), "optimizer.safetensors");
    assert!(!moments.keys().any(|name| plain(&name)));

    sandbox
        .run("merge runs/adapted --out runs/merged")
        .succeeded();
    let merged = tensors(&sandbox.path("runs/merged"), "ema.safetensors");
    assert!(merged.keys().eq(before.keys()), "plain names");
    for (run, out) in [("adapted", "a"), ("merged", "m")] {
        sandbox
            .run(&format!("sample runs/{run} --steps 4 --out {out}"))
            .succeeded();
    }
    let motion = |name: &str| read_motion(&sandbox.path(name)).expect("a motion");
    let (adapted, merged) = (motion("a.raw.npy"), motion("m.raw.npy"));
    for (a, m) in adapted.as_slice().iter().zip(merged.as_slice()) {
        assert!((a - m).abs() < 1e-3 * (1.0 + a.abs()), "{a} {m}");
    }
    sandbox
        .run("merge runs/merged --out runs/again")
        .failed(2, &["has no low-rank adapters to merge", "need no merging"]);
    sandbox
        .run("merge runs/adapted --out runs/base")
        .failed(2, &["exists already and is not an empty folder"]);
    sandbox
        .run("merge runs/adapted --out m/adapted")
        .succeeded();
    let again = e2e("adapted", "--set optim.groups.unet=1e-2");
    sandbox
        .run(&format!("{again} --runs-dir m --resume"))
        .failed(2, &["cannot be resumed"]);
    assert!(!sandbox.path("m/adapted/config.toml").exists());
    // A merged run can initialise another.
    sandbox
        .run(&e2e("on", "").replace("diffusion=runs/base", "diffusion=runs/merged"))
        .succeeded();
}

#[test]
fn starts_that_do_not_fit_are_refused_by_key() {
    let sandbox = sandbox();
    let cases: [(String, &[&str]); 9] = [
        (
            e2e("x", "").replace("init.decoder=runs/decoder", "init.decoder=runs/base"),
            &["`init.decoder` is", "contains no decoder"],
        ),
        (
            e2e("x", "--set decoder.hidden_dim=48"),
            &["`decoder.hidden_dim` is 48, allowed: 32, which the run it starts from has"],
        ),
        (
            e2e("x", "--set diffusion.prediction_type=v_prediction"),
            &["`diffusion.prediction_type` is \"v_prediction\""],
        ),
        (
            e2e("x", "--set model.size=small"),
            &["`model.size` is \"small\"", "allowed: \"tiny\""],
        ),
        (
            e2e("x", "").replace("runs/base", "runs/nowhere"),
            &["`init.diffusion` is runs/nowhere", "no run or checkpoint"],
        ),
        (
            decoder("x", "").replace("--set init.diffusion=runs/base", ""),
            &[
                "`init.diffusion` is empty",
                "a trained denoiser for recipe `decoder`",
            ],
        ),
        (e2e("x", "--set rollout.steps=0"), &["`rollout.steps` is 0"]),
        (
            e2e("x", "--set rollout.steps=1001"),
            &[
                "`rollout.steps` is 1001",
                "diffusion.num_train_timesteps (1000)",
            ],
        ),
        (
            e2e("x", "--set rollout.last_k=4"),
            &["`rollout.last_k` is 4", "rollout.steps (3)"],
        ),
    ];
    let weights = [
        "loss.w_diff",
        "loss.w_dec",
        "loss.w_temp",
        "loss.temporal.jerk_weight",
    ];
    let refused = |command: &str, texts: &[&str]| {
        sandbox.run(command).failed(2, texts);
        assert!(
            !sandbox.path("runs/x").exists(),
            "a refused run wrote something"
        );
    };
    for (command, texts) in cases {
        refused(&command, texts);
    }
    for key in weights {
        let text = format!("`{key}` is -1, allowed: 0 or more");
        refused(&e2e("x", &format!("--set {key}=-1")), &[&text]);
    }
    let more: [(&str, &str); 6] = [
        (
            "rollout.start_timesteps=[1,999]",
            "`rollout.start_timesteps` is [1, 999]",
        ),
        ("rollout.gradient_decay=2", "`rollout.gradient_decay` is 2"),
        (
            "optim.groups.encoder=1",
            "groups of this recipe: unet, decoder",
        ),
        ("lora.rank=0", "`lora.rank` is 0"),
        (
            "init.diffusion=",
            "`init.decoder` is runs/decoder without `init.diffusion`",
        ),
        (
            "loss.temporal.target_jerk=0",
            "`loss.temporal.target_jerk` is 0",
        ),
    ];
    refused(
        &decoder("x", "--set lora.rank=2"),
        &["`lora` is set, for recipe `decoder`, allowed: recipe `e2e` alone"],
    );
    let untrained = "train c.toml --name x --set train.recipe=e2e \
                     --set init.pretrain.diffusion_steps=0";
    refused(untrained, &["`init.pretrain.diffusion_steps` is 0"]);
    for (setting, text) in more {
        refused(&e2e("x", &format!("--set {setting}")), &[text]);
    }
}

/// Another motion layout shows in the shapes of the first and the last layer.
#[test]
fn a_base_of_another_layout_is_refused() {
    use kinegrad_models::parameters::ParameterInfo;
    use kinegrad_train::checkpoint::{Checkpoint, Checkpoints, write_weights};

    let sandbox = sandbox();
    let base = Checkpoints::of(&sandbox.path("runs/base"));
    let checkpoint: Checkpoint = base
        .newest_good(|_| {})
        .expect("readable")
        .expect("a checkpoint");
    let widened = |values: &Vec<kinegrad_models::parameters::HostParameter>| {
        values
            .iter()
            .map(|parameter| {
                let mut info = parameter.info.clone();
                let mut values = parameter.values.clone();
                if info.name == "input_conv.weight" {
                    info.shape[1] = 263;
                    values = vec![0.0; info.len()];
                }
                (info, values)
            })
            .collect::<(Vec<ParameterInfo>, Vec<Vec<f32>>)>()
    };
    let (infos, model) = widened(&checkpoint.model);
    let (_, ema) = widened(&checkpoint.ema);
    let other = sandbox.path("runs/other");
    write_weights(&other, &checkpoint.state, &infos, &model, &ema).expect("saved");
    sandbox
        .run(&e2e("x", "").replace("runs/base", "runs/other"))
        .failed(
            2,
            &[
                "`init.diffusion` is",
                "`input_conv.weight` has shape [32, 263, 3]",
            ],
        );
    assert!(!sandbox.path("runs/x").exists());
}
