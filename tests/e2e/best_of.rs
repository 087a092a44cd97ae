//! `kinegrad sample --best-of`.

use std::fs;

use kinegrad_tests::sandbox::{SMALLEST, Sandbox};
use serde_json::Value;

use crate::goals;

fn record(sandbox: &Sandbox, file: &str) -> Value {
    let text = fs::read_to_string(sandbox.path(file)).expect("a record");
    serde_json::from_str(&text).expect("JSON")
}

/// The scores of all samples of a condition, and the number of the selected one.
fn selection(sandbox: &Sandbox, file: &str) -> (Vec<Vec<f64>>, usize) {
    let record = record(sandbox, file);
    let scores = serde_json::from_value(record["selection"]["scores"].clone());
    let selected = record["selection"]["selected"].as_u64();
    (
        scores.expect("scores"),
        selected.expect("a number") as usize,
    )
}

/// The first of the least scores.
fn least(scores: &[Vec<f64>]) -> usize {
    let numbered = scores.iter().enumerate();
    let least = numbered.min_by(|a, b| a.1.partial_cmp(b.1).expect("numbers"));
    least.expect("a score").0
}

#[test]
fn the_best_phrase_is_one_of_the_samples_and_has_the_least_score() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox.run("train c.toml").succeeded();
    let sample = "sample runs/smallest --steps 2";
    sandbox
        .run(&format!("{sample} --count 5 --out all"))
        .succeeded();
    let bytes = |name: &str| fs::read(sandbox.path(name)).expect("a file");
    let mut selected = Vec::new();
    for by in ["checks", "beat", "beat,checks"] {
        let said = sandbox.run(&format!(
            "{sample} --best-of 5 --select-by {by} --out best --overwrite"
        ));
        let said = said.succeeded().stderr;
        let (scores, index) = selection(&sandbox, "best.json");
        assert_eq!((scores.len(), scores[0].len()), (5, by.split(',').count()));
        assert_eq!(index, least(&scores), "{scores:?}");
        let expected = format!("the sample is number {index} of 0 to 4: {}", &by[..4]);
        assert!(said.contains(&expected), "{said}");
        assert!(bytes("best.npy") == bytes(&format!("all-00{index}.npy")));
        selected.push(scores);
    }
    assert_ne!(selected[0], selected[1], "other measures");
    // The score of the beat is that of the records.
    let alignment = record(&sandbox, "all-003.json")["beat_alignment"].as_f64();
    assert_eq!(selected[1][3][0], 1.0 - alignment.expect("beats"));
    for (options, expected) in [
        ("--best-of 3 --select-by skating", "checks, beat"),
        ("--best-of 3 --select-by goal", "checks, beat"),
        ("--best-of 3 --select-by text", "checks, beat"),
        ("--best-of 1", "`--best-of` is 1"),
        ("--best-of 3 --count 2", "--count"),
        ("--best-of 3 --select-by looks", "looks"),
        ("--select-by beat", "--best-of"),
    ] {
        let said = sandbox.run(&format!("{sample} {options} --out x"));
        said.failed(2, &[expected]);
    }
    assert!(!sandbox.path("x.npy").exists());
}

#[test]
fn each_goal_of_a_batch_gets_the_best_of_its_own_samples() {
    let sandbox = goals::trained();
    let sample = "sample runs/gmd_motion --goal goal.toml --goal goal.toml";
    sandbox
        .run(&format!("{sample} --count 3 --out all --allow-unusable"))
        .succeeded();
    sandbox
        .run(&format!(
            "{sample} --best-of 3 --select-by goal,skating --out best --allow-unusable"
        ))
        .succeeded();
    let bytes = |name: &str| fs::read(sandbox.path(name)).expect("a file");
    for goal in 0..2 {
        let best = format!("best-00{goal}");
        let (scores, index) = selection(&sandbox, &format!("{best}.json"));
        assert_eq!(scores.len(), 3);
        assert_eq!(index, least(&scores), "{scores:?}");
        let number = 3 * goal + index;
        assert!(bytes(&format!("{best}.npy")) == bytes(&format!("all-00{number}.npy")));
    }
    assert!(!sandbox.path("best-002.npy").exists());
}
