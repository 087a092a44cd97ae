//! `kinegrad eval` on songs without motion, and with numbers of samples and frames.

use std::fs;

use kinegrad_tests::captures::clicks;
use kinegrad_tests::sandbox::{SMALLEST, SMALLEST_WALKS, Sandbox};
use serde_json::Value;

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    let held_out = "--set data.validation.patterns=[\"*_00000\",\"*_00001\",\"*_00002\"]";
    sandbox
        .run(&format!("train c.toml --set train.max_steps=4 {held_out}"))
        .succeeded();
    sandbox
}

/// The only evaluation of a report.
fn report(sandbox: &Sandbox, path: &str) -> Value {
    let text = fs::read_to_string(sandbox.path(path)).expect(path);
    let report: Value = serde_json::from_str(&text).expect("JSON");
    report["evaluations"][0].clone()
}

#[test]
fn songs_without_motion_are_checked_and_measured() {
    let sandbox = sandbox();
    for (name, tempo) in [("a", 120.0), ("b", 96.0)] {
        let beats: Vec<f64> = (0..24).map(|beat| f64::from(beat) * 60.0 / tempo).collect();
        sandbox.write(&format!("music/{name}.wav"), clicks(&beats, 9.0));
    }
    sandbox.write("music/cover.txt", "no song");
    let songs = "eval runs/smallest --songs music --steps 2";
    let done = sandbox
        .run(&format!(
            "{songs} --num-frames 24 --num-samples 12 --out report"
        ))
        .succeeded();
    for text in [
        "songs without motion",
        "no distances to real motion",
        "12 of",
    ] {
        let said = done.stdout.replace('\n', " ");
        assert!(
            said.contains(text) || text == "12 of",
            "{text}: {}",
            done.stdout
        );
    }
    let found = report(&sandbox, "report/eval-songs.json");
    assert_eq!(found["songs"], 2);
    assert_eq!(
        (&found["excerpts"], &found["seeds"]),
        (&6.into(), &2.into())
    );
    assert_eq!(found["real"], Value::Null);
    let processed = &found["processed"];
    for missing in ["frechet_held_out", "frechet_training"] {
        assert_eq!(processed[missing], Value::Null, "{missing}");
    }
    for measured in ["diversity", "same_phrase_diversity", "mean_jerk"] {
        assert!(processed[measured].is_f64(), "{measured}: {processed}");
    }
    assert!(
        processed["beat_phase_error"]["mean"].is_f64(),
        "{processed}"
    );
    assert!(processed["strict"]["pass_rate"].is_f64());
    let losses = processed["losses"].as_array().expect("losses");
    let names: Vec<&str> = losses
        .iter()
        .filter_map(|loss| loss["name"].as_str())
        .collect();
    assert!(
        names.contains(&"jerk") && !names.contains(&"position"),
        "{names:?}"
    );
    // Without numbers, excerpts have the training length of 24 frames.
    sandbox
        .run(&format!("{songs} --set evaluation.phrases=3 --out three"))
        .succeeded();
    let three = report(&sandbox, "three/eval-songs.json");
    assert_eq!(three["excerpts"], 3);
    // One song; a short one is a single excerpt.
    sandbox.write("short.wav", clicks(&[0.2], 0.5));
    sandbox
        .run("eval runs/smallest --songs short.wav --steps 2 --out short")
        .succeeded();
    assert_eq!(report(&sandbox, "short/eval-songs.json")["excerpts"], 1);

    let refused = |arguments: &str, texts: &[&str]| {
        sandbox
            .run(&format!("eval runs/smallest {arguments}"))
            .failed(2, texts);
    };
    refused("--songs runs", &["contains no song", ".mp3"]);
    refused(
        "--songs music --audio-ablation",
        &["--songs", "--audio-ablation"],
    );
    refused("--songs music --source set", &["--songs", "--source"]);
    refused(
        "--songs music --set evaluation.cond=noise",
        &["evaluation.cond"],
    );
    refused("--num-frames 2", &["--num-frames", "4"]);
    refused("--num-samples 0", &["--num-samples", "1"]);
}

#[test]
fn a_quick_evaluation_has_few_samples_of_few_steps() {
    let sandbox = sandbox();
    sandbox
        .run("eval runs/smallest --quick --out quick")
        .succeeded();
    let quick = report(&sandbox, "quick/eval.json");
    // Three held-out phrases.
    assert_eq!((&quick["phrases"], &quick["seeds"]), (&3.into(), &6.into()));
    assert_eq!(quick["sampler"]["num_inference_steps"], 10);
    sandbox
        .run("eval runs/smallest --quick --num-samples 4 --steps 2 --num-frames 12 --out few")
        .succeeded();
    let few = report(&sandbox, "few/eval.json");
    assert_eq!((&few["phrases"], &few["seeds"]), (&2.into(), &2.into()));
    assert_eq!(few["sampler"]["num_inference_steps"], 2);
    let full = "eval runs/smallest --steps 2 --set evaluation.phrases=2 --out full";
    sandbox.run(full).succeeded();
    let full = report(&sandbox, "full/eval.json");
    assert_ne!(few["real"], full["real"], "of 12 and of 40 frames");
    sandbox.write("w.toml", SMALLEST_WALKS);
    sandbox
        .run("train w.toml --name walks --set train.max_steps=2")
        .succeeded();
    let walks = sandbox.run("eval runs/walks --num-samples 4");
    walks.failed(2, &["--num-samples", "gmd_motion", "evaluation"]);
}

#[test]
fn terms_of_the_loss_have_panels_of_their_own() {
    let sandbox = sandbox();
    let fine_tune = "train c.toml --name e2e --set train.recipe=e2e --set train.max_steps=4 \
                     --set init.diffusion=runs/smallest --set rollout.steps=2 --set \
                     validation.every_steps=2";
    sandbox.run(fine_tune).succeeded();
    let done = sandbox
        .run("plot runs/e2e --terms --out terms.svg")
        .succeeded();
    assert!(done.stderr.contains("6 of"), "{}", done.stderr);
    let picture = fs::read_to_string(sandbox.path("terms.svg")).expect("a picture");
    for title in [
        "total",
        "diffusion",
        "position",
        "velocity_coherence",
        "accel_coherence",
        "jerk",
    ] {
        assert!(picture.contains(&format!("\n{title}\n")), "{title}");
    }
    sandbox
        .run("sample runs/smallest --out dance --frames 16 --steps 2")
        .succeeded();
    sandbox.run("plot dance.npy --out dance.svg").succeeded();
    let picture = fs::read_to_string(sandbox.path("dance.svg")).expect("a picture");
    for threshold in [
        "threshold 50000",
        "thresholds 0.95, 1.05",
        "thresholds 0, 1",
    ] {
        assert!(picture.contains(threshold), "{threshold}");
    }
    sandbox.write("bounds.toml", "max_jerk = 10.0");
    sandbox
        .run("plot dance.npy --thresholds bounds.toml --out dance.svg --overwrite")
        .succeeded();
    let picture = fs::read_to_string(sandbox.path("dance.svg")).expect("a picture");
    assert!(picture.contains("threshold 10"));
    let refused = sandbox.run("plot dance.npy --terms --out x.svg");
    refused.failed(2, &["--terms", "dance.npy"]);
    let refused = sandbox.run("plot runs/e2e --thresholds bounds.toml --out x.svg");
    refused.failed(2, &["--thresholds", "motion file"]);
}
