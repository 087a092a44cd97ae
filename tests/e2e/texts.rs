//! Prompts: their embeddings by CLIP's text encoder, and samples conditioned on them.

use std::fs;
use std::path::PathBuf;

use kinegrad_data::humanml::write_walks;
use kinegrad_tests::golden::workspace;
use kinegrad_tests::sandbox::{Finished, Sandbox, finish, smallest_walks_on_disk};
use serde_json::Value;

/// The text encoder of the fixtures: random weights, 694 tokens.
fn clip() -> PathBuf {
    workspace().join("data_fixtures/clip")
}

/// An empty folder with a copy of the encoder in `clip`.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    for name in [
        "config.json",
        "model.safetensors",
        "vocab.json",
        "merges.txt",
    ] {
        let bytes = fs::read(clip().join(name)).expect("a fixture");
        sandbox.write(&format!("clip/{name}"), bytes);
    }
    sandbox
}

fn run(sandbox: &Sandbox, arguments: &[&str]) -> Finished {
    finish(sandbox.command(arguments))
}

/// Name and shape of each tensor of a file, and the numbers of all.
fn tensors(sandbox: &Sandbox, file: &str) -> Vec<(String, Vec<usize>, Vec<u8>)> {
    let bytes = fs::read(sandbox.path(file)).expect("a file");
    let all = safetensors::SafeTensors::deserialize(&bytes).expect("tensors");
    let each = all.iter().map(|(name, tensor)| {
        let shape = tensor.shape().to_vec();
        (name.to_owned(), shape, tensor.data().to_vec())
    });
    let mut each: Vec<_> = each.collect();
    each.sort();
    each
}

const WALK: &str = "a person walks in a circle";
const JUMP: &str = "someone is jumping";

#[test]
fn sentences_become_rows() {
    let sandbox = sandbox();
    let embed = ["text", "embed", "--text-encoder", "clip", "--out"];
    let said = run(
        &sandbox,
        &[&embed[..], &["two.safetensors", WALK, JUMP]].concat(),
    );
    let said = said.succeeded().stdout;
    assert!(said.contains("two.safetensors: 2 embeddings"), "{said}");
    let two = tensors(&sandbox, "two.safetensors");
    let [(name, shape, values)] = &two[..] else {
        panic!("{two:?}");
    };
    assert_eq!((name.as_str(), &shape[..]), ("text", &[2, 512][..]));
    assert!(values[..2048] != values[2048..]);
    // The same from a file, with lines that are not prompts.
    sandbox.write("lines.txt", format!("\u{feff}{WALK}\r\n\n  {JUMP}  \n"));
    let of_file = [&embed[..], &["file.safetensors", "--file", "lines.txt"]].concat();
    run(&sandbox, &of_file).succeeded();
    assert_eq!(tensors(&sandbox, "file.safetensors"), two);

    let again = [&embed[..], &["two.safetensors", JUMP]].concat();
    run(&sandbox, &again).failed(2, &["two.safetensors exists already", "--overwrite"]);
    run(&sandbox, &[&again[..], &["--overwrite"]].concat()).succeeded();
    assert_eq!(tensors(&sandbox, "two.safetensors")[0].1, [1, 512]);
}

#[test]
fn a_dataset_is_embedded_trained_on_and_asked_in_words() {
    let sandbox = sandbox();
    let walks = sandbox.path("walks");
    write_walks(&walks, 8, 48, 3).expect("walks");
    let embeddings = "walks/text_embeddings.safetensors";
    let given = tensors(&sandbox, embeddings);
    fs::remove_file(sandbox.path(embeddings)).expect("a file");
    let embed =
        "text embed --text-encoder clip --dataset walks --out walks/text_embeddings.safetensors";
    sandbox.run(embed).succeeded();
    // The same clips with as many captions; no two rows are equal.
    let found = tensors(&sandbox, embeddings);
    let sizes = |all: &[(String, Vec<usize>, Vec<u8>)]| -> Vec<(String, Vec<usize>)> {
        let each = all.iter();
        each.map(|(name, shape, _)| (name.clone(), shape.clone()))
            .collect()
    };
    assert_eq!(sizes(&found), sizes(&given));
    assert!(found.len() == 8 && found[0].2[..2048] != found[0].2[2048..4096]);

    sandbox.write("c.toml", smallest_walks_on_disk());
    sandbox
        .run("train c.toml --set train.max_steps=20")
        .succeeded();
    let draw = [
        "sample",
        "runs/smallest",
        "--steps",
        "3",
        "--overwrite",
        "--out",
        "drawn",
    ];
    let drawn = |options: &[&str]| {
        run(&sandbox, &[&draw[..], options].concat()).succeeded();
        fs::read(sandbox.path("drawn.npy")).expect("a motion")
    };
    let told = drawn(&["--text", WALK, "--text-encoder", "clip"]);
    let record = fs::read(sandbox.path("drawn.json")).expect("a record");
    let record: Value = serde_json::from_slice(&record).expect("JSON");
    assert_eq!(record["condition"]["text"]["text"], WALK);
    assert_eq!(record["condition"]["text"]["text_encoder"], "clip");
    assert!(told != drawn(&["--text", JUMP, "--text-encoder", "clip"]));
    assert!(told != drawn(&[]));
    // The same as with a precomputed embedding.
    let one = [
        "text",
        "embed",
        "--text-encoder",
        "clip",
        "--out",
        "one.safetensors",
        WALK,
    ];
    run(&sandbox, &one).succeeded();
    assert!(told == drawn(&["--text-embedding", "one.safetensors#text"]));

    let no_clip = [&draw[..], &["--text", WALK]].concat();
    run(&sandbox, &no_clip).failed(2, &["`--text` without `--text-encoder`", "CLIP ViT-B/32"]);
    let no_text = [&draw[..], &["--text-encoder", "clip"]].concat();
    run(&sandbox, &no_text).failed(2, &["--text"]);
}

#[test]
fn what_is_no_text_encoder_is_refused_and_nothing_is_written() {
    let sandbox = sandbox();
    let embed = |folder: &str, texts: &[&str]| {
        let arguments = [
            "text",
            "embed",
            "--text-encoder",
            folder,
            "--out",
            "no.safetensors",
            WALK,
        ];
        run(&sandbox, &arguments).failed(2, texts);
        assert!(!sandbox.path("no.safetensors").exists());
    };
    embed(
        "nowhere",
        &["nowhere: there is no such folder", "config.json"],
    );
    fs::remove_file(sandbox.path("clip/model.safetensors")).expect("a file");
    embed("clip", &["clip: it has no model.safetensors"]);
    sandbox.write("clip/model.safetensors", "PK");
    embed("clip", &["clip/model.safetensors: no safetensors file"]);
    fs::remove_file(sandbox.path("clip/vocab.json")).expect("a file");
    embed("clip", &["no vocab.json with merges.txt"]);

    let embed = "text embed --text-encoder clip --out no.safetensors";
    sandbox.run(embed).failed(2, &["SENTENCE"]);
    sandbox
        .run(&format!("{embed} --dataset nowhere"))
        .failed(2, &["nowhere/texts"]);
    sandbox.write("empty.txt", "\n\n");
    sandbox
        .run(&format!("{embed} --file empty.txt"))
        .failed(2, &["empty.txt has no sentence"]);
}
