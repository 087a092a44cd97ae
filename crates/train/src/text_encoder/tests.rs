use std::fs;
use std::path::{Path, PathBuf};

use super::*;

/// The fixture, or the folder in `KINEGRAD_CLIP`, which `scripts/peer/clip_fixtures.py` writes.
fn folder() -> PathBuf {
    match std::env::var_os("KINEGRAD_CLIP") {
        Some(folder) => folder.into(),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data_fixtures/clip"),
    }
}

fn encoder(folder: &Path) -> TextEncoder {
    TextEncoder::read(folder, &Device::flex()).expect("an encoder")
}

fn expected() -> (Vec<String>, Vec<Vec<u16>>) {
    let text = fs::read_to_string(folder().join("expected.json")).expect("a fixture");
    let value: Value = serde_json::from_str(&text).expect("JSON");
    let of = |key: &str| value[key].clone();
    let sentences: Vec<String> = serde_json::from_value(of("sentences")).expect("sentences");
    let tokens = serde_json::from_value(of("tokens")).expect("tokens");
    assert!(sentences.len() >= 30, "{}", sentences.len());
    (sentences, tokens)
}

fn no_progress(_: usize) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// A changed copy of the fixture.
fn changed(change: impl FnOnce(&Path)) -> tempfile::TempDir {
    let copy = tempfile::tempdir().expect("a folder");
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data_fixtures/clip");
    for name in [
        "config.json",
        "model.safetensors",
        "vocab.json",
        "merges.txt",
    ] {
        fs::copy(fixture.join(name), copy.path().join(name)).expect("a copy");
    }
    change(copy.path());
    copy
}

#[test]
fn golden_tokens_are_those_of_transformers() {
    let encoder = encoder(&folder());
    let (sentences, tokens) = expected();
    let mut lengths = std::collections::BTreeSet::new();
    for (sentence, tokens) in sentences.iter().zip(&tokens) {
        let found = encoder.tokens(sentence).expect("a sentence");
        assert_eq!(&found, tokens, "{sentence:?}");
        lengths.insert(tokens.len());
    }
    assert!(lengths.len() > 8 && lengths.contains(&2) && lengths.contains(&22));
}

#[test]
fn golden_embeddings_are_those_of_transformers() {
    let encoder = encoder(&folder());
    let (sentences, tokens) = expected();
    let bytes = fs::read(folder().join("expected.safetensors")).expect("a fixture");
    let tensors = SafeTensors::deserialize(&bytes).expect("tensors");
    let text = tensors.tensor("text").expect("embeddings");
    let [rows, stored] = *text.shape() else {
        panic!("{:?}", text.shape());
    };
    assert_eq!(rows, sentences.len());
    let expected = singles(text.data(), DType::F32).expect("float32");

    let texts: Vec<&str> = sentences.iter().map(String::as_str).collect();
    let mut reported = 0;
    let mut progress = |done| {
        reported = done;
        ControlFlow::Continue(())
    };
    let by_length = encoder.embed(&texts, &mut progress).expect("embeddings");
    assert_eq!(reported, rows);
    // All lengths in one batch.
    let all: Vec<&[u16]> = tokens.iter().map(Vec::as_slice).collect();
    let padded = encoder.network.forward(&all, &encoder.device);
    let padded = padded.try_into_vec_as::<f32>().expect("float32");
    let mut furthest = 0f32;
    for (row, expected) in expected.chunks(stored).enumerate() {
        let padded = &padded[row * TEXT_CHANNELS..][..TEXT_CHANNELS];
        for found in [&by_length[row][..], padded] {
            for (found, expected) in found.iter().zip(expected) {
                furthest = furthest.max((found - expected).abs());
            }
        }
    }
    println!("{rows} sentences, off by at most {furthest:e}");
    assert!(furthest < 1e-5, "{furthest}");
    let stop = encoder.embed(&texts, &mut |_| ControlFlow::Break(()));
    assert!(matches!(stop, Err(Error::Interrupted)));
}

#[test]
fn other_layouts_of_the_same_encoder_are_read() {
    let sentence = "a person walks in a circle";
    let embedded = |folder: &Path| {
        let all = encoder(folder).embed(&[sentence], &mut no_progress);
        all.expect("an embedding").remove(0)
    };
    let expected = embedded(changed(|_| {}).path());
    // One file of the tokenizer, with merges as texts or as lists.
    for lists in [false, true] {
        let whole = changed(|folder| {
            let vocab = json_of(&folder.join("vocab.json")).expect("JSON");
            let merges = fs::read_to_string(folder.join("merges.txt")).expect("merges");
            let merges = merges.lines().skip(1).map(|line| match lists {
                true => serde_json::json!(line.split(' ').collect::<Vec<_>>()),
                false => serde_json::json!(line),
            });
            let merges: Vec<Value> = merges.collect();
            let all = serde_json::json!({ "model": { "vocab": vocab, "merges": merges } });
            fs::write(folder.join("tokenizer.json"), all.to_string()).expect("written");
            fs::remove_file(folder.join("vocab.json")).expect("removed");
        });
        assert_eq!(embedded(whole.path()), expected);
    }
    // A config that also has a vision encoder.
    let beside = changed(|folder| {
        let path = folder.join("config.json");
        let mut text = json_of(&path).expect("JSON");
        text["model_type"] = "clip_text_model".into();
        let all = serde_json::json!({
            "model_type": "clip", "projection_dim": 512, "text_config": text,
            "vision_config": { "hidden_size": 768 },
        });
        fs::write(path, all.to_string()).expect("written");
    });
    assert_eq!(embedded(beside.path()), expected);
    // Another activation gives other embeddings.
    let gelu = changed(|folder| {
        let path = folder.join("config.json");
        let text = fs::read_to_string(&path).expect("a config");
        fs::write(path, text.replace("quick_gelu", "gelu")).expect("written");
    });
    assert_ne!(embedded(gelu.path()), expected);
}

#[test]
fn what_is_no_encoder_is_refused_by_its_file() {
    let refused = |change: &dyn Fn(&Path), texts: &[&str]| {
        let copy = changed(change);
        let Err(error) = TextEncoder::read(copy.path(), &Device::flex()) else {
            panic!("{texts:?}");
        };
        assert_eq!(error.exit_code(), 2);
        let message = error.to_string();
        for text in texts {
            assert!(message.contains(text), "no `{text}` in {message}");
        }
    };
    let replace = |name: &'static str, from: &'static str, to: &'static str| {
        move |folder: &Path| {
            let path = folder.join(name);
            let text = fs::read_to_string(&path).expect("a text");
            assert!(text.contains(from), "{from}");
            fs::write(path, text.replacen(from, to, 1)).expect("written");
        }
    };
    let remove = |name: &'static str| {
        move |folder: &Path| fs::remove_file(folder.join(name)).expect("removed")
    };
    refused(&remove("config.json"), &["config.json"]);
    refused(
        &remove("model.safetensors"),
        &["it has no model.safetensors"],
    );
    refused(&remove("merges.txt"), &["no vocab.json with merges.txt"]);
    refused(
        &replace("config.json", "clip_text_model", "bert"),
        &["config.json", "`bert`"],
    );
    refused(
        &replace("config.json", "quick_gelu", "relu"),
        &["config.json", "relu"],
    );
    refused(
        &replace("config.json", "\"vocab_size\": 694", "\"vocab_size\": 700"),
        &["vocab.json", "694 tokens", "700 tokens needed"],
    );
    refused(
        &replace("config.json", "\"hidden_size\": 12", "\"hidden_size\": 9"),
        &["model.safetensors", "[12]"],
    );
    refused(
        &replace(
            "config.json",
            "\"num_attention_heads\": 3",
            "\"num_attention_heads\": 5",
        ),
        &["config.json", "num_attention_heads"],
    );
    refused(
        &replace("vocab.json", "\"<|endoftext|>\":693", "\"<|endoftext|>\":3"),
        &["vocab.json", "`<|endoftext|>` is 3, 693 needed"],
    );
    refused(
        &|folder| fs::write(folder.join("model.safetensors"), b"PK").expect("written"),
        &["model.safetensors", "no safetensors file"],
    );
    let missing = TextEncoder::read(Path::new("nowhere"), &Device::flex());
    let message = missing.err().expect("no folder").to_string();
    assert_eq!(message, "nowhere: there is no such folder");
    let long = "walk ".repeat(1000);
    let error = encoder(&folder()).tokens(&long).expect_err("too long");
    assert!(error.to_string().contains("5000 bytes"), "{error}");
}
