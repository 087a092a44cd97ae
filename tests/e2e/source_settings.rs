//! Settings of CC-MotionGen's configuration: each changes the output that it names, and no other.

use std::fs;
use std::path::Path;

use kinegrad_tests::sandbox::{SMALLEST, Sandbox};
use serde_json::Value;

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
}

fn bytes(sandbox: &Sandbox, path: impl AsRef<Path>) -> Vec<u8> {
    fs::read(sandbox.path(&path)).unwrap_or_else(|_| panic!("{}", path.as_ref().display()))
}

/// The tensors of a checkpoint.
fn tensors(sandbox: &Sandbox, run: &str, step: usize) -> [Vec<u8>; 3] {
    ["model", "ema", "optimizer"].map(|name| {
        let folder = format!("runs/{run}/checkpoints/step-{step:08}");
        bytes(sandbox, format!("{folder}/{name}.safetensors"))
    })
}

#[test]
fn epochs_are_steps_over_the_training_items() {
    let sandbox = sandbox();
    // 12 phrases, of which 3 are held out: 9 in batches of 4 are 3 steps.
    let held_out = "--set data.validation.patterns=[\"*_00000\",\"*_00001\",\"*_00002\"]";
    let train = format!("train c.toml {held_out} --set optim.lr_schedule=constant --json");
    let steps = "--set train.max_steps=6 --set checkpoint.every_steps=3 --set \
                 validation.every_steps=3";
    let epochs = "--set checkpoint.every_epochs=1 --set validation.every_epochs=1";
    sandbox
        .run(&format!("{train} --name steps {steps}"))
        .succeeded();
    let summary = sandbox
        .run(&format!(
            "{train} --name epochs --set train.epochs=2 {epochs}"
        ))
        .succeeded();
    let summary: Value = serde_json::from_str(&summary.stdout).expect("JSON");
    assert_eq!(
        (&summary["steps"], &summary["max_steps"]),
        (&6.into(), &6.into())
    );
    assert_eq!(
        sandbox.list("runs/epochs/checkpoints"),
        sandbox.list("runs/steps/checkpoints")
    );
    let whole = tensors(&sandbox, "epochs", 6);
    assert!(whole == tensors(&sandbox, "steps", 6));
    let config = fs::read_to_string(sandbox.path("runs/epochs/config.toml")).expect("a config");
    assert!(config.contains("\nepochs = 2\n"), "{config}");
    assert!(!config.contains("max_steps") && !config.contains("every_steps = 4"));

    // Half of it, resumed.
    sandbox
        .run(&format!(
            "{train} --name halves --set train.epochs=1 {epochs}"
        ))
        .succeeded();
    let listed = sandbox.run("runs").succeeded().stdout;
    assert!(listed.contains("3 of 3"), "{listed}");
    sandbox
        .run("train --resume runs/halves --set train.epochs=2")
        .succeeded();
    assert!(whole == tensors(&sandbox, "halves", 6));
    let listed = sandbox.run("runs").succeeded().stdout;
    assert!(listed.matches("6 of 6").count() == 3, "{listed}");
    let again = sandbox.run("train --resume runs/halves").succeeded();
    assert!(again.stdout.contains("nothing to do"), "{}", again.stdout);
    // The other unit takes over.
    let on = "train --resume runs/halves --set train.max_steps=7 --json";
    let summary = sandbox.run(on).succeeded().stdout;
    assert!(summary.contains("\"max_steps\":7"), "{summary}");
}

#[test]
fn a_length_in_steps_and_in_epochs_is_refused() {
    let sandbox = sandbox();
    let both = SMALLEST.replace("max_steps = 40", "max_steps = 40\nepochs = 2");
    sandbox.write("both.toml", both);
    for command in ["train both.toml", "config show both.toml"] {
        let refused = sandbox.run(command);
        refused.failed(
            2,
            &[
                "both.toml:24",
                "train.epochs",
                "train.max_steps",
                "one of the two",
            ],
        );
    }
    let set = "train c.toml --set train.epochs=2 --set train.max_steps=3";
    let refused = sandbox.run(set);
    refused.failed(2, &["--set train.epochs", "train.max_steps"]);
    for (setting, key) in [
        ("train.epochs=0", "train.epochs"),
        ("checkpoint.every_epochs=0", "checkpoint.every_epochs"),
        ("validation.every_epochs=0", "validation.every_epochs"),
    ] {
        let refused = sandbox.run(&format!("train c.toml --set {setting}"));
        refused.failed(2, &[key, "1 or more"]);
    }
}

/// Trains the smallest config; returns the weights of step 4.
fn trained(sandbox: &Sandbox, name: &str, settings: &str) -> Vec<u8> {
    let train = format!(
        "train c.toml --name {name} --set train.max_steps=4 --set validation.every_steps=0 {settings}"
    );
    sandbox.run(&train).succeeded();
    let [model, ..] = tensors(sandbox, name, 4);
    model
}

#[test]
fn rescaled_timesteps_change_a_network_unless_there_are_1000() {
    let sandbox = sandbox();
    let plain = trained(&sandbox, "plain", "");
    let rescaled = trained(&sandbox, "same", "--set diffusion.rescale_timesteps=true");
    assert!(plain == rescaled);
    let few =
        "--set diffusion.num_train_timesteps=100 --set sampling.sampler.num_inference_steps=4";
    let plain = trained(&sandbox, "few", few);
    let rescale = format!("{few} --set diffusion.rescale_timesteps=true");
    assert!(plain != trained(&sandbox, "rescaled", &rescale));
    for recipe in ["gmd_motion", "bpe_motion"] {
        let refused = sandbox.run(&format!(
            "config show c.toml --set train.recipe={recipe} --set model={{}} \
             --set data.kind=synthetic_walks --set diffusion.rescale_timesteps=true"
        ));
        refused.failed(2, &["diffusion.rescale_timesteps", "false for this recipe"]);
    }
}

#[test]
fn heads_are_set_by_number_or_by_channels() {
    let sandbox = sandbox();
    let plain = trained(&sandbox, "plain", "");
    // 8 heads of 32 channels have 4 channels each.
    let four = trained(&sandbox, "four", "--set model.num_head_channels=4");
    assert!(plain == four);
    let sixteen = trained(&sandbox, "sixteen", "--set model.num_head_channels=16");
    assert!(plain != sixteen);
    let refused = sandbox.run("config show c.toml --set model.num_head_channels=5");
    refused.failed(2, &["model.num_head_channels", "32 channels"]);
    let refused = sandbox.run("config show c.toml --set model.num_head_channels=0");
    refused.failed(2, &["model.num_head_channels"]);
}

#[test]
fn variance_and_clip_range_change_samples() {
    let sandbox = sandbox();
    trained(&sandbox, "run", "");
    let sample = |name: &str, settings: &str| {
        let sample = format!("sample runs/run --out {name} --frames 16 --steps 5 {settings}");
        sandbox.run(&sample).succeeded();
        bytes(&sandbox, format!("{name}.npy"))
    };
    let ddpm = "--set sampling.sampler.kind=ddpm";
    let small = sample("small", ddpm);
    let of_type = |name: &str, variance: &str| {
        let variance = format!("{ddpm} --set sampling.sampler.variance_type={variance}");
        sample(name, &variance)
    };
    assert!(small == of_type("named", "fixed_small"));
    assert!(small != of_type("large", "fixed_large"));
    let record = fs::read_to_string(sandbox.path("large.json")).expect("a record");
    assert!(
        record.contains("\"variance_type\": \"fixed_large\""),
        "{record}"
    );
    let ddim =
        sandbox.run("sample runs/run --out x --set sampling.sampler.variance_type=fixed_large");
    ddim.failed(2, &["variance_type", "eta"]);

    let clip = |name: &str, clip: &str| sample(name, &format!("--set sampling.clip={clip}"));
    let symmetric = |name: &str, range: &str| {
        clip(
            name,
            &format!("symmetric --set sampling.clip_range={range}"),
        )
    };
    let unit = clip("unit", "unit");
    assert!(unit == symmetric("one", "1.0"));
    assert!(unit != symmetric("half", "0.5"));
    assert!(clip("six", "six") == symmetric("six_too", "6.0"));
    let record = fs::read_to_string(sandbox.path("half.json")).expect("a record");
    assert!(record.contains("\"clip_range\": 0.5"), "{record}");
    for (settings, texts) in [
        (
            "--set sampling.clip=symmetric",
            ["sampling.clip_range", "not set"],
        ),
        (
            "--set sampling.clip_range=2.0",
            ["sampling.clip_range", "symmetric"],
        ),
        (
            "--set sampling.clip=symmetric --set sampling.clip_range=0.0",
            ["sampling.clip_range", "0"],
        ),
    ] {
        let refused = sandbox.run(&format!("train c.toml --name no {settings}"));
        refused.failed(2, &texts);
    }
    let rollout = "train c.toml --name no --set train.recipe=decoder --set init.diffusion=runs/run \
                   --set rollout.clip_range=2.0";
    sandbox
        .run(rollout)
        .failed(2, &["rollout.clip_range", "symmetric"]);
}

/// Settings of a decoder on the base `runs/base`.
const DECODER: &str = "--set train.recipe=decoder --set init.diffusion=runs/base --set \
    decoder.hidden_dim=32 --set decoder.init=random --set rollout.steps=2 --set \
    optim.lr_schedule=constant --set validation.every_steps=4";

#[test]
fn a_decoder_has_other_activations() {
    let sandbox = sandbox();
    trained(&sandbox, "base", "");
    let decoder = |name: &str, settings: &str| {
        let train =
            format!("train c.toml --name {name} --set train.max_steps=4 {DECODER} {settings}");
        sandbox.run(&train).succeeded();
        tensors(&sandbox, name, 4)
    };
    let gelu = decoder("plain", "");
    assert!(
        gelu == decoder(
            "gelu",
            "--set decoder.activation=gelu --set decoder.use_layer_norm=true"
        )
    );
    let relu = decoder("relu", "--set decoder.activation=relu");
    let silu = decoder("silu", "--set decoder.activation=silu");
    assert!(gelu != relu && gelu != silu && relu != silu);
}

#[test]
fn batch_norm_resumes_to_the_same_bytes_and_samples_with_its_running_statistics() {
    let sandbox = sandbox();
    trained(&sandbox, "base", "");
    let batch_norm = format!("{DECODER} --set decoder.use_layer_norm=false");
    let train = |name: &str, steps: usize| {
        format!("train c.toml --name {name} --set train.max_steps={steps} {batch_norm}")
    };
    sandbox.run(&train("whole", 8)).succeeded();
    sandbox.run(&train("halves", 4)).succeeded();
    sandbox
        .run("train --resume runs/halves --set train.max_steps=8")
        .succeeded();
    let whole = tensors(&sandbox, "whole", 8);
    assert!(whole == tensors(&sandbox, "halves", 8));
    let half = tensors(&sandbox, "halves", 4);
    let mean = "decoder.blocks.0.layers.0.running_mean";
    let running = |[model, ema, _]: &[Vec<u8>; 3]| {
        [model, ema].map(|file| {
            let file = safetensors::SafeTensors::deserialize(file).expect("tensors");
            file.tensor(mean).expect(mean).data().to_vec()
        })
    };
    let [model, ema] = running(&whole);
    // The averaged weights use the statistics as they are.
    assert!(model == ema);
    assert!(model != running(&half)[0]);
    assert!(model.iter().any(|byte| *byte != 0));
    let sample = "sample runs/whole --frames 16 --steps 4";
    sandbox.run(&format!("{sample} --out one")).succeeded();
    sandbox
        .run(&format!("{sample} --out two --count 1"))
        .succeeded();
    assert!(bytes(&sandbox, "one.npy") == bytes(&sandbox, "two.npy"));
    // A decoder with another norm has other parameters.
    let other = "train c.toml --name e2e --set train.recipe=e2e --set train.max_steps=2 \
                 --set init.diffusion=runs/base --set init.decoder=runs/whole \
                 --set decoder.use_layer_norm=true";
    sandbox.run(other).failed(2, &["decoder"]);
    let same = other.replace(
        " --set decoder.use_layer_norm=true",
        " --set rollout.steps=2",
    );
    sandbox.run(&same).succeeded();
}

#[test]
fn products_of_a_sample_have_the_precision_of_the_config() {
    let sandbox = sandbox();
    sandbox
        .run("train c.toml --set train.max_steps=2 --set optim.warmup_steps=1")
        .succeeded();
    let sample = |out: &str, settings: &str| {
        let command = format!("sample runs/smallest --out {out} --steps 3 {settings}");
        sandbox.run(&command).succeeded();
        let record: Value =
            serde_json::from_slice(&bytes(&sandbox, format!("{out}.json"))).expect("JSON");
        let motion = bytes(&sandbox, format!("{out}.raw.npy"));
        (record["sampler"]["precision"].clone(), motion)
    };
    let (wide, motion) = sample("wide", "");
    let (narrow, other) = sample("narrow", "--set sampling.precision=bf16");
    assert_eq!((wide, narrow), ("float32".into(), "bf16".into()));
    let numbers = |file: &[u8]| -> Vec<f32> {
        let values = file[128..].chunks_exact(4);
        values
            .map(|bytes| f32::from_le_bytes(bytes.try_into().expect("four bytes")))
            .collect()
    };
    let (motion, other) = (numbers(&motion), numbers(&other));
    let differences = motion.iter().zip(&other).map(|(a, b)| (a - b).abs());
    let difference = differences.fold(0.0, f32::max);
    let largest = motion.iter().fold(0.0_f32, |most, x| most.max(x.abs()));
    assert!(
        difference > 1e-6 * largest && difference < 0.1 * largest,
        "{difference} of {largest}"
    );
}
