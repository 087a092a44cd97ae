//! Captions as labels: a model that learns an embedding of each of a few captions.

use std::fs;
use std::path::Path;

use kinegrad_data::humanml::write_walks;
use kinegrad_tests::sandbox::{Sandbox, smallest_walks_on_disk};
use serde_json::{Value, json};

/// Captions of the clips, in turn.
const CAPTIONS: [&str; 3] = ["a person walks.", "someone jumps", "a man sits down"];

const LABELS: &str = "--set data.humanml3d.text=labels";

/// A dataset of walks without embeddings, and a config that reads it.
fn dataset() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    let walks = sandbox.path("walks");
    write_walks(&walks, 14, 48, 3).expect("walks");
    fs::remove_file(walks.join("text_embeddings.safetensors")).expect("a file");
    for (index, id) in ids(&walks, "train.txt").iter().enumerate() {
        say(&walks, id, CAPTIONS[index % 3]);
    }
    for id in ids(&walks, "val.txt") {
        say(&walks, &id, CAPTIONS[1]);
    }
    sandbox.write("c.toml", smallest_walks_on_disk());
    sandbox
}

fn ids(walks: &Path, list: &str) -> Vec<String> {
    let text = fs::read_to_string(walks.join(list)).expect("a list");
    let ids: Vec<String> = text.lines().map(String::from).collect();
    assert!(!ids.is_empty(), "{list}");
    ids
}

fn say(walks: &Path, id: &str, caption: &str) {
    let line = format!("{caption}#a/DET#0.0#0.0\n");
    fs::write(walks.join(format!("texts/{id}.txt")), line).expect("a file of captions");
}

fn bytes(sandbox: &Sandbox, file: &str) -> Vec<u8> {
    fs::read(sandbox.path(file)).expect("a file")
}

fn json_of(sandbox: &Sandbox, file: &str) -> Value {
    serde_json::from_slice(&bytes(sandbox, file)).expect("JSON")
}

/// Samples with these options and returns the motion.
fn drawn(sandbox: &Sandbox, options: &str) -> Vec<u8> {
    let draw = format!("sample runs/smallest --steps 3 --overwrite --out drawn {options}");
    sandbox.run(&draw).succeeded();
    bytes(sandbox, "drawn.npy")
}

/// [`drawn`] for a text that may contain spaces.
fn told(sandbox: &Sandbox, text: &str) -> Vec<u8> {
    let draw = "sample runs/smallest --steps 3 --overwrite --out drawn --text";
    let arguments = draw.split(' ').chain([text]);
    kinegrad_tests::sandbox::finish(sandbox.command(arguments)).succeeded();
    bytes(sandbox, "drawn.npy")
}

#[test]
fn a_model_learns_the_captions_of_its_clips_and_is_asked_for_one() {
    let sandbox = dataset();
    let train = format!("train c.toml --set train.max_steps=6 {LABELS}");
    let said = sandbox.run(&train).succeeded().stderr;
    assert!(
        said.contains("an embedding of each of 3 captions"),
        "{said}"
    );
    let mut sorted = CAPTIONS;
    sorted.sort_unstable();
    let state = json_of(
        &sandbox,
        "runs/smallest/checkpoints/step-00000004/state.json",
    );
    assert_eq!(state["config"]["text"]["captions"], json!(sorted));
    let weights = bytes(
        &sandbox,
        "runs/smallest/checkpoints/step-00000004/model.safetensors",
    );
    let weights = safetensors::SafeTensors::deserialize(&weights).expect("weights");
    let table = weights.tensor("embed_captions.weight").expect("a table");
    assert_eq!(table.shape(), [3, 512]);

    let id = ids(&sandbox.path("walks"), "train.txt")[2].clone();
    let of_clip = drawn(&sandbox, &format!("--item {id} --frames 16"));
    assert!(of_clip != drawn(&sandbox, ""));
    // A sample needs no dataset.
    fs::remove_dir_all(sandbox.path("walks")).expect("a folder");
    let none = drawn(&sandbox, "");
    let all: Vec<Vec<u8>> = CAPTIONS.iter().map(|text| told(&sandbox, text)).collect();
    for one in 0..3 {
        assert!(all[one] != none && all[one] != all[(one + 1) % 3], "{one}");
    }
    assert!(all[0] == told(&sandbox, "  A person walks"));
    let record = json_of(&sandbox, "drawn.json");
    assert_eq!(record["condition"]["text"]["text"], "  A person walks");
}

#[test]
fn what_the_model_does_not_know_is_refused() {
    let sandbox = dataset();
    let train = format!("train c.toml --set train.max_steps=4 {LABELS}");
    sandbox.run(&train).succeeded();
    let sample = |options: &[&str]| {
        let draw = ["sample", "runs/smallest", "--out", "none"];
        let arguments = draw.iter().chain(options);
        kinegrad_tests::sandbox::finish(sandbox.command(arguments))
    };
    sample(&["--text", "someone jumped"]).failed(
        2,
        &[
            "`someone jumped` is not a caption",
            "did you mean `someone jumps`?",
            "`a man sits down`",
        ],
    );
    sandbox.write("e.safetensors", {
        let row = [0u8; 4 * 512];
        let view =
            safetensors::tensor::TensorView::new(safetensors::Dtype::F32, vec![1, 512], &row);
        safetensors::serialize([("a", view.expect("so many bytes"))], None).expect("a file")
    });
    sample(&["--text-embedding", "e.safetensors#a"]).failed(
        2,
        &[
            "data.humanml3d.text = \"labels\"",
            "name a caption with `--text`",
        ],
    );
    sample(&[
        "--text",
        "someone jumps",
        "--text-embedding",
        "e.safetensors#a",
    ])
    .failed(2, &["--text-embedding"]);

    // A model with embeddings, with another caption, and without captions.
    sandbox
        .run("train c.toml --name told --set train.max_steps=4")
        .succeeded();
    let draw = [
        "sample",
        "runs/told",
        "--out",
        "none",
        "--text",
        "someone jumps",
    ];
    kinegrad_tests::sandbox::finish(sandbox.command(draw)).failed(2, &["`--text`", "embedding"]);
    assert!(!sandbox.path("none.npy").exists());

    let walks = sandbox.path("walks");
    let held_out = ids(&walks, "val.txt")[0].clone();
    say(&walks, &held_out, "a bird flies");
    let refused = |name: &str, settings: &str, texts: &[&str]| {
        let train = format!("train c.toml --name {name} --set train.max_steps=4 {settings}");
        sandbox.run(&train).failed(2, texts);
        assert!(!sandbox.path(format!("runs/{name}")).exists());
    };
    let unknown = format!("clip `{held_out}` has the caption `a bird flies`");
    refused("odd", LABELS, &[&unknown, "no training clip has it"]);
    say(&walks, &held_out, CAPTIONS[0]);
    let known = "--set text.captions=[\"someone_jumps\"]";
    refused(
        "few",
        &format!("{LABELS} {known}"),
        &["has the caption `a man sits down`"],
    );
    refused("none", known, &["text.captions", "\"embeddings\""]);
    refused(
        "twice",
        &format!("{LABELS} --set text.captions=[\"a\",\"a\"]"),
        &["text.captions", "\"a\" twice"],
    );
    refused(
        "start",
        "--set init.diffusion=runs/smallest",
        &["text.captions", "3 captions", "init.diffusion"],
    );
    // The table of the initial checkpoint.
    sandbox
        .run(&format!(
            "train c.toml --name tuned --set train.max_steps=2 --set init.diffusion=runs/smallest \
             {LABELS}"
        ))
        .succeeded();
}

#[test]
fn a_stopped_training_goes_on_to_the_same_bytes() {
    let sandbox = dataset();
    let train = |rest: &str| {
        sandbox
            .run(&format!("train c.toml {LABELS} {rest}"))
            .succeeded()
    };
    train("--name whole --set train.max_steps=8");
    train("--name parts --set train.max_steps=4");
    train("--name parts --set train.max_steps=8 --resume");
    let files = [
        "model.safetensors",
        "ema.safetensors",
        "optimizer.safetensors",
    ];
    let mut compared = 0;
    for file in sandbox.list("runs/whole/checkpoints/step-00000008") {
        if !file.ends_with(".safetensors") {
            continue;
        }
        let of = |run: &str| {
            bytes(
                &sandbox,
                &format!("runs/{run}/checkpoints/step-00000008/{file}"),
            )
        };
        assert!(of("whole") == of("parts"), "{file}");
        compared += 1;
    }
    assert!(compared >= files.len() - 1, "{compared} files");
}
