//! Text-motion evaluators: trained, evaluated, and used to measure models of clips.

use kinegrad_tests::sandbox::{SMALLEST_WALKS, Sandbox};
use serde_json::Value;

pub const EVALUATOR: &str = r#"
[run]
name = "evaluator"
device = "cpu"
[data]
kind = "synthetic_walks"
target_frames = 40
batch_size = 8
num_workers = 0
[data.synthetic]
phrases = 80
frames = 48
[data.validation]
fraction = 0.5
[model]
size = "text_motion_tiny"
motion_state = 24
[words]
width = 12
[optim]
learning_rate = 3e-3
[train]
recipe = "text_motion"
max_steps = 60
[ema]
decay = 0.9
[checkpoint]
every_steps = 15
[validation]
every_steps = 20
"#;

fn report(sandbox: &Sandbox, command: &str) -> Value {
    let said = sandbox.run(command).succeeded().stdout;
    let report: Value = serde_json::from_str(&said).expect("JSON");
    report["evaluations"][0].clone()
}

#[test]
fn an_evaluator_learns_captions_and_measures_a_model_of_clips() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("e.toml", EVALUATOR);
    sandbox.run("train e.toml").succeeded();
    sandbox
        .run("train e.toml --name fresh --set train.max_steps=1 --set optim.learning_rate=1e-9")
        .succeeded();
    let number = |report: &Value, name: &str| report["real"][name].as_f64().expect("a number");
    let learned = report(&sandbox, "eval runs/evaluator --json");
    let fresh = report(&sandbox, "eval runs/fresh --json");
    for name in ["r_precision_top3", "caption_accuracy"] {
        let (learned, fresh) = (number(&learned, name), number(&fresh, name));
        assert!(
            learned > fresh + 0.1,
            "{name}: {learned}, untrained {fresh}"
        );
    }
    let samples = learned["real"]["samples"].as_u64().expect("a count");
    assert!(samples >= 32, "{samples}: a whole pool");

    // A model of the same clips, measured by it.
    sandbox.write("c.toml", SMALLEST_WALKS);
    let same = "--set data.synthetic.phrases=80 --set data.validation.fraction=0.5 \
                --set data.target_frames=40 --set model.padded_frames=44";
    sandbox
        .run(&format!("train c.toml --set train.max_steps=2 {same}"))
        .succeeded();
    let eval = "eval runs/smallest --json --steps 2 --set evaluation.goals=33 \
                --set evaluation.variety_clips=2 --set evaluation.variety_repeats=3 \
                --set evaluation.keyframes=0 --set evaluation.evaluator.run=runs/evaluator";
    let measured = report(&sandbox, eval);
    let of = |side: &str| {
        measured["text_motion"][side]["r_precision_top3"]
            .as_f64()
            .expect("some")
    };
    // After two training steps, samples do not match captions.
    assert!(
        of("real") > of("sampled"),
        "{} {}",
        of("real"),
        of("sampled")
    );
    assert_eq!(measured["text_motion"]["real"]["samples"], 33);

    let variety = &measured["variety"];
    assert_eq!(
        (&variety["conditions"], &variety["repeats"]),
        (&2.into(), &3.into())
    );
    for metric in ["trajectory_diversity", "multimodality"] {
        assert!(variety[metric].as_f64() > Some(0.0), "{metric}");
    }

    // Of several samples, the one whose motion is nearest to the caption of the item.
    let sample = "sample runs/smallest --item walk_00001 --steps 2 --allow-unusable --seed 3";
    let evaluator = "--set evaluation.evaluator.run=runs/evaluator";
    sandbox
        .run(&format!(
            "{sample} --best-of 4 --select-by text,checks --out best {evaluator}"
        ))
        .succeeded();
    let record = std::fs::read_to_string(sandbox.path("best.json")).expect("a record");
    let record: Value = serde_json::from_str(&record).expect("JSON");
    let scores: Vec<Vec<f64>> =
        serde_json::from_value(record["selection"]["scores"].clone()).expect("scores");
    let index = record["selection"]["selected"].as_u64().expect("a number") as usize;
    let nearest = scores
        .iter()
        .map(|scores| scores[0])
        .fold(f64::INFINITY, f64::min);
    assert_eq!(scores.len(), 4);
    assert_eq!(scores[index][0], nearest, "{scores:?}");
    assert_eq!(record["text_distance"].as_f64(), Some(nearest));
    assert!(
        scores.iter().any(|scores| scores[0] > nearest),
        "{scores:?}"
    );
    sandbox
        .run(&format!("{sample} --best-of 4 --select-by text --out none"))
        .failed(
            2,
            &[
                "`--select-by` is `text`",
                "no text-motion evaluator is configured",
            ],
        );

    let files = "eval runs/smallest --set evaluation.evaluator.run=runs/smallest";
    sandbox.run(files).failed(
        2,
        &["evaluation.evaluator.run", "gmd_motion", "text_motion"],
    );
    sandbox
        .run("sample runs/evaluator --out x")
        .failed(2, &["recipe `text_motion` generates nothing"]);
    for (settings, texts) in [
        (
            "data.humanml3d.root=absolute",
            ["data.humanml3d.root", "relative"],
        ),
        ("loss.margin=0", ["loss.margin", "more than 0"]),
        (
            "words.vectors=nowhere.safetensors",
            ["nowhere.safetensors", ""],
        ),
        (
            "sampling.count_at_end=2",
            ["sampling.count_at_end", "generates nothing"],
        ),
    ] {
        let command = format!("train e.toml --name bad --set {settings}");
        sandbox.run(&command).failed(2, &texts);
        assert!(!sandbox.path("runs/bad").exists(), "{settings}");
    }
}
