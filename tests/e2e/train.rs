//! The complete sequence: make data, train, sample, check, plot.

use std::fs;
use std::path::Path;

use kinegrad_data::read_motion;
use kinegrad_tests::golden::workspace;
use kinegrad_tests::sandbox::{SMALLEST, Sandbox, finish};

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
}

#[test]
fn from_a_dataset_on_disk_to_checked_samples_and_pictures() {
    let sandbox = sandbox();
    sandbox
        .run("data synth --out set --phrases 10 --frames 30 --seed 4")
        .succeeded();
    let inspected = sandbox.run("data inspect set").succeeded();
    assert!(
        inspected.stdout.contains("position.x"),
        "{}",
        inspected.stdout
    );

    let phrases = "--set data.kind=phrases --set data.source=set --set sampling.count_at_end=2";
    let trained = sandbox.run(&format!("train c.toml {phrases}")).succeeded();
    assert!(
        trained.stdout.contains("best val_loss"),
        "{}",
        trained.stdout
    );
    assert!(
        trained.stdout.contains("strict"),
        "a sanity table: {}",
        trained.stdout
    );
    let run = sandbox.list("runs/smallest");
    for name in ["checkpoints", "config.toml", "metrics.jsonl", "samples"] {
        assert!(run.contains(&name.to_string()), "{run:?}");
    }
    assert!(run.iter().any(|name| name.contains("tfevents")), "{run:?}");

    let metrics = fs::read_to_string(sandbox.path("runs/smallest/metrics.jsonl")).expect("metrics");
    let lines: Vec<serde_json::Value> = metrics
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    assert_eq!(
        lines.iter().filter(|line| line["loss"].is_number()).count(),
        40
    );
    assert_eq!(
        lines
            .iter()
            .filter(|line| line["val_loss"].is_number())
            .count(),
        4
    );
    for key in [
        "step",
        "lr",
        "lr_unet",
        "grad_norm",
        "loss_diffusion",
        "time",
    ] {
        assert!(lines[0][key].is_number(), "{key} in {}", lines[0]);
    }
    let first = lines[0]["loss"].as_f64().expect("a loss");
    let last = lines[lines.len() - 2]["loss"].as_f64().expect("a loss");
    assert!(last < first, "the loss falls: {first} to {last}");

    let phrase = &sandbox.list("set/motion")[0];
    let sample = |out: &str| {
        let settings = "--steps 5 --frames 20 --seed 1";
        let phrase = format!("--source set --item {phrase}");
        let finished = sandbox.run(&format!(
            "sample runs/smallest --out {out} {phrase} {settings}"
        ));
        finished.succeeded();
        read_motion(&sandbox.path(format!("{out}.npy"))).expect("a motion")
    };
    let motion = sample("dance");
    assert_eq!(motion.frames(), 20);
    assert_eq!(sample("again"), motion, "the seed decides the sample");
    let raw = read_motion(&sandbox.path("dance.raw.npy")).expect("a motion");
    assert_ne!(
        motion, raw,
        "post-processing changes a young model's sample"
    );

    let features = format!("set/audio_features/{phrase}/features.npz");
    let guided = "--guidance-scale 3 --set sampling.sampler.kind=ddpm";
    for names in ["one", "d --count 3"] {
        let sample = format!("sample runs/smallest --audio-features {features} --steps 4 {guided}");
        sandbox.run(&format!("{sample} --out {names}")).succeeded();
    }
    assert!(sandbox.path("d-002.raw.npy").exists());
    for kind in ["npy", "raw.npy"] {
        let bytes = |name: &str| fs::read(sandbox.path(format!("{name}.{kind}"))).expect("a file");
        assert!(
            bytes("one") == bytes("d-000"),
            "{kind}: alone as in a batch"
        );
        assert!(bytes("d-000") != bytes("d-001"));
    }

    sandbox.run("plot dance.npy --out dance.svg").succeeded();
    sandbox
        .run("plot runs/smallest --out losses.svg")
        .succeeded();
    for picture in ["dance.svg", "losses.svg"] {
        let svg = fs::read_to_string(sandbox.path(picture)).expect("a picture");
        assert!(
            svg.starts_with("<svg") && svg.contains("<polyline"),
            "{picture}"
        );
    }

    let checked = sandbox.run("check set/motion --source set").succeeded();
    assert!(
        checked.stdout.contains("10 of 10 pass"),
        "{}",
        checked.stdout
    );
    let json =
        sandbox.run("check set/motion dance.npy --profile strict --run runs/smallest --json");
    let report: serde_json::Value = serde_json::from_str(&json.stdout).expect("JSON");
    assert_eq!(report["files"].as_array().expect("files").len(), 11);
    assert_eq!(
        report["files"][10]["passed"].as_bool(),
        Some(json.code == Some(0))
    );
    // Without statistics the bounds are those of captured people.
    let alone = sandbox.run("check set/motion").stdout;
    assert!(
        alone.contains("captured people") && alone.contains("height"),
        "{alone}"
    );
}

/// The lines of a shown config without the origins of the values.
fn values(shown: &str) -> Vec<&str> {
    let value = |line| str::rsplit_once(line, "  # ").map_or(line, |(value, _)| value);
    shown.lines().map(value).collect()
}

#[test]
fn every_shipped_config_is_valid() {
    let sandbox = sandbox();
    let configs = fs::read_dir(workspace().join("configs")).expect("configs");
    // The initial checkpoints of the fine-tuning configs, under their names there.
    sandbox.write("c.toml", SMALLEST);
    for (name, settings) in [
        ("phrases", "train.max_steps=1"),
        (
            "decoder",
            "train.recipe=decoder --set init.diffusion=runs/phrases --set train.max_steps=1",
        ),
    ] {
        sandbox
            .run(&format!("train c.toml --name {name} --set {settings}"))
            .succeeded();
    }
    let mut seen = 0;
    for config in configs {
        let path = config.expect("an entry").path();
        if path.is_dir() {
            // The configs of the sources have a test of their own.
            continue;
        }
        let plans = [("prepare.toml", "captures"), ("bodies.toml", "bandai")];
        if let Some((_, captures)) = plans.iter().find(|(plan, _)| path.ends_with(plan)) {
            // A plan without its captures.
            let plan = format!("data prepare {}", path.display());
            sandbox.run(&plan).failed(2, &[captures]);
            seen += 1;
            continue;
        }
        if path.ends_with("goal.toml") || path.ends_with("compose.toml") {
            // Goals and prompt files have tests of their own.
            seen += 1;
            continue;
        }
        let show = format!("config show {} --set data.source=set", path.display());
        let shown = sandbox.run(&show).succeeded();
        assert!(shown.stdout.starts_with("# model: "), "{}", shown.stdout);
        // The printed config is valid and equal, but for the origins of its values.
        sandbox.write("shown.toml", &shown.stdout);
        let again = sandbox.run("config show shown.toml").succeeded().stdout;
        assert_eq!(values(&again), values(&shown.stdout));
        seen += 1;
    }
    assert!(seen >= 2);
}

#[test]
fn the_named_sizes_have_the_documented_numbers_of_parameters() {
    let sandbox = sandbox();
    for (size, parameters) in [
        ("small", "16,342,361"),
        ("base", "225,084,185"),
        ("cc116m", "104,436,505"),
    ] {
        sandbox.write(
            "size.toml",
            format!("[data]\nkind = \"synthetic\"\n[model]\nsize = \"{size}\"\n"),
        );
        let shown = sandbox.run("config show size.toml").succeeded();
        assert!(
            shown
                .stdout
                .starts_with(&format!("# model: {parameters} parameters")),
            "{size}: {}",
            shown.stdout
        );
    }
}

/// Each recipe's losses with and without the kernels are equal up to rounding.
#[test]
fn kernels_change_no_loss() {
    let sandbox = sandbox();
    let fine_tuning = "--set train.recipe=e2e --set init.pretrain.diffusion_steps=3 \
        --set init.pretrain.decoder_steps=3 --set decoder.hidden_dim=32 --set rollout.steps=2";
    for (name, settings) in [("diffusion", ""), ("e2e", fine_tuning)] {
        let [fused, composed] = ["fused", "composed"].map(|kernels| {
            let runs = format!("{name}-{kernels}");
            let settings = format!("train c.toml --set train.max_steps=4 {settings}");
            let arguments = format!("{settings} --set model.dropout=0.2 --runs-dir {runs}");
            let mut train = sandbox.command(arguments.split_whitespace());
            train.env("KINEGRAD_KERNELS", kernels);
            finish(train).succeeded();
            losses(&sandbox.path(format!("{runs}/smallest/metrics.jsonl")))
        });
        assert!(fused.len() >= 4, "{name}: {fused:?}");
        assert_eq!(fused.len(), composed.len());
        for (fused, composed) in fused.iter().zip(composed) {
            let error = (fused - composed).abs() / composed;
            assert!(error < 1e-4, "{name}: {fused} instead of {composed}");
        }
    }
}

fn losses(metrics: &Path) -> Vec<f64> {
    let text = fs::read_to_string(metrics).expect("metrics");
    let records = text
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).expect("JSON"));
    records
        .filter_map(|record| record["loss"].as_f64())
        .collect()
}
