//! Every record of a sample describes a command that reproduces its files.

use std::collections::BTreeSet;
use std::fs;

use kinegrad_data::Digest;
use kinegrad_data::humanml::write_walks;
use kinegrad_tests::sandbox::{SMALLEST, Sandbox, contents, smallest_walks_on_disk};
use serde_json::Value;

/// Two goals of different lengths and numbers of keyframes.
const GOALS: [&str; 2] = [
    "frames = 16\n[[keyframe]]\nframe = 8\nx = 0.1\nz = 0.4\n",
    "frames = 12\n[[keyframe]]\nframe = 5\nx = 0.2\nz = 0.3\n[[keyframe]]\nframe = 11\nx = 0.0\n\
     z = 0.6\n",
];

/// `--set` of every key below `table`.
fn settings(table: &str, value: &Value, arguments: &mut Vec<String>) {
    match value {
        Value::Object(fields) => {
            for (key, value) in fields {
                settings(&format!("{table}.{key}"), value, arguments);
            }
        }
        Value::Null => {}
        value => arguments.extend(["--set".into(), format!("{table}={value}")]),
    }
}

/// The command of a record, and the suffix of the sample's files among its outputs.
fn described(record: &Value) -> (Vec<String>, String) {
    let text = |value: &Value| value.as_str().map(String::from);
    let mut arguments = vec![
        "sample".into(),
        text(&record["checkpoint"]).expect("a path"),
    ];
    let mut give = |option: &str, value: String| arguments.extend([option.into(), value]);
    let condition = &record["condition"];
    for (value, option) in [
        (&condition["item"]["id"], "--item"),
        (&condition["item"]["source"], "--source"),
        (&condition["audio_features"], "--audio-features"),
        (&condition["trajectory"]["checkpoint"], "--trajectory-run"),
        (&condition["text"]["text"], "--text"),
        (&condition["text"]["text_encoder"], "--text-encoder"),
        (&condition["text_embedding"], "--text-embedding"),
    ] {
        if let Some(value) = text(value) {
            give(option, value);
        }
    }
    let index = record["index"].as_u64().expect("a number");
    let (count, clips) = match &record["batch"] {
        Value::Null => {
            give("--frames", record["frames"].to_string());
            (index + 1, index + 1)
        }
        batch => {
            let goals = batch["goals"].as_array().expect("goals");
            for goal in goals {
                give("--goal", text(&goal["file"]).expect("a path"));
            }
            let count = batch["count"].as_u64().expect("a number");
            (count, count * goals.len() as u64)
        }
    };
    give("--count", count.to_string());
    give("--seed", record["seed"].to_string());
    let mut sampler = record["sampler"].as_object().expect("settings").clone();
    for key in ["clip", "precision"] {
        let value = sampler.remove(key).expect("a setting");
        settings(&format!("sampling.{key}"), &value, &mut arguments);
    }
    if let Some(padding) = sampler.remove("padding") {
        settings("steering.padding", &padding, &mut arguments);
    }
    if let Some(steering) = sampler.remove("steering") {
        settings("steering", &steering, &mut arguments);
    }
    settings("sampling.sampler", &Value::from(sampler), &mut arguments);
    if record["weights"] == "model" {
        arguments.push("--no-ema".into());
    }
    let suffix = match clips {
        1 => String::new(),
        _ => format!("-{index:03}"),
    };
    (arguments, suffix)
}

/// Repeats the sampling of each record below `folder`, and compares all files.
fn redraw(sandbox: &Sandbox, folder: &str) -> Vec<Value> {
    let files = contents(&sandbox.path(folder));
    let mut records = Vec::new();
    let mut bytes = BTreeSet::new();
    for (name, text) in &files {
        let Some(stem) = name.strip_suffix(".json") else {
            continue;
        };
        let record: Value = serde_json::from_slice(text).expect("JSON");
        let (mut arguments, suffix) = described(&record);
        let out = format!("again/{folder}/{stem}");
        let others = ["--out", &out, "-q", "--allow-unusable"];
        arguments.extend(others.map(String::from));
        kinegrad_tests::sandbox::finish(sandbox.command(&arguments)).succeeded();
        let own: Vec<_> = files
            .iter()
            .filter_map(|(other, bytes)| Some((other.strip_prefix(stem)?, bytes)))
            .filter(|(rest, _)| rest.starts_with('.') && *rest != ".json")
            .collect();
        assert!(!own.is_empty(), "{name}");
        for (extension, expected) in own {
            let path = sandbox.path(format!("{out}{suffix}{extension}"));
            let drawn = fs::read(&path).expect("a file");
            assert!(drawn == *expected, "{stem}{extension}: {arguments:?}");
            if extension == ".npy" {
                assert!(bytes.insert(drawn), "{name} is like another sample");
            }
        }
        records.push(record);
    }
    records
}

#[test]
fn phrases_are_drawn_again_from_their_records() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST.replace("phrases = 12", "phrases = 30"));
    sandbox
        .run(
            "train c.toml --set train.max_steps=2 --set optim.warmup_steps=1 --set run.seed=9 \
             --set sampling.count_at_end=3 --set sampling.sampler.num_inference_steps=4",
        )
        .succeeded();
    let at_end = redraw(&sandbox, "runs/smallest/samples");
    assert_eq!(at_end.len(), 3);
    assert!(at_end.iter().all(|record| record["seed"] == 9));
    for draw in [
        "--out drawn/one --seed 4 --steps 3",
        "--out drawn/some --item synthetic_0000* --count 2 --frames 21 --no-ema",
        "--out drawn/others --item synthetic_0001* --frames 30 --guidance-scale 1.5 \
         --set sampling.clip=six --set sampling.sampler.kind=ddpm",
    ] {
        sandbox
            .run(&format!("sample runs/smallest {draw}"))
            .succeeded();
    }
    assert_eq!(redraw(&sandbox, "drawn").len(), 1 + 20 + 10);
}

#[test]
fn clips_are_drawn_again_from_their_records() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    write_walks(&sandbox.path("walks"), 60, 48, 3).expect("walks");
    sandbox.write("c.toml", smallest_walks_on_disk());
    for (goal, file) in GOALS.iter().zip(["a.toml", "b.toml"]) {
        sandbox.write(file, goal);
    }
    for recipe in ["gmd_motion", "gmd_trajectory"] {
        sandbox
            .run(&format!(
                "train c.toml --name {recipe} --set train.recipe={recipe} --set train.max_steps=2 \
                 --set optim.warmup_steps=1 --set sampling.count_at_end=3 --set run.seed=9 \
                 --set sampling.sampler.guidance_scale=2.5"
            ))
            .succeeded();
        let at_end = redraw(&sandbox, &format!("runs/{recipe}/samples"));
        assert_eq!(at_end.len(), 3);
    }
    let listed = fs::read_to_string(sandbox.path("walks/train.txt")).expect("a list");
    let clip = listed.lines().next().expect("a clip");
    let ten = format!("{}*", &clip[..clip.len() - 1]);
    for draw in [
        "--out drawn/free --count 3 --frames 12 --seed 2".to_string(),
        "--out drawn/whole --frames 12 --seed 5 --set steering.padding=sampled".to_string(),
        format!(
            "--out drawn/told --text-embedding walks/text_embeddings.safetensors#{clip} --count 2"
        ),
        format!("--out drawn/some --source walks --item {ten} --count 2 --frames 13"),
        "--out drawn/led --goal a.toml --goal b.toml --count 2 --steps 5".to_string(),
        "--out drawn/staged --goal b.toml --trajectory-run runs/gmd_trajectory --seed 3"
            .to_string(),
    ] {
        sandbox
            .run(&format!("sample runs/gmd_motion {draw}"))
            .succeeded();
    }
    let records = redraw(&sandbox, "drawn");
    assert_eq!(records.len(), 3 + 1 + 2 + 20 + 4 + 1);
    // A goal is identified by its contents, not by its path.
    let mut goals = records
        .iter()
        .filter(|record| record["condition"]["goal"].is_object());
    assert_eq!(goals.clone().count(), 5);
    assert!(goals.all(|record| {
        let file = record["condition"]["goal"]["file"]
            .as_str()
            .expect("a path");
        let digest = Digest::of(&fs::read(sandbox.path(file)).expect("a goal"));
        record["condition"]["goal"]["sha256"] == digest.to_string()
    }));
    sandbox
        .run("sample runs/gmd_motion --item nobody --out x")
        .failed(2, &["the dataset has no clip `nobody`", "it has `"]);
    sandbox
        .run(&format!(
            "sample runs/gmd_motion --item {clip} --goal a.toml --out x"
        ))
        .failed(2, &["`--item` with `--goal`"]);
}
