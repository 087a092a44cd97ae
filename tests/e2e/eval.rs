//! Evaluation of runs: output, files and refusals.

use std::fs;

use kinegrad_data::read_motion;
use kinegrad_motion::Statistics;
use kinegrad_motion::metrics::diversity;
use kinegrad_tests::sandbox::{SMALLEST, Sandbox};
use serde_json::Value;

/// A sandbox with the run `smallest`; four of its twelve phrases are held out.
fn trained() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    train(&sandbox, "smallest", "");
    sandbox
}

fn train(sandbox: &Sandbox, name: &str, settings: &str) {
    let held_out =
        "--set data.validation.patterns=[\"*_00000\",\"*_00001\",\"*_00002\",\"*_00003\"]";
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

/// Every number of an evaluation's column in the CSV is the one in the JSON.
fn assert_consistent(csv: &str, label: &str, evaluation: &Value, real: bool) {
    let mut lines = csv.lines();
    let header: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let column = header.iter().position(|name| *name == label).expect(label);
    let mut compared = 0;
    for line in lines {
        let fields: Vec<&str> = line.split(',').collect();
        assert_eq!(fields.len(), header.len(), "{line}");
        let (samples, measure) = (fields[0], fields[1]);
        if samples.is_empty() {
            continue;
        }
        let part = if real { "real" } else { samples };
        let path: Vec<&str> = measure.split('.').collect();
        let found = match path[..] {
            [metric] => &evaluation[part][metric],
            ["loss", name] => {
                let losses = evaluation[part]["losses"].as_array().expect("losses");
                let loss = losses.iter().find(|each| each["name"] == name);
                &loss.expect(name)["value"]
            }
            ["movement", name, what] => {
                let movement = evaluation[part]["movement"].as_array().expect("movement");
                let spread = movement.iter().find(|each| each["name"] == name);
                &spread.expect(name)[what]
            }
            [profile, rate] => &evaluation[part][profile][rate],
            [profile, check, what] => {
                let checks = evaluation[part][profile]["checks"].as_array();
                let mut checks = checks.expect("checks").iter();
                let check = checks.find(|each| each["name"] == check).expect(check);
                match what {
                    "min" => &check["value"][0],
                    "max" => &check["value"][1],
                    what => &check[what],
                }
            }
            _ => panic!("{measure}"),
        };
        let written = fields[column].parse::<f64>().ok();
        assert_eq!(written, found.as_f64(), "{samples} {measure}");
        compared += usize::from(written.is_some());
    }
    assert!(compared > 50, "{compared} numbers");
}

#[test]
fn a_run_is_measured_beside_the_real_phrases() {
    let sandbox = trained();
    let finished = sandbox.run("eval runs/smallest --steps 4").succeeded();
    for text in [
        "smallest",
        "real",
        "diversity",
        "Fréchet",
        "strict: jerk",
        "movement: mean jerk of the path",
    ] {
        assert!(finished.stdout.contains(text), "{}", finished.stdout);
    }
    assert!(finished.stdout.contains("eval.json"), "{}", finished.stdout);
    let reports = "runs/smallest/reports";
    assert_eq!(sandbox.list(reports), ["eval.csv", "eval.json"]);

    let json = read(&sandbox, &format!("{reports}/eval.json"));
    let evaluations = evaluations(&json);
    assert_eq!(evaluations.len(), 1);
    let evaluation = &evaluations[0];
    assert_eq!(evaluation["run"], "smallest");
    assert_eq!(
        (&evaluation["phrases"], &evaluation["seeds"]),
        (&4.into(), &2.into())
    );
    assert_eq!(evaluation["sampler"]["num_inference_steps"], 4);
    assert!(evaluation["step"].as_u64().expect("a step") > 0);
    for form in ["raw", "processed"] {
        for metric in [
            "diversity",
            "same_phrase_diversity",
            "frechet_held_out",
            "frechet_training",
            "beat_alignment",
            "mean_jerk",
        ] {
            let value = evaluation[form][metric].as_f64().expect(metric);
            assert!(value > 0.0, "{form} {metric} {value}");
        }
    }
    let real = &evaluation["real"];
    assert!(real["frechet_held_out"].as_f64().expect("a distance") < 1e-5);
    assert!(real["same_phrase_diversity"].is_null());
    // Eight training phrases underestimate the range of movement: two real held-out phrases fail by
    // the lower bound of one measure, none by another.
    let checks = real["strict"]["checks"].as_array().expect("checks");
    for check in checks {
        let expected = match check["name"].as_str() {
            Some("path_jerk") => 0.5,
            _ => 1.0,
        };
        assert_eq!(check["pass_rate"], expected, "{check}");
    }

    let csv = read(&sandbox, &format!("{reports}/eval.csv"));
    assert_consistent(&csv, "smallest", evaluation, false);
    assert_consistent(&csv, "real", evaluation, true);

    let again = sandbox
        .run("eval runs/smallest --steps 4 --json")
        .succeeded();
    assert_eq!(again.stdout, json, "the same twice, printed and written");
    let other = sandbox.run("eval runs/smallest --steps 4 --json --seed 1");
    assert_ne!(other.succeeded().stdout, json, "another seed");
}

#[test]
fn sample_draws_what_eval_measures_with_another_noise_for_each_phrase() {
    let sandbox = trained();
    let settings = "--steps 4 --seed 5";
    let finished = sandbox.run(&format!(
        "eval runs/smallest --set evaluation.seeds=1 --json {settings}"
    ));
    let evaluation = &evaluations(&finished.succeeded().stdout)[0];
    sandbox
        .run(&format!(
            "sample runs/smallest --item *_000* --out s/d {settings}"
        ))
        .succeeded();
    let state = sandbox.list("runs/smallest/checkpoints");
    let state = state.last().expect("a checkpoint");
    let state = read(
        &sandbox,
        &format!("runs/smallest/checkpoints/{state}/state.json"),
    );
    let state: Value = serde_json::from_str(&state).expect("JSON");
    let statistics: Statistics =
        serde_json::from_value(state["statistics"].clone()).expect("statistics");
    let drawn: Vec<_> = sandbox
        .list("s")
        .into_iter()
        .filter(|name| {
            name.ends_with(".raw.npy") && ('0'..='3').any(|n| name.contains(&format!("_0000{n}")))
        })
        .map(|name| read_motion(&sandbox.path(format!("s/{name}"))).expect("a motion"))
        .collect();
    let drawn: Vec<_> = drawn.iter().collect();
    assert_eq!(drawn.len(), 4);
    let expected = diversity(&drawn, &statistics).expect("four phrases");
    assert_eq!(evaluation["raw"]["diversity"].as_f64(), Some(expected));
}

#[test]
fn runs_stand_side_by_side() {
    let sandbox = trained();
    train(&sandbox, "other", "--set run.seed=7");
    let finished = sandbox
        .run(
            "eval runs/smallest runs/other --steps 3 --set evaluation.seeds=1 \
             --set evaluation.phrases=3 --out both",
        )
        .succeeded();
    let header = finished.stdout.lines().next().expect("a header");
    let places = ["smallest", "other", "real"].map(|name| header.find(name).expect(name));
    assert!(places.is_sorted(), "{header}");
    let csv = read(&sandbox, "both/eval.csv");
    let evaluations = evaluations(&read(&sandbox, "both/eval.json"));
    for (label, evaluation) in ["smallest", "other"].into_iter().zip(&evaluations) {
        assert_eq!(evaluation["run"], label);
        assert_eq!(evaluation["phrases"], 3);
        assert!(evaluation["raw"]["same_phrase_diversity"].is_null());
        assert_consistent(&csv, label, evaluation, false);
    }
    assert_ne!(evaluations[0]["raw"], evaluations[1]["raw"]);
    assert_eq!(evaluations[0]["real"], evaluations[1]["real"]);
    assert!(!sandbox.path("runs/smallest/reports").exists());

    // Two checkpoints of one run have the same name, so they are listed by their arguments.
    let steps = sandbox.list("runs/smallest/checkpoints");
    let step = steps.iter().find(|name| name.starts_with("step-"));
    let step = format!("runs/smallest/checkpoints/{}", step.expect("a checkpoint"));
    let finished = sandbox.run(&format!(
        "eval runs/other {step} {step} --steps 1 --set evaluation.phrases=1"
    ));
    let header = finished.succeeded().stdout;
    assert!(
        header.lines().next().expect("a header").contains(&step),
        "{header}"
    );
    assert_eq!(
        sandbox.list("runs/smallest/reports"),
        ["eval.csv", "eval.json"]
    );
}

#[test]
fn noise_in_place_of_music_is_another_report() {
    let sandbox = trained();
    let evaluate = |cond: &str| {
        let finished = sandbox.run(&format!(
            "eval runs/smallest --steps 3 --json --set evaluation.cond={cond}"
        ));
        evaluations(&finished.succeeded().stdout).remove(0)
    };
    let (music, noise) = (evaluate("phrases"), evaluate("noise"));
    assert_eq!(
        (&music["cond"], &noise["cond"]),
        (&"phrases".into(), &"noise".into())
    );
    assert_ne!(music["raw"], noise["raw"], "the model heard something else");
    assert_eq!(music["real"], noise["real"]);
    assert_eq!(
        sandbox.list("runs/smallest/reports"),
        ["eval-noise.csv", "eval-noise.json", "eval.csv", "eval.json"]
    );
}

#[test]
fn one_phrase_has_no_metric_of_many() {
    let sandbox = trained();
    let finished = sandbox.run(
        "eval runs/smallest --steps 2 --set evaluation.seeds=1 --set evaluation.phrases=1 --json",
    );
    let evaluation = &evaluations(&finished.succeeded().stdout)[0];
    for metric in ["diversity", "frechet_held_out", "frechet_training"] {
        assert!(evaluation["raw"][metric].is_null(), "{metric}");
    }
    assert!(evaluation["raw"]["mean_jerk"].is_number());
}

#[test]
fn bad_input_is_refused_before_anything_is_written() {
    let sandbox = trained();
    let refused = |arguments: &str, texts: &[&str]| {
        sandbox.run(&format!("eval {arguments}")).failed(2, texts);
        assert!(
            !sandbox.path("runs/smallest/reports").exists(),
            "{arguments}"
        );
    };
    refused("", &["RUN"]);
    refused("runs/nowhere", &["runs/nowhere", "hint:"]);
    refused("runs/smallest runs/nowhere", &["runs/nowhere", "hint:"]);
    for key in ["evaluation.seeds", "evaluation.phrases"] {
        let is_none = format!("`{key}` is 0");
        refused(
            &format!("runs/smallest --set {key}=0"),
            &[is_none.as_str(), "1 or more", "hint:"],
        );
    }
    refused(
        "runs/smallest --set evaluation.goals=2",
        &["evaluation.goals", "seeds, phrases, cond", "hint:"],
    );
    refused(
        "runs/smallest --steps 0",
        &["num_inference_steps", "0", "hint:"],
    );
    refused(
        "runs/smallest --guidance-scale=-1",
        &["guidance_scale", "-1"],
    );
    refused(
        "runs/smallest --set evaluation.cond=silence",
        &["evaluation.cond", "silence", "noise"],
    );
    refused("runs/smallest --sheds 4", &["'--sheds'"]);
    refused("runs/smallest --source nowhere", &["nowhere", "hint:"]);
    refused("runs/smallest --device abacus", &["abacus", "hint:"]);
    sandbox.write("file", "");
    refused(
        "runs/smallest --steps 1 --out file",
        &["file", "--out", "hint:"],
    );

    // Phrases whose ids the run's patterns do not match.
    sandbox
        .run("data synth --out set --phrases 3 --frames 30")
        .succeeded();
    for kind in ["motion", "audio_features"] {
        for (index, id) in sandbox.list(&format!("set/{kind}")).into_iter().enumerate() {
            let [from, to] =
                [id, format!("take{index}")].map(|id| sandbox.path(format!("set/{kind}/{id}")));
            fs::rename(from, to).expect("renamed");
        }
    }
    refused(
        "runs/smallest --source set",
        &[
            "no phrase is held out",
            "runs/smallest",
            "data.validation",
            "--source",
        ],
    );
}
