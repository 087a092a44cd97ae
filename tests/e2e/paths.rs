//! Motion along paths, for every kind of model, measured in the written positions.

use std::fs;

use kinegrad_data::read_array;
use kinegrad_motion::humanml::{Features, Root, Skeleton};
use kinegrad_tests::captures::wav;
use kinegrad_tests::sandbox::{SMALLEST, SMALLEST_WALKS, Sandbox};
use serde_json::Value;

use crate::{compose, goals};

/// A quarter circle of 2 m that starts away from the origin with heading -x.
fn quarter() -> String {
    let point = |k: u32| {
        let (sin, cos) = (f64::from(k) * std::f64::consts::FRAC_PI_2 / 8.0).sin_cos();
        format!("[{:.5}, {:.5}]", 1.0 - 2.0 * sin, 5.0 - 2.0 * cos)
    };
    let points: Vec<String> = (0..=8).map(point).collect();
    format!("points = [{}]\n", points.join(", "))
}

/// The root's ground position in each frame of a file of joints or of phrases.
fn track(sandbox: &Sandbox, file: &str) -> Vec<[f64; 2]> {
    let array = read_array(&sandbox.path(file)).expect("an array");
    let width: usize = array.shape[1..].iter().product();
    let frames = array.values.chunks(width);
    frames
        .map(|frame| [frame[0], frame[2]].map(f64::from))
        .collect()
}

/// The largest distance of a track from the quarter circle's radius, metres.
fn off_the_circle(track: &[[f64; 2]]) -> f64 {
    let distance = |[x, z]: &[f64; 2]| ((x - 1.0).hypot(z - 5.0) - 2.0).abs();
    track.iter().map(distance).fold(0.0, f64::max)
}

fn record(sandbox: &Sandbox, file: &str) -> Value {
    let text = fs::read_to_string(sandbox.path(file)).expect("a record");
    serde_json::from_str(&text).expect("JSON")
}

/// The table of that name with a column of generated motion, wherever it is in the report.
fn within<'v>(value: &'v Value, name: &str) -> Option<&'v Value> {
    match value {
        Value::Object(table) => match table.get(name) {
            Some(found) if found.get("sampled").is_some() => Some(found),
            _ => table.values().find_map(|value| within(value, name)),
        },
        Value::Array(list) => list.iter().find_map(|value| within(value, name)),
        _ => None,
    }
}

#[test]
fn ways_of_held_out_clips_are_followed_and_measured() {
    let sandbox = compose::sandbox();
    let line = "train c.toml --set model.path=true --set paths.drop_prob=0.2 --set \
                data.augment.path_warp_prob=0.5";
    sandbox.run(line).succeeded();
    let eval = |method: &str| {
        let line = format!(
            "eval runs/bpe --json --set evaluation.num_paths=2 --set evaluation.path.method={method}"
        );
        let output = sandbox.run(&line).succeeded();
        let found: Value = serde_json::from_str(&output.stdout).expect("JSON");
        within(&found, "paths").expect("paths").clone()
    };
    let free = eval("none");
    let number = |found: &Value, key: &str| found[key].as_f64().expect("a number");
    assert_eq!(free["sampled"]["motions"], 2);
    assert!(number(&free["real"], "mean_distance") < 0.1, "{free}");
    assert!(number(&free["sampled"], "mean_error") > 0.2, "{free}");
    for method in ["override", "warp"] {
        let found = eval(method);
        assert!(
            number(&found["sampled"], "mean_distance") < 1e-3,
            "{method}: {found}"
        );
        assert_eq!(found["real"], free["real"]);
    }
    // All weights of a network without paths are fine-tuned with paths.
    sandbox
        .run("train c.toml --name plain --set train.max_steps=4")
        .succeeded();
    let line = "train c.toml --name from --set init.diffusion=runs/plain --set model.path=true --set \
                train.max_steps=4";
    sandbox.run(line).succeeded();
    sandbox
        .run(&line.replace(
            " --set train.max_steps=4",
            " --set train.max_steps=6 --resume",
        ))
        .succeeded();
    let told = eval("tokens");
    assert_ne!(told["sampled"], free["sampled"]);
    // Features and joints describe the same motion after the move.
    sandbox.write("quarter.toml", quarter());
    for method in ["warp", "override", "tokens", "tokens_warp"] {
        let line = format!(
            "sample runs/bpe --path quarter.toml --method {method} --frames 40 --out {method}"
        );
        sandbox.run(&line).succeeded();
        let joints = track(&sandbox, &format!("{method}.npy"));
        let rows = read_array(&sandbox.path(format!("{method}.features.npy"))).expect("features");
        let layout = Skeleton::humanml3d().layout();
        let features = Features::new(rows.values, layout, Root::Relative).expect("features");
        let root = features.joints().track(0);
        for t in [13, 39] {
            let gone = (joints[t][0] - joints[0][0]).hypot(joints[t][1] - joints[0][1]);
            let said = (root[t][0] - root[0][0]).hypot(root[t][2] - root[0][2]);
            assert!(
                (gone - said).abs() < 2e-3,
                "{method}, frame {t}: {gone} {said}"
            );
        }
        if method == "warp" || method == "override" {
            assert!(off_the_circle(&joints) < 0.02, "{method}");
        }
    }
    // A path beyond the legs is followed as far as they reach, and both lengths are reported.
    sandbox.write("long.toml", "points = [[0, 0], [0, 60]]\n");
    let said = sandbox
        .run("sample runs/bpe --path long.toml --method warp --frames 40 --out long")
        .succeeded();
    assert!(
        said.stderr
            .contains("asks for 60.00 m and the motion walks"),
        "{}",
        said.stderr
    );
    let gone = track(&sandbox, "long.npy");
    assert!(gone[39][1] < 30.0, "{:?}", gone[39]);
    let report = record(&sandbox, "long.json")["path"]["report"].clone();
    let travelled = report["travelled"].as_f64().expect("metres");
    assert!(
        (travelled - gone[39][1]).abs() < 0.1 && report["asked"] == 60.0,
        "{report}"
    );
    for (line, expected) in [
        (
            "train c.toml --name x --set paths.drop_prob=0.1",
            "`paths.drop_prob` is 0.1, allowed: 0 without `model.path`",
        ),
        (
            "eval runs/bpe --set evaluation.path.method=fly",
            "\"fly\" is not among none, warp",
        ),
    ] {
        sandbox.run(line).failed(2, &[expected]);
    }
}

#[test]
fn clips_of_goals_follow_a_path_from_a_file() {
    let sandbox = goals::trained();
    sandbox.write("quarter.toml", quarter());
    let sample = "sample runs/gmd_motion --path quarter.toml --frames 20 --set \
                  steering.schedule.motion_until=0";
    let said = sandbox
        .run(&format!("{sample} --out on --count 2"))
        .succeeded();
    for part in [
        "travelled",
        "from the path",
        "from its place in time",
        "lowest joint",
    ] {
        assert!(said.stdout.contains(part), "{part}: {}", said.stdout);
    }
    for name in ["on-000", "on-001"] {
        let track = track(&sandbox, &format!("{name}.npy"));
        assert_eq!(track.len(), 20);
        assert!(off_the_circle(&track) < 0.02, "{}", off_the_circle(&track));
        let [begin, end] = [track[0], track[19]];
        assert!((begin[0] - 1.0).hypot(begin[1] - 3.0) < 0.01, "{begin:?}");
        assert!((end[0] + 1.0).hypot(end[1] - 5.0) < 0.01, "{end:?}");
        let record = record(&sandbox, &format!("{name}.json"));
        assert_eq!(record["path"]["file"], "quarter.toml");
        let report = &record["path"]["report"];
        let number = |key: &str| report[key].as_f64().expect("a number");
        assert!(
            (number("asked") - std::f64::consts::PI).abs() < 0.02,
            "{report}"
        );
        assert!(
            (number("travelled") - number("asked")).abs() < 0.05,
            "{report}"
        );
        assert!(number("largest_error") < 0.02 && number("lowest_joint").is_finite());
        assert_eq!(record["condition"]["path"]["file"], "quarter.toml");
        let points = record["path"]["content"]["points"].as_array();
        assert!(points.is_some_and(|points| points.len() > 2), "{record}");
    }
    // The first stage's trajectory, which is near the path, is written next to the clip.
    let line = format!("{sample} --trajectory-run runs/gmd_trajectory --out staged");
    sandbox.run(&line).succeeded();
    let first = read_array(&sandbox.path("staged.path.npy")).expect("a path");
    assert_eq!(first.shape, [20, 2]);
    assert!(
        (f64::from(first.values[1]) - 3.0).abs() < 0.5,
        "{:?}",
        &first.values[..2]
    );
    sandbox.write("far.toml", "points = [[0, 0], [0, 400]]\n");
    let far = sandbox.run("sample runs/gmd_motion --path far.toml --frames 20 --out far");
    let said = far.failed(1, &["1 sample is not usable"]).stderr;
    assert!(said.contains("more than any motion of training"), "{said}");
    assert!(sandbox.path("far.unusable.npy").exists() && !sandbox.path("far.npy").exists());
    sandbox
        .run("sample runs/gmd_motion --path far.toml --frames 20 --out far")
        .failed(2, &["exist already"]);
    for (line, expected) in [
        (
            "sample runs/gmd_trajectory --path quarter.toml --out x",
            "`--path` with a run of recipe `gmd_trajectory`",
        ),
        (
            "sample runs/gmd_motion --path quarter.toml --goal goal.toml --out x",
            "`--path` with `--goal`",
        ),
        (
            "sample runs/gmd_motion --path quarter.toml --method tokens --out x",
            "unknown key `evaluation.path`",
        ),
        (
            "sample runs/gmd_motion --path absent.toml --out x",
            "absent.toml",
        ),
    ] {
        sandbox.run(line).failed(2, &[expected]);
    }
    assert!(!sandbox.path("x.npy").exists());
}

#[test]
fn phrases_follow_a_path_from_a_file() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox.write("song.wav", wav(6));
    sandbox.write("quarter.toml", quarter());
    sandbox.run("train c.toml").succeeded();
    let sample = "sample runs/smallest --path quarter.toml --seed 3";
    // A phrase, and a song of several windows.
    for (what, name) in [("", "phrase"), ("--audio song.wav", "song")] {
        let line = format!("{sample} {what} --out {name}");
        let said = sandbox.run(&line).succeeded();
        assert!(
            said.stdout.contains("0.000 m from the path"),
            "{}",
            said.stdout
        );
        let array = read_array(&sandbox.path(format!("{name}.npy"))).expect("a phrase");
        let track = track(&sandbox, &format!("{name}.npy"));
        assert!(off_the_circle(&track) < 0.02, "{}", off_the_circle(&track));
        for (t, pair) in track.windows(2).enumerate() {
            for (i, channel) in [(0, 3), (1, 5)] {
                let velocity = f64::from(array.values[t * 25 + channel]);
                let derived = 30.0 * (pair[1][i] - pair[0][i]);
                assert!(
                    (velocity - derived).abs() < 1e-3,
                    "frame {t}: {velocity} {derived}"
                );
            }
        }
    }
    assert_eq!(
        record(&sandbox, "song.json")["path"]["settings"]["method"],
        "override"
    );
    let error = |eta: f64| {
        let line = format!(
            "{sample} --method guidance --set evaluation.path.guidance_step_size={eta} --out guided-{eta}"
        );
        sandbox.run(&line).succeeded();
        let record = record(&sandbox, &format!("guided-{eta}.json"));
        record["path"]["report"]["mean_error"]
            .as_f64()
            .expect("metres")
    };
    let errors = [0.0, 0.05, 0.2].map(error);
    assert!(errors[0] > errors[1] && errors[1] > errors[2], "{errors:?}");
    for (line, expected) in [
        (
            "sample runs/smallest --path quarter.toml --method tokens --out x",
            "\"tokens\" is not among override, guidance",
        ),
        (
            "sample runs/smallest --path quarter.toml --continue-from phrase.npy --out x",
            "`--continue-from` with `--path`",
        ),
        (
            "train c.toml --name x --set data.augment.path_warp_prob=0.5",
            "`data.augment.path_warp_prob` is 0.5, allowed: 0 with phrases",
        ),
    ] {
        sandbox.run(line).failed(2, &[expected]);
    }
}

#[test]
fn tokens_in_other_places_and_guidance_over_the_path_change_the_motion() {
    let sandbox = compose::sandbox();
    sandbox.write("quarter.toml", quarter());
    let base = "train c.toml --set train.max_steps=4 --set ema.update_every=1 --name";
    sandbox.run(&format!("{base} plain")).succeeded();
    let mut found = Vec::new();
    for tokens in ["added", "concatenated", "rows"] {
        // An adapter with other tokens, on a network without a path, resumes bit-exactly.
        let line = format!(
            "train c.toml --name {tokens} --set train.recipe=path_adapter --set \
             init.diffusion=runs/plain --set model.path_tokens={tokens} --set ema.update_every=1 \
             --set train.max_steps="
        );
        sandbox.run(&format!("{line}6")).succeeded();
        let parts = line.replace(
            &format!("--name {tokens} "),
            &format!("--name {tokens}_parts "),
        );
        sandbox.run(&format!("{parts}4")).succeeded();
        sandbox.run(&format!("{parts}6 --resume")).succeeded();
        let weights = |run: &str| {
            let file = format!("runs/{run}/checkpoints/step-00000006/model.safetensors");
            fs::read(sandbox.path(file)).expect("weights")
        };
        assert!(
            weights(tokens) == weights(&format!("{tokens}_parts")),
            "{tokens}"
        );
        let sample = |set: &str, out: &str| {
            let line = format!(
                "sample runs/{tokens} --path quarter.toml --method tokens --frames 24 --out \
                 {tokens}{out} {set}"
            );
            sandbox.run(&line).succeeded();
            track(&sandbox, &format!("{tokens}{out}.npy"))
        };
        let along = sample("", "");
        let guided = sample("--set evaluation.path.path_guidance_scale=3", "3");
        assert_ne!(along, guided, "{tokens}");
        found.push(along);
    }
    assert!(found[0] != found[1] && found[1] != found[2] && found[0] != found[2]);
    for (set, expected) in [
        (
            "--set model.path_tokens=rows",
            "`model.path_tokens` is \"rows\"",
        ),
        (
            "--set evaluation.path.path_guidance_scale=2",
            "`evaluation.path.path_guidance_scale` is 2",
        ),
    ] {
        sandbox
            .run(&format!("train c.toml --name no {set}"))
            .failed(2, &[expected]);
    }
}

#[test]
fn a_motion_model_of_the_mdm_kind_is_conditioned_on_paths() {
    let sandbox = goals::sandbox();
    let unet = "kind = \"gmd_unet\"\nlatent_dim = 16\ndim_mults = [1.0, 1.0]\npadded_frames = 20\n";
    assert!(SMALLEST_WALKS.contains(unet));
    let mdm = "kind = \"mdm_transformer\"\nsize = \"mdm_tiny\"\n";
    sandbox.write("motion.toml", SMALLEST_WALKS.replace(unet, mdm));
    sandbox.write("quarter.toml", quarter());
    let mut tracks = Vec::new();
    for tokens in ["added", "rows"] {
        let line = format!(
            "train motion.toml --name {tokens} --set model.path=true --set \
             model.path_tokens={tokens} --set paths.drop_prob=0.3 --set train.max_steps=6 \
             --set ema.update_every=1"
        );
        sandbox.run(&line).succeeded();
        let sample = |set: &str| {
            let line = format!(
                "sample runs/{tokens} --path quarter.toml --frames 16 --out out --overwrite \
                 --allow-unusable --set steering.scale=0 --set steering.imputation=false {set}"
            );
            sandbox.run(&line).succeeded();
            track(&sandbox, "out.npy")
        };
        let along = sample("");
        let without = sample("--set steering.path_guidance_scale=0");
        let twice = sample("--set steering.path_guidance_scale=2");
        assert!(along != without && along != twice, "{tokens}");
        tracks.push(along);
    }
    assert_ne!(tracks[0], tracks[1]);
    sandbox
        .run("train motion.toml --name no --set steering.path_guidance_scale=2")
        .failed(2, &["`steering.path_guidance_scale` is 2"]);
}

#[test]
fn clips_at_another_rate_keep_it_from_training_to_the_page() {
    let sandbox = compose::sandbox();
    sandbox
        .run("train c.toml --name babel --set data.humanml3d.fps=30 --set train.max_steps=4")
        .succeeded();
    sandbox
        .run("train c.toml --name usual --set train.max_steps=4")
        .succeeded();
    // A second has 30 frames, and a path at 1 m/s has steps of 1/30 m.
    sandbox.write(
        "line.toml",
        "points = [[0, 0], [0, 9]]\ncurve = 'line'\nspeed = 1\n",
    );
    let step = |run: &str, frames: usize| {
        let line =
            format!("sample runs/{run} --seconds 1 --path line.toml --method override --out {run}");
        sandbox.run(&line).succeeded();
        let track = track(&sandbox, &format!("{run}.npy"));
        assert_eq!(track.len(), frames);
        (track[9][1] - track[8][1]).abs()
    };
    assert!((step("babel", 30) - 1.0 / 30.0).abs() < 1e-3);
    assert!((step("usual", 20) - 1.0 / 20.0).abs() < 1e-3);
    assert_eq!(record(&sandbox, "babel.json")["fps"], 30.0);
    // The page plays at the rate of the record, also features; an option has the last word.
    let rate = |line: &str| {
        sandbox
            .run(&format!("view {line} --out page.html --overwrite"))
            .succeeded();
        let page = fs::read_to_string(sandbox.path("page.html")).expect("a page");
        let at = page.find("\"fps\":").expect("a rate") + 6;
        let end = at + page[at..].find([',', '}']).expect("an end");
        page[at..end].parse::<f64>().expect("a number")
    };
    assert_eq!(rate("babel.npy"), 30.0);
    assert_eq!(rate("babel.features.npy"), 30.0);
    assert_eq!(rate("usual.npy"), 20.0);
    assert_eq!(rate("usual.npy --fps 25"), 25.0);
    // Measures: the same positions are 1.5 times as fast at 30 frames per second.
    fs::copy(sandbox.path("usual.npy"), sandbox.path("alone.npy")).expect("copied");
    let speed = |fps: &str| {
        let line = format!(
            "warp alone.npy --path line.toml --along own --json --allow-unusable --overwrite --out moved {fps}"
        );
        let said = sandbox.run(&line).succeeded();
        let found: Value = serde_json::from_str(&said.stdout).expect("JSON");
        found["before"]["jerk"].as_f64().expect("a number")
    };
    let ratio = speed("--fps 30") / speed("--fps 20");
    assert!((ratio / 1.5f64.powi(3) - 1.0).abs() < 1e-6, "{ratio}");
    sandbox
        .run("train c.toml --name no --set data.humanml3d.fps=0")
        .failed(2, &["`data.humanml3d.fps` is 0"]);
}
