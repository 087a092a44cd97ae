//! Style: conditions in training and sampling, and refusals.

use std::fs;

use kinegrad_tests::captures::{self, PLAN, wav};
use kinegrad_tests::sandbox::{SMALLEST, SMALLEST_WALKS, Sandbox, finish};
use serde_json::{Value, json};

/// Labels of most phrases; some have none, and the held-out phrase has its own.
const LABELS: &str = "
[data.labels]
\"*0\" = \"waltz\"
\"*1\" = \"tango\"
\"*5\" = \"tango\"
\"*4\" = \"slow waltz\"
\"*3\" = \"rumba\"
\"*_00010\" = \"\"
";

/// Eight numbers in the range of synthetic dances.
const NUMBERS: &str = "0.8,0.3,0.5,0.1,0.6,0.2,-0.1,0.15";

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", format!("{SMALLEST}{LABELS}"));
    sandbox.write("song.wav", wav(3));
    sandbox
}

fn trained(settings: &str) -> Sandbox {
    let sandbox = sandbox();
    let train = format!("train c.toml --set train.max_steps=6 {settings}");
    sandbox.run(&train).succeeded();
    sandbox
}

fn bytes(sandbox: &Sandbox, file: &str) -> Vec<u8> {
    fs::read(sandbox.path(file)).expect("a file")
}

fn record(sandbox: &Sandbox, file: &str) -> Value {
    serde_json::from_slice(&bytes(sandbox, file)).expect("JSON")
}

fn state(sandbox: &Sandbox, run: &str) -> Value {
    let step = sandbox.list(&format!("runs/{run}/checkpoints"));
    let step = step.iter().rfind(|name| name.starts_with("step-"));
    let step = step.expect("a checkpoint");
    record(
        sandbox,
        &format!("runs/{run}/checkpoints/{step}/state.json"),
    )
}

/// Samples with these options and returns the raw motion.
fn drawn(sandbox: &Sandbox, run: &str, options: &str) -> Vec<u8> {
    let draw = format!("sample runs/{run} --frames 20 --steps 3 --overwrite --out drawn {options}");
    sandbox.run(&draw).succeeded();
    bytes(sandbox, "drawn.raw.npy")
}

#[test]
fn a_sample_has_the_style_that_it_is_asked_for() {
    let sandbox = sandbox();
    let train = "train c.toml --set train.max_steps=6 --set model.style=both";
    let told = sandbox.run(train).succeeded().stderr;
    for expected in [
        "6 of 10 training phrases have no label",
        "held-out phrases have the label `rumba`",
    ] {
        assert!(told.contains(expected), "{told}");
    }
    let labels = json!(["slow waltz", "tango", "waltz"]);
    assert_eq!(
        state(&sandbox, "smallest")["config"]["model"]["style_labels"],
        labels
    );
    let of = |options: &str| drawn(&sandbox, "smallest", options);
    let numbers = format!("--style {NUMBERS}");
    let others = "--style 0.1,0.3,0.5,0.1,0.6,0.2,-0.1,0.15";
    let all = [
        of(""),
        of("--style waltz"),
        of("--style tango"),
        of(&numbers),
        of(others),
    ];
    for one in 0..all.len() {
        for other in 0..one {
            assert_ne!(all[one], all[other], "{one} {other}");
        }
    }
    // The same sample again, and its record.
    assert_eq!(of("--style waltz"), all[1]);
    let said = record(&sandbox, "drawn.json");
    assert_eq!(said["condition"]["style"], "waltz");
    assert_eq!(said["sampler"]["style_guidance_scale"], Value::Null);
    assert_eq!(of(&numbers), all[3]);
    let said = record(&sandbox, "drawn.json");
    assert_eq!(said["condition"]["style"][6], -0.1);
    assert_eq!(said["condition"]["style"].as_array().map(Vec::len), Some(8));
    of("");
    assert!(
        record(&sandbox, "drawn.json")["condition"]
            .get("style")
            .is_none()
    );

    // A separate guidance scale: equal to the common one, zero, larger.
    let guided = of("--style waltz --guidance-scale 2");
    let scale = |style: &str| of(&format!("--style waltz --guidance-scale 2 {style}"));
    assert_eq!(scale("--style-guidance-scale 2"), guided);
    assert_eq!(scale("--style-guidance-scale 0"), of("--guidance-scale 2"));
    assert_ne!(scale("--style-guidance-scale 5"), guided);
    assert_eq!(
        record(&sandbox, "drawn.json")["sampler"]["style_guidance_scale"],
        5.0
    );
    // Without a style it changes nothing.
    assert_eq!(of("--style-guidance-scale 5"), all[0]);
    // A sample does not depend on its batch.
    let draw = "sample runs/smallest --frames 20 --steps 3 --count 2 --style waltz --out two";
    sandbox.run(draw).succeeded();
    assert_eq!(bytes(&sandbox, "two-000.raw.npy"), all[1]);
}

#[test]
fn songs_that_are_drawn_whole_have_a_style() {
    let sandbox = trained("--set model.style=label");
    let song = |name: &str, style: &str| {
        let draw = format!("sample runs/smallest --audio song.wav --steps 2 --out {name} {style}");
        sandbox.run(&draw).succeeded();
        bytes(&sandbox, &format!("{name}.raw.npy"))
    };
    let (none, waltz, tango) = (
        song("none", ""),
        song("waltz", "--style waltz"),
        song("tango", "--style tango"),
    );
    assert!(none != waltz && waltz != tango);
    let said = record(&sandbox, "waltz.json");
    assert!(said["windows"]["count"].as_u64() > Some(1), "{said}");
    assert_eq!(said["condition"]["style"], "waltz");
    song("guided", "--style waltz --style-guidance-scale 3");
    assert_ne!(bytes(&sandbox, "guided.raw.npy"), waltz);
}

#[test]
fn wrong_styles_are_refused_and_leave_nothing() {
    let sandbox = trained("--set model.style=label");
    let numbers_only = "--name numbers --set model.style=numbers";
    let train = format!("train c.toml --set train.max_steps=2 {numbers_only}");
    sandbox.run(&train).succeeded();
    sandbox
        .run("train c.toml --name plain --set train.max_steps=2")
        .succeeded();
    let before = sandbox.list(".");
    let seven = "1,2,3,4,5,6,7";
    let not_finite = "1,2,3,4,5,6,7,inf";
    for (run, options, expected) in [
        (
            "smallest",
            "--style rumba".to_string(),
            ["`rumba`", "it knows `slow waltz`, `tango`, `waltz`"],
        ),
        (
            "smallest",
            format!("--style {NUMBERS}"),
            ["numbers", "\"label\""],
        ),
        (
            "numbers",
            "--style waltz".into(),
            ["a label", "\"numbers\""],
        ),
        (
            "numbers",
            format!("--style {seven}"),
            ["7 numbers found", "eight numbers"],
        ),
        (
            "numbers",
            format!("--style {seven},8,9"),
            ["9 numbers found", "eight numbers"],
        ),
        (
            "numbers",
            format!("--style {not_finite}"),
            ["inf is not finite", "eight numbers"],
        ),
        (
            "numbers",
            "--style 1,2,x".into(),
            ["`x` is not a number", "eight numbers"],
        ),
        (
            "plain",
            "--style waltz".into(),
            ["\"none\"", "train with `model.style`"],
        ),
        (
            "plain",
            "--style-guidance-scale 2".into(),
            ["sampling.sampler.style_guidance_scale", "model.style"],
        ),
        (
            "smallest",
            "--style-guidance-scale -1".into(),
            ["style_guidance_scale", "-1"],
        ),
    ] {
        sandbox
            .run(&format!("sample runs/{run} {options} --out wrong"))
            .failed(2, &expected);
        assert_eq!(sandbox.list("."), before, "{options}");
    }
    for (settings, expected) in [
        (
            "--set data.labels={} --set model.style=label",
            "no training phrase has one",
        ),
        ("--set model.style=loud", "loud"),
        (
            "--set model.style=both --set diffusion.style_drop_prob=0.5",
            "style_drop_prob",
        ),
        ("--set diffusion.style_drop_prob=0.2", "model.style"),
        ("--set model.style_labels=[\"a\"]", "model.style_labels"),
        (
            "--set model.style=label --set model.style_labels=[\"waltz\"]",
            "`slow waltz`",
        ),
    ] {
        sandbox
            .run(&format!("train c.toml --name wrong {settings}"))
            .failed(2, &[expected]);
        assert!(!sandbox.path("runs/wrong").exists(), "{settings}");
    }
    let walks = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    walks.write("c.toml", SMALLEST_WALKS);
    walks
        .run("train c.toml --set train.max_steps=2")
        .succeeded();
    walks
        .run("sample runs/smallest --style waltz --out wrong")
        .failed(2, &["--style", "a run of recipe `gmd_motion`"]);
    walks
        .run("train c.toml --name wrong --set sampling.sampler.style_guidance_scale=2")
        .failed(2, &["style_guidance_scale", "no style"]);
}

#[test]
fn style_is_fine_tuned_and_merged() {
    let sandbox = trained("--name base --set model.style=both --set diffusion.style_drop_prob=0.2");
    let tune = "train c.toml --set train.recipe=e2e --set init.diffusion=runs/base \
                --set decoder.hidden_dim=32 --set rollout.steps=2 --set train.max_steps=3 \
                --set rollout.guidance_scale=1.5 --set rollout.style_guidance_scale=2";
    let settings = "--set lora.rank=2 --set lora.targets=[\"conditioning\",\"attention\"]";
    for mode in ["checkpointed", "full", "last_k"] {
        let run = format!("{tune} --name {mode} --set rollout.mode={mode} {settings}");
        sandbox.run(&run).succeeded();
    }
    // Recomputing each step gives the weights of one graph over all steps, up to rounding. This
    // test only requires that both train the style.
    let tuned = state(&sandbox, "full");
    let base = state(&sandbox, "base");
    for key in ["style", "style_labels"] {
        assert_eq!(tuned["config"]["model"][key], base["config"]["model"][key]);
    }
    let [waltz, tango] =
        ["waltz", "tango"].map(|style| drawn(&sandbox, "full", &format!("--style {style}")));
    assert_ne!(waltz, tango);
    sandbox.run("merge runs/full --out runs/merged").succeeded();
    let merged =
        ["waltz", "tango"].map(|style| drawn(&sandbox, "merged", &format!("--style {style}")));
    assert_ne!(merged[0], merged[1]);
    sandbox
        .run("sample runs/merged --style foxtrot --out wrong")
        .failed(2, &["`slow waltz`, `tango`, `waltz`"]);
    // A dance unknown to the base.
    sandbox.write(
        "other.toml",
        format!("{SMALLEST}\n[data.labels]\n\"*1\" = \"rumba\"\n"),
    );
    let other = tune.replace("c.toml", "other.toml");
    sandbox
        .run(&format!("{other} --name other"))
        .failed(2, &["`rumba`", "`slow waltz`, `tango`, `waltz`"]);
}

#[test]
fn dropping_all_styles_and_having_none_are_told_apart_by_the_metrics() {
    // Style and style dropout change the loss; without style nothing does.
    let losses = |settings: &str| {
        let sandbox = trained(settings);
        let text = fs::read_to_string(sandbox.path("runs/smallest/metrics.jsonl"));
        let lines = text.expect("metrics");
        let lines = lines
            .lines()
            .map(|line| -> Value { serde_json::from_str(line).expect("JSON") });
        lines.map(|line| line["loss"].clone()).collect::<Vec<_>>()
    };
    let none = losses("");
    let kept = losses("--set model.style=numbers --set diffusion.style_drop_prob=0");
    let dropped = losses("--set model.style=numbers --set diffusion.style_drop_prob=0.3");
    assert!(none != kept && kept != dropped);
}

#[test]
fn labels_of_a_plan_are_those_of_the_manifest_and_train() {
    let sandbox = sandbox();
    captures::write(&sandbox);
    let labelled = PLAN.replacen("[[take]]", "[[take]]\nlabel = \"waltz\"", 1);
    sandbox.write("labelled.toml", &labelled);
    sandbox.write("c.toml", SMALLEST);
    sandbox.run("data prepare labelled.toml").succeeded();
    let chosen = |condition: &str| {
        let mut command =
            sandbox.command(["data", "inspect", "set", "--json", "--where", condition]);
        command.stdin(std::process::Stdio::null());
        let found = finish(command).succeeded().stdout;
        serde_json::from_str::<Vec<String>>(&found).expect("a list of ids")
    };
    let (waltz, all) = (chosen("label = waltz"), chosen("frames > 0"));
    assert!(!waltz.is_empty() && waltz.len() < all.len(), "{waltz:?}");
    let train = "train c.toml --set data.kind=phrases --set data.source=set \
                 --set train.max_steps=2 --set model.style=label";
    sandbox.run(train).succeeded();
    assert_eq!(
        state(&sandbox, "smallest")["config"]["model"]["style_labels"],
        json!(["waltz"])
    );
    for bad in ["a,b", "7", ""] {
        let text = labelled.replace("\"waltz\"", &format!("\"{bad}\""));
        sandbox.write("bad.toml", text);
        sandbox
            .run("data prepare bad.toml")
            .failed(2, &["`take[0].label`", "without a comma"]);
    }
}
