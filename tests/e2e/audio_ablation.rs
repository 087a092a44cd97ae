//! `kinegrad eval --audio-ablation`: its table and reports, the effect of audio on models, and refusals.

use std::fs;

use kinegrad_data::{features_path, motion_path, synthetic, write_features, write_motion};
use kinegrad_motion::motion_measures::phase_steps;
use kinegrad_motion::phrase::PHASE;
use kinegrad_tests::sandbox::{SMALLEST, SMALLEST_WALKS, Sandbox};
use serde_json::Value;

const CONDITIONS: [&str; 6] = [
    "own",
    "silence",
    "shuffled",
    "reversed",
    "half_beat",
    "other_song",
];

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
}

fn train(sandbox: &Sandbox, name: &str, settings: &str) {
    let held_out = "--set data.validation.patterns=[\"*_00000\",\"*_00001\",\"*_00002\"]";
    sandbox
        .run(&format!("train c.toml --name {name} {held_out} {settings}"))
        .succeeded();
}

fn read(sandbox: &Sandbox, path: &str) -> String {
    fs::read_to_string(sandbox.path(path)).expect("a report")
}

fn evaluations(text: &str) -> Vec<Value> {
    let report: Value = serde_json::from_str(text).expect("JSON");
    report["evaluations"].as_array().expect("a list").clone()
}

/// Measures of a run with one kind of audio.
fn condition<'a>(evaluation: &'a Value, audio: &str) -> &'a Value {
    let conditions = evaluation["conditions"].as_array().expect("conditions");
    let found = conditions.iter().find(|each| each["audio"] == audio);
    found.expect(audio)
}

/// A mean within its interval.
fn mean(estimate: &Value) -> f64 {
    let number = |key: &str| estimate[key].as_f64().expect(key);
    let [mean, low, high] = ["mean", "low", "high"].map(number);
    assert!(
        low <= mean + 1e-12 && mean <= high + 1e-12,
        "{low} {mean} {high}"
    );
    mean
}

#[test]
fn a_network_that_tracks_beats_is_measured_by_its_tracker_too() {
    let sandbox = sandbox();
    train(&sandbox, "given", "");
    train(
        &sandbox,
        "tracking",
        "--set model.audio_conditioning=aligned --set model.beats=tracked \
         --set data.audio_features=[\"ccmotion\",\"beats\"]",
    );
    let line = "eval runs/given runs/tracking --audio-ablation --steps 2 --out both --all";
    let finished = sandbox.run(line).succeeded();
    let title = "beat-phase error of the network's tracker, beats";
    assert!(finished.stdout.contains(title), "{}", finished.stdout);
    let found = evaluations(&read(&sandbox, "both/eval-audio-ablation.json"));
    assert!(found[0]["tracked_beat_error"].is_null());
    let error = mean(&found[1]["tracked_beat_error"]);
    let measured = found[1]["measured"].as_array().expect("phrases");
    let of_phrases = measured.iter().map(|phrase| {
        let error = phrase["tracked_beat_error"].as_f64().expect("an error");
        assert!((0.0..=0.5).contains(&error), "{error}");
        error
    });
    let sum: f64 = of_phrases.sum();
    assert!((error - sum / measured.len() as f64).abs() < 1e-9);
}

#[test]
fn ccmotion_models_depend_on_the_set_of_frames_and_aligned_ones_on_their_order() {
    let sandbox = sandbox();
    train(&sandbox, "set", "");
    train(
        &sandbox,
        "ordered",
        "--set model.audio_conditioning=aligned --set data.audio_features=[\"ccmotion\",\"beats\"]",
    );
    let line = "eval runs/set runs/ordered --audio-ablation --steps 3 --out both --all \
                --guidance-scale 1,2.5";
    let finished = sandbox.run(line).succeeded();
    for text in [
        "OWN MUSIC",
        "FRAMES SHUFFLED",
        "SHIFTED BY HALF A BEAT",
        "ANOTHER SONG'S",
        "loss at high noise",
        "beat-phase error, beats",
        "own minus this: loss",
        "beat alignment above chance",
        "2.5: beat-phase error, beats",
        "2.5: diversity",
        "95 % bootstrap intervals",
        "3 phrases without a known number of beats in a bar",
        "eval-audio-ablation.json",
    ] {
        assert!(
            finished.stdout.contains(text),
            "{text}: {}",
            finished.stdout
        );
    }
    assert_eq!(
        sandbox.list("both"),
        ["eval-audio-ablation.csv", "eval-audio-ablation.json"]
    );
    let json = read(&sandbox, "both/eval-audio-ablation.json");
    let found = evaluations(&json);
    for (evaluation, name) in found.iter().zip(["set", "ordered"]) {
        assert_eq!(evaluation["run"], name);
        assert_eq!(
            (&evaluation["phrases"], &evaluation["songs"]),
            (&3.into(), &3.into())
        );
        let audio: Vec<&Value> = evaluation["conditions"]
            .as_array()
            .expect("conditions")
            .iter()
            .map(|each| &each["audio"])
            .collect();
        assert_eq!(audio, CONDITIONS);
        for audio in CONDITIONS {
            let condition = condition(evaluation, audio);
            assert!(mean(&condition["loss"]) > 0.0);
            for key in ["beat_phase_error", "bar_phase_error"] {
                let error = mean(&condition[key]);
                assert!((0.0..=0.5).contains(&error), "{audio} {key}: {error}");
            }
            let to_condition = &condition["condition_beat_phase_error"];
            let has_beats = ["own", "half_beat", "other_song"].contains(&audio);
            assert_eq!(
                to_condition.is_object(),
                has_beats,
                "{audio}: {to_condition}"
            );
            assert_eq!(condition["own_minus"].is_null(), audio == "own");
        }
        let own = condition(evaluation, "own");
        assert_eq!(own["condition_beat_phase_error"], own["beat_phase_error"]);
        for of in ["beat_alignment", "peak_alignment"] {
            assert!(evaluation["real"][of].get("above_chance").is_some());
            assert!(own[of].get("above_chance").is_some());
        }
        let scales = evaluation["guidance"].as_array().expect("scales");
        let named: Vec<f64> = scales
            .iter()
            .map(|scale| scale["guidance_scale"].as_f64().expect("a scale"))
            .collect();
        assert_eq!(named, [1.0, 2.5]);
        // The run's scale is 1, so these are the same samples.
        assert_eq!(scales[0]["beat_phase_error"], own["beat_phase_error"]);
        assert_ne!(scales[1]["beat_phase_error"], own["beat_phase_error"]);
        assert!(scales[1]["measures"]["diversity"].is_number());
        let measured = evaluation["measured"].as_array().expect("phrases");
        assert_eq!(measured.len(), 3);
        for phrase in measured {
            assert_eq!(
                (&phrase["song"], &phrase["beats_per_bar"]),
                (&phrase["id"], &4.0.into())
            );
        }
    }
    for key in ["loss", "beat_phase_error", "bar_phase_error"] {
        for audio in ["shuffled", "reversed"] {
            let difference =
                |evaluation: &Value| mean(&condition(evaluation, audio)["own_minus"][key]).abs();
            let [set, ordered] = [0, 1].map(|run| difference(&found[run]));
            assert!(set < 1e-4, "{audio} {key}: {set}");
            assert!(
                ordered > 1e-5_f64.max(10.0 * set),
                "{audio} {key}: {ordered}"
            );
        }
    }
    let silence = &condition(&found[0], "silence")["own_minus"]["loss"];
    assert!(mean(silence).abs() > 1e-5, "the audio matters: {silence}");

    let csv = read(&sandbox, "both/eval-audio-ablation.csv");
    let row = |start: &str| {
        let row = csv.lines().find(|row| row.starts_with(start)).expect(start);
        let fields = row
            .split(',')
            .skip(2)
            .map(|field| field.parse::<f64>().ok());
        fields.collect::<Vec<_>>()
    };
    let low = row("reversed,own_minus.loss.low,");
    for run in [0, 1] {
        let expected = &condition(&found[run], "reversed")["own_minus"]["loss"]["low"];
        assert_eq!(low[run], expected.as_f64());
    }
    let columns = row("own,beat_alignment.score.mean,").len();
    assert_eq!(columns, 4, "both runs, real and the direction");
    row("guidance,2.5.strict.pass_rate,");
}

#[test]
fn the_same_seed_measures_the_same() {
    let sandbox = sandbox();
    train(&sandbox, "smallest", "--set train.max_steps=4");
    let line = "eval runs/smallest --audio-ablation --json --steps 2 --set evaluation.seeds=1";
    let first = sandbox.run(line).succeeded().stdout;
    assert_eq!(sandbox.run(line).succeeded().stdout, first);
    let reports = "runs/smallest/reports";
    let stem = "eval-audio-ablation-seeds=1-num_inference_steps=2";
    assert_eq!(
        sandbox.list(reports),
        [format!("{stem}.csv"), format!("{stem}.json")]
    );
    assert_eq!(read(&sandbox, &format!("{reports}/{stem}.json")), first);
    let other = sandbox.run(&format!("{line} --seed 1")).succeeded().stdout;
    assert_ne!(other, first);
    // The loss does not depend on the seed, the shuffled order does.
    let [first, other] = [first, other].map(|text| evaluations(&text).remove(0));
    let of = |evaluation: &Value, audio| condition(evaluation, audio)["loss"]["mean"].clone();
    assert_eq!(of(&first, "own"), of(&other, "own"));
    // One guidance scale applies to all samples; there is no comparison.
    let guided = sandbox
        .run(&format!("{line} --guidance-scale 2"))
        .succeeded();
    let guided = evaluations(&guided.stdout).remove(0);
    assert_eq!(guided["sampler"]["guidance_scale"], 2.0);
    assert_eq!(guided["guidance"], Value::Array(Vec::new()));
    assert_ne!(
        condition(&guided, "own")["bar_phase_error"],
        condition(&first, "own")["bar_phase_error"]
    );
}

/// A dataset with two held-out songs: `a` has three phrases, the last of 20 frames; `b` has one,
/// and a phrase without beats. Six phrases of `c` are for training.
fn songs(sandbox: &Sandbox) {
    let fast = (0..)
        .find(|&index| {
            let motion = synthetic::phrase(index, 20, 1).motion;
            4.0 * phase_steps(&motion).iter().sum::<f64>() > 1.1
        })
        .expect("a fast one");
    let mut phrases: Vec<(String, usize, usize)> = vec![
        ("a_00000".into(), 100, 40),
        ("a_00040".into(), 101, 40),
        ("a_00080".into(), fast, 20),
        ("b_00000".into(), 102, 40),
        ("b_00040".into(), 103, 40),
    ];
    phrases.extend((0..6).map(|k| (format!("c_{:05}", 40 * k), 110 + k, 40)));
    for (id, index, frames) in phrases {
        let mut phrase = synthetic::phrase(index, frames, 1);
        if id == "b_00040" {
            (0..frames).for_each(|t| phrase.motion.frame_mut(t)[PHASE] = 0.0);
        }
        for path in [motion_path(&id), features_path(&id)] {
            let path = sandbox.path(format!("set/{path}"));
            fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        }
        let at = |path: String| sandbox.path(format!("set/{path}"));
        write_motion(&at(motion_path(&id)), &phrase.motion).expect("written");
        write_features(&at(features_path(&id)), &phrase.audio).expect("written");
    }
}

#[test]
fn phrases_are_grouped_by_song_and_those_without_beats_left_out() {
    let sandbox = sandbox();
    songs(&sandbox);
    let of_set = "--set data.kind=phrases --set data.source=set --set train.max_steps=4";
    sandbox
        .run(&format!(
            "train c.toml --name two {of_set} --set data.validation.patterns=[\"a_*\",\"b_*\"]"
        ))
        .succeeded();
    let line = "eval runs/two --audio-ablation --steps 2 --set evaluation.seeds=1 \
                --set evaluation.beats_per_bar=5";
    let finished = sandbox.run(line).succeeded();
    let remark = "1 of 5 held-out phrases left out, without beats";
    assert!(finished.stdout.contains(remark), "{}", finished.stdout);
    assert!(
        !finished.stdout.contains("four beats"),
        "stated: {}",
        finished.stdout
    );
    let json = read(
        &sandbox,
        "runs/two/reports/eval-audio-ablation-beats_per_bar=5-seeds=1-num_inference_steps=2.json",
    );
    let found = evaluations(&json).remove(0);
    assert_eq!((&found["phrases"], &found["songs"]), (&4.into(), &2.into()));
    let measured = found["measured"].as_array().expect("phrases");
    let said: Vec<_> = measured
        .iter()
        .map(|phrase| (phrase["id"].as_str(), phrase["song"].as_str()))
        .collect();
    let expected = [
        ("a_00000", "a"),
        ("a_00040", "a"),
        ("a_00080", "a"),
        ("b_00000", "b"),
    ];
    assert_eq!(said, expected.map(|(id, song)| (Some(id), Some(song))));
    assert!(measured.iter().all(|phrase| phrase["beats_per_bar"] == 5.0));
    // Means are of phrases, not of songs.
    let of = |phrase: &Value| phrase["conditions"][0]["loss"].as_f64().expect("a loss");
    let expected = measured.iter().map(of).sum::<f64>() / 4.0;
    let own = mean(&condition(&found, "own")["loss"]);
    assert!((own - expected).abs() < 1e-9, "{own} {expected}");

    // With one held-out song, the other music is that of training phrases.
    sandbox
        .run(&format!(
            "train c.toml --name one {of_set} --set data.validation.patterns=[\"b_00000\"]"
        ))
        .succeeded();
    let finished = sandbox
        .run("eval runs/one --audio-ablation --steps 2 --set evaluation.seeds=1")
        .succeeded();
    let remark = "the intervals do not cover other songs";
    assert!(finished.stdout.contains(remark), "{}", finished.stdout);
    let report = "runs/one/reports/eval-audio-ablation-seeds=1-num_inference_steps=2.json";
    let found = evaluations(&read(&sandbox, report)).remove(0);
    mean(&condition(&found, "other_song")["loss"]);

    // No beats to compare with.
    sandbox
        .run(&format!(
            "train c.toml --name none {of_set} --set data.validation.patterns=[\"b_00040\"]"
        ))
        .succeeded();
    sandbox
        .run("eval runs/none --audio-ablation --steps 2")
        .failed(
            2,
            &[
                "none of the 1 held-out phrases",
                "runs/none",
                "beat",
                "hint:",
            ],
        );
    assert!(!sandbox.path("runs/none/reports").exists());
}

#[test]
fn bad_input_is_refused_before_anything_is_written() {
    let sandbox = sandbox();
    train(&sandbox, "smallest", "--set train.max_steps=4");
    sandbox
        .run("train c.toml --name all --set train.max_steps=4 --set data.validation.fraction=0")
        .succeeded();
    sandbox.write("walks.toml", SMALLEST_WALKS);
    sandbox
        .run("train walks.toml --name walks --set train.max_steps=4")
        .succeeded();
    let refused = |arguments: &str, texts: &[&str]| {
        sandbox.run(arguments).failed(2, texts);
        for run in ["smallest", "all", "walks"] {
            let reports = sandbox.path(format!("runs/{run}/reports"));
            assert!(!reports.exists(), "{arguments}");
        }
    };
    refused(
        "eval runs/all --audio-ablation",
        &[
            "no phrase is held out",
            "runs/all",
            "data.validation",
            "hint:",
        ],
    );
    refused(
        "eval runs/walks --audio-ablation",
        &[
            "--audio-ablation",
            "runs/walks",
            "a run of recipe `gmd_",
            "hint:",
        ],
    );
    refused(
        "eval runs/smallest --audio-ablation --set evaluation.cond=noise",
        &["--audio-ablation", "evaluation.cond", "noise", "hint:"],
    );
    refused(
        "eval runs/smallest --guidance-scale 1,2,3",
        &["`--guidance-scale` names 3 scales", "--audio-ablation"],
    );
    refused(
        "sample runs/smallest --out s --guidance-scale 1,2",
        &["`--guidance-scale` names 2 scales", "eval --audio-ablation"],
    );
    refused(
        "eval runs/smallest --audio-ablation --guidance-scale 1,two",
        &["two", "a number"],
    );
    refused(
        "eval runs/smallest --audio-ablation --guidance-scale 1,-2",
        &["evaluation.guidance_scales", "-2"],
    );
    refused(
        "eval runs/smallest --audio-ablation --set evaluation.beats_per_bar=0",
        &["evaluation.beats_per_bar", "0", "hint:"],
    );
    refused(
        "eval runs/walks --audio-ablation --guidance-scale 1,2",
        &["evaluation.guidance_scales"],
    );
}
