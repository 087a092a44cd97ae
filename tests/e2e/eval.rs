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
    let line = "eval runs/smallest --steps 4 --all";
    let finished = sandbox.run(line).succeeded();
    for text in [
        "smallest",
        "real",
        "diversity",
        "Fréchet",
        "strict: jerk",
        "mean jerk of the path",
    ] {
        assert!(finished.stdout.contains(text), "{}", finished.stdout);
    }
    let reports = "runs/smallest/reports";
    let report = format!("{reports}/eval-num_inference_steps=4");
    assert!(finished.stdout.contains(&report), "{}", finished.stdout);

    let json = read(&sandbox, &format!("{report}.json"));
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

    let csv = read(&sandbox, &format!("{report}.csv"));
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
    let said = &finished.stdout;
    let best = said.lines().next().expect("a verdict");
    assert!(best.starts_with("best of "), "{best}");
    assert!(
        ["smallest in ", "other in "]
            .iter()
            .all(|run| best.contains(run)),
        "{best}"
    );
    let header = said.lines().find(|line| line.contains('|'));
    let header = header.expect("a header");
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
    let said = finished.succeeded().stdout;
    let header = said.lines().find(|line| line.contains('|'));
    assert!(header.expect("a header").contains(&step), "{said}");
    let name = step.rsplit('/').next().expect("a name");
    let stem = format!("eval-checkpoint={name}-phrases=1-num_inference_steps=1");
    assert_eq!(
        sandbox.list("runs/smallest/reports"),
        [format!("{stem}.csv"), format!("{stem}.json")]
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
        [
            "eval-noise-num_inference_steps=3.csv",
            "eval-noise-num_inference_steps=3.json",
            "eval-num_inference_steps=3.csv",
            "eval-num_inference_steps=3.json",
        ]
    );
}

#[test]
fn the_verdict_comes_first_and_the_main_measures_have_directions() {
    let sandbox = trained();
    let finished = sandbox.run("eval runs/smallest --steps 2").succeeded();
    let lines: Vec<&str> = finished.stdout.lines().collect();
    assert!(lines.len() <= 14, "{}", finished.stdout);
    for (line, start) in lines.iter().zip([
        "smallest: ",
        "smallest: the samples do not follow the beat: beat-phase error ",
        "smallest: furthest from real motion: ",
    ]) {
        assert!(line.starts_with(start), "{}", finished.stdout);
    }
    assert!(lines[0].contains("are within the limits of `strict` (real: "));
    let row = |start: &str| {
        let row = lines
            .iter()
            .find(|line| line.trim_start().starts_with(start));
        let row = row.unwrap_or_else(|| panic!("no {start}: {}", finished.stdout));
        row.split('|').map(str::trim).collect::<Vec<_>>()
    };
    assert_eq!(row("|")[1..], ["smallest", "real", "better"]);
    assert_eq!(row("processed: strict: all")[3], "higher");
    assert_eq!(row("raw: strict: all")[3], "higher");
    assert_eq!(row("processed: beat-phase error, beats")[3], "lower");
    assert!(row("processed: beat-phase error, beats")[2].starts_with("0.000"));
    assert_eq!(row("processed: diversity")[3], "near real");
    // Each row and each sentence about movement names the samples that it is about.
    let rows = lines.iter().filter(|line| line.contains('|'));
    for row in rows.skip(1) {
        let of = ["processed: ", "raw: "];
        assert!(
            of.iter().any(|of| row.trim_start().starts_with(of)),
            "{row}"
        );
    }
    assert!(lines[0].contains(" of the processed samples are within"));
    assert!(lines[2].contains(" (processed), "), "{}", lines[2]);
    let json = read(
        &sandbox,
        "runs/smallest/reports/eval-num_inference_steps=2.json",
    );
    let verdict = &evaluations(&json)[0]["verdict"];
    assert_eq!(
        format!("smallest: {}", verdict[0].as_str().expect("text")),
        lines[0]
    );
    // Noise has no beat to follow.
    let noise = sandbox.run("eval runs/smallest --steps 2 --set evaluation.cond=noise");
    assert!(!noise.succeeded().stdout.contains("follow the beat"));
}

#[test]
fn a_model_that_follows_the_beat_is_said_to() {
    let sandbox = trained();
    train(
        &sandbox,
        "beats",
        "--set model.audio_conditioning=aligned --set data.audio_features=[\"ccmotion\",\"beats\"] \
         --set model.phase_target=harmonics --set diffusion.prediction_type=sample \
         --set data.synthetic.phrases=60 --set data.target_frames=40 --set optim.learning_rate=3e-3 \
         --set train.max_steps=200 --set validation.every_steps=100 --set checkpoint.every_steps=200",
    );
    let finished = sandbox.run("eval runs/beats --steps 4").succeeded();
    let said = "beats: the samples follow the beat: beat-phase error 0.";
    assert!(finished.stdout.contains(said), "{}", finished.stdout);
}

#[test]
fn training_warns_of_a_model_that_does_not_hear_the_beat() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    let settings = "--set data.validation.fraction=0.5 --set data.target_frames=40";
    let finished = sandbox.run(&format!(
        "train c.toml --set train.max_steps=6 --quiet {settings}"
    ));
    let warning = "warning: the samples do not follow the beat: beat-phase error ";
    let said = finished.succeeded().stderr;
    assert!(said.contains(warning), "{said}");
    let again = sandbox.run("train --resume runs/smallest --quiet");
    assert_eq!(again.succeeded().stderr, "", "no step was done");
}

#[test]
fn reports_of_other_settings_are_kept() {
    let sandbox = trained();
    let run = |line: &str| sandbox.run(&format!("eval runs/smallest --steps 1 {line}"));
    for settings in ["", "--set evaluation.phrases=2", "--seed 3", ""] {
        run(settings).succeeded();
    }
    let stems = ["", "-seed=3"].map(|end| format!("eval-num_inference_steps=1{end}"));
    let few = "eval-phrases=2-num_inference_steps=1".to_owned();
    let mut files: Vec<String> = [&stems[0], &stems[1], &few]
        .into_iter()
        .flat_map(|stem| [format!("{stem}.csv"), format!("{stem}.json")])
        .collect();
    files.sort();
    assert_eq!(sandbox.list("runs/smallest/reports"), files);
    let few = read(&sandbox, &format!("runs/smallest/reports/{few}.json"));
    let few: Value = serde_json::from_str(&few).expect("JSON");
    assert_eq!(few["settings"]["evaluation.phrases"], "2");

    // In a folder of the user, a report has one name.
    run("--out here").succeeded();
    run("--out here").succeeded();
    let other = "--out here --set evaluation.phrases=2";
    run(other).failed(
        2,
        &[
            "here/eval.json is a report of other settings",
            "--overwrite",
        ],
    );
    run(&format!("{other} --overwrite")).succeeded();
    assert_eq!(sandbox.list("here"), ["eval.csv", "eval.json"]);
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
