//! `kinegrad sample`: records, existing files, missing conditions, Ctrl-C, verbosity.

use kinegrad_tests::sandbox::{SMALLEST, SMALLEST_WALKS, Sandbox, contents, wait_for};
use serde_json::Value;

/// A sandbox with a trained run.
fn trained(config: &str, settings: &str) -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    // As short as the trainings.
    let config = config.replace("warmup_steps = 5", "warmup_steps = 1");
    sandbox.write("c.toml", config);
    let train = format!("train c.toml --set train.max_steps=2 {settings}");
    sandbox.run(&train).succeeded();
    sandbox
}

fn record(sandbox: &Sandbox, file: &str) -> Value {
    let text = std::fs::read_to_string(sandbox.path(file)).expect("a record");
    serde_json::from_str(&text).expect("JSON")
}

#[test]
fn a_record_says_how_a_sample_was_made_and_makes_it_again() {
    let sandbox = trained(
        SMALLEST,
        "--set sampling.count_at_end=2 --set data.target_frames=40",
    );
    let drawn = sandbox
        .run("sample runs/smallest --out d --steps 3 --seed 7 --guidance-scale 1.5")
        .succeeded();
    assert_eq!(drawn.stdout, "d.npy\nd.raw.npy\nd.json\n");
    let last = drawn.stderr.lines().last();
    assert_eq!(last, Some("to play: kinegrad view d.npy"));
    let record = record(&sandbox, "d.json");
    let phrase = record["condition"]["item"]["id"]
        .as_str()
        .expect("a phrase");
    assert!(
        drawn.stderr.contains(&format!(
            "no condition given: using held-out phrase {phrase}"
        )),
        "{}",
        drawn.stderr
    );
    assert_eq!(record["run"], "smallest");
    assert_eq!(
        record["checkpoint"],
        "runs/smallest/checkpoints/step-00000002"
    );
    assert_eq!((&record["step"], &record["seed"]), (&2.into(), &7.into()));
    assert_eq!(
        (&record["frames"], &record["fps"]),
        (&40.into(), &30.0.into())
    );
    assert_eq!(
        (&record["system"], &record["weights"]),
        (&"cc_motion".into(), &"ema".into())
    );
    assert_eq!(record["sampler"]["num_inference_steps"], 3);
    assert_eq!(record["sampler"]["guidance_scale"], 1.5);
    assert_eq!(record["post_processing"]["normalize_quaternions"], true);
    // The recorded command samples the same again.
    let again = format!(
        "sample {} --item {phrase} --out again --steps 3 --seed 7 --guidance-scale 1.5 -q",
        record["checkpoint"].as_str().expect("a path")
    );
    let again = sandbox.run(&again).succeeded();
    // A model of two steps moves unlike its training phrases.
    let failed = record["phrase"]["failed"].as_array().expect("a list");
    let jerk = &record["phrase"]["measures"]["path_jerk"];
    assert!(jerk["value"].as_f64() > jerk["training"][1].as_f64());
    let warning = again.stderr.trim_end();
    let first = failed[0].as_str().expect("a text");
    let beginning = format!("warning: the sample is out of bounds: {first}; ");
    assert!(warning.starts_with(&beginning), "{warning}");
    assert_eq!(warning.lines().count(), 1, "{warning}");
    let [one, other] = ["d.npy", "again.npy"].map(|file| std::fs::read(sandbox.path(file)));
    assert_eq!(one.expect("a file"), other.expect("a file"));
    // Samples at the end of training have records too, which reproduce them.
    let held_out = sandbox.list("runs/smallest/samples");
    let records = held_out
        .iter()
        .filter_map(|name| name.strip_suffix(".json"));
    let mut compared = 0;
    for stem in records {
        let file = format!("runs/smallest/samples/{stem}");
        let record = self::record(&sandbox, &format!("{file}.json"));
        assert_eq!(record["condition"]["item"]["id"], stem);
        assert_eq!(record["index"], 0);
        let again = format!(
            "sample {} --item {stem} --out again-{stem} --steps {} --seed {}",
            record["checkpoint"].as_str().expect("a path"),
            record["sampler"]["num_inference_steps"],
            record["seed"],
        );
        sandbox.run(&again).succeeded();
        let [one, other] = [format!("{file}.npy"), format!("again-{stem}.npy")]
            .map(|file| std::fs::read(sandbox.path(&file)).expect("a file"));
        assert_eq!(one, other, "{stem}");
        compared += 1;
    }
    assert_eq!(compared, 2, "{held_out:?}");
}

#[test]
fn files_that_exist_are_not_replaced_unless_asked_for() {
    let sandbox = trained(SMALLEST, "");
    let draw = "sample runs/smallest --steps 2";
    sandbox.write("d-001.raw.npy", "mine");
    sandbox.write("d.npy", "mine too");
    sandbox.write("d-007.json", "and this");
    let before = sandbox.list(".");
    sandbox
        .run(&format!("{draw} --count 2 --out d"))
        .failed(2, &["d-001.raw.npy exists already", "--overwrite"]);
    sandbox
        .run(&format!("{draw} --out d"))
        .failed(2, &["d.npy exists already: nothing was sampled"]);
    assert_eq!(sandbox.list("."), before);
    let drawn = format!("{draw} --count 2 --out d --overwrite --json");
    let drawn = sandbox.run(&drawn).succeeded();
    let json: Value = serde_json::from_str(&drawn.stdout).expect("one JSON object");
    let samples = json["samples"].as_array().expect("a list");
    assert_eq!(samples.len(), 2);
    for (index, sample) in samples.iter().enumerate() {
        let stem = format!("d-{index:03}");
        let files = [".npy", ".raw.npy", ".json"].map(|ending| format!("{stem}{ending}"));
        assert_eq!(sample["files"], Value::from(files.to_vec()));
        assert_eq!(sample["record"], record(&sandbox, &format!("{stem}.json")));
        assert_eq!(sample["record"]["index"], index);
    }
    // Files of other names stay as they are.
    let kept = std::fs::read(sandbox.path("d-007.json")).expect("a file");
    assert_eq!(kept, b"and this");
}

#[test]
fn an_impossible_goal_draws_a_warning_in_words() {
    let sandbox = trained(SMALLEST_WALKS, "");
    sandbox.write(
        "goal.toml",
        "frames = 16\n[[keyframe]]\nframe = 5\nx = 0.0\nz = 0.1\n[[keyframe]]\nframe = 15\nx = 0.0\n\
         z = 100.1\n[[obstacle]]\nkind = \"disc\"\nx = 0.0\nz = 100.0\nradius = 1.0\n",
    );
    let drawn = sandbox
        .run("sample runs/smallest --goal goal.toml --steps 2 --out far -q --allow-unusable")
        .succeeded();
    for part in [
        "warning: goal.toml: from keyframe[0] (frame 5) to keyframe[1] (frame 15) it is 100.0 m in \
         0.50 s, 200.0 m/s",
        "keyframe[1] (frame 15) is 0.90 m inside obstacle[0]",
    ] {
        assert!(drawn.stderr.contains(part), "{}", drawn.stderr);
    }
    let record = record(&sandbox, "far.json");
    assert_eq!(record["condition"]["goal"]["file"], "goal.toml");
    assert_eq!(
        (&record["system"], &record["frames"]),
        (&"gmd".into(), &16.into())
    );
    assert!(record["sampler"]["steering"].is_object(), "{record}");
    let files = ["far.bvh", "far.features.npy", "far.json", "far.npy"];
    assert_eq!(
        drawn
            .stdout
            .lines()
            .filter(|line| files.contains(line))
            .count(),
        4
    );
    sandbox.write(
        "near.toml",
        "frames = 16\n[[keyframe]]\nframe = 15\nx = 0.0\nz = 0.5\n",
    );
    let near = sandbox
        .run("sample runs/smallest --goal near.toml --steps 2 --out near -q --allow-unusable")
        .succeeded();
    assert!(!near.stderr.contains("near.toml"), "{}", near.stderr);
}

#[test]
fn ctrl_c_ends_the_drawing_soon_and_leaves_whole_samples() {
    let sandbox = trained(SMALLEST, "");
    let mut drawing = sandbox.start("sample runs/smallest --steps 2 --count 1000000 --out s/d");
    wait_for(&mut drawing, "samples", || sandbox.list("s").len() > 6);
    let id = drawing.id().to_string();
    let sent = std::process::Command::new("kill")
        .args(["-INT", &id])
        .status();
    assert!(sent.expect("kill").success());
    let asked = std::time::Instant::now();
    let status = drawing.wait().expect("an end");
    assert_eq!(status.code(), Some(130));
    assert!(asked.elapsed().as_secs() < 10, "{:?}", asked.elapsed());
    let names = sandbox.list("s");
    assert_eq!(names.len() % 3, 0, "{names:?}");
    assert!(names.iter().all(|name| !name.contains("tmp")), "{names:?}");
}

#[test]
fn the_saved_config_wins_on_resume() {
    let sandbox = trained(SMALLEST, "");
    let metrics = || std::fs::read(sandbox.path("runs/smallest/metrics.jsonl")).expect("metrics");
    let before = metrics();
    // The file has 40 steps, the run was started with 2.
    let resumed = sandbox.run("train c.toml --resume").succeeded();
    for part in [
        "warning: `train.max_steps` is 40 in c.toml and 2 in the run's saved config",
        "--set train.max_steps=40",
    ] {
        assert!(resumed.stderr.contains(part), "{}", resumed.stderr);
    }
    assert!(
        resumed.stdout.contains("finished before"),
        "{}",
        resumed.stdout
    );
    assert_eq!(metrics(), before);
    // A forbidden change is refused, and the error names the command without the file.
    sandbox
        .run("train c.toml --resume --set optim.warmup_steps=2")
        .failed(
            2,
            &[
                "`optim.warmup_steps` is 2",
                "`kinegrad train` with `--resume RUN`",
            ],
        );
    // Without a config, from any folder.
    std::fs::remove_file(sandbox.path("c.toml")).expect("the config");
    let resumed = sandbox.run("train --resume runs/smallest -q").succeeded();
    assert_eq!(resumed.stderr, "");
    let json = sandbox
        .run("train --resume runs/smallest/ --set train.max_steps=5 --json")
        .succeeded();
    let summary: Value = serde_json::from_str(&json.stdout).expect("one line of JSON");
    assert_eq!(
        (&summary["steps"], &summary["ended"]),
        (&5.into(), &"finished".into())
    );
    // Earlier settings stay.
    let again = sandbox
        .run("train --resume runs/smallest --json")
        .succeeded();
    let summary: Value = serde_json::from_str(&again.stdout).expect("one line of JSON");
    assert_eq!(
        (&summary["max_steps"], &summary["ended"]),
        (&5.into(), &"finished_before".into())
    );
    // A folder of another name is the same run.
    std::fs::rename(sandbox.path("runs/smallest"), sandbox.path("moved")).expect("a rename");
    sandbox
        .run("train --resume moved --set train.max_steps=6")
        .succeeded();
    assert!(!sandbox.path("runs/smallest").exists());
    sandbox
        .run("train --resume moved --set model.size=small")
        .failed(2, &["`model.", "may differ"]);
    sandbox
        .run("train --resume nowhere")
        .failed(2, &["nowhere", "hint:"]);
    sandbox.run("train --resume").failed(2, &["without a run"]);
    sandbox
        .run("train --resume moved --name other")
        .failed(2, &["`--name` with `--resume moved`"]);
}

#[test]
fn a_dry_run_says_what_a_run_would_take_and_writes_nothing() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    let before = contents(&sandbox.path("."));
    let plan = sandbox.run("train c.toml --dry-run").succeeded();
    for part in [
        "113,593 parameters",
        "memory",
        "time for a step",
        "time for all",
        "disk",
        "held out",
    ] {
        assert!(plan.stdout.contains(part), "{}", plan.stdout);
    }
    let json = sandbox.run("train c.toml --dry-run --json").succeeded();
    let plan: Value = serde_json::from_str(&json.stdout).expect("one line of JSON");
    assert!(plan["step_seconds"].as_f64().expect("measured") > 0.0);
    assert_eq!(plan["train_items"], 10);
    // With a base model and a decoder trained first, the last training is estimated too.
    let e2e = "train c.toml --dry-run --json --set train.recipe=e2e --set data.target_frames=16 \
               --set rollout.steps=2 --set lora.rank=2";
    let plan = sandbox.run(e2e).succeeded();
    assert!(
        plan.stderr.contains("a base model is trained first"),
        "{}",
        plan.stderr
    );
    let plan: Value = serde_json::from_str(&plan.stdout).expect("one line of JSON");
    let count = &plan["parameters"];
    assert!(count["trained"].as_u64() < count["all"].as_u64(), "{count}");
    assert!(count["adapters"].as_u64() > Some(0), "{count}");
    sandbox
        .run("train c.toml --dry-run --set optim.learning_rate=-1")
        .failed(2, &["optim.learning_rate"]);
    assert!(
        contents(&sandbox.path(".")) == before,
        "something was written"
    );
    // The checkpoint has the estimated size.
    sandbox
        .run("train c.toml --set train.max_steps=2")
        .succeeded();
    let json = sandbox
        .run("train c.toml --dry-run --json --resume")
        .succeeded();
    let plan: Value = serde_json::from_str(&json.stdout).expect("one line of JSON");
    let files = contents(&sandbox.path("runs/smallest/checkpoints/step-00000002"));
    let size: usize = files.iter().map(|(_, bytes)| bytes.len()).sum();
    let planned = plan["checkpoint_bytes"].as_u64().expect("a size") as f64;
    assert!(
        (size as f64 / planned - 1.0).abs() < 0.1,
        "{size}, {planned}"
    );
    assert_eq!(plan["step_seconds"], Value::Null);
}

#[test]
fn all_counts_of_parameters_agree() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox.write("walks.toml", SMALLEST_WALKS);
    let tuned = "--set train.recipe=e2e --set rollout.steps=2";
    for arguments in [
        "c.toml".to_string(),
        "walks.toml".to_string(),
        "walks.toml --set train.recipe=gmd_trajectory".to_string(),
        format!("c.toml {tuned}"),
        format!("c.toml {tuned} --set lora.rank=2"),
    ] {
        let shown = sandbox.run(&format!("config show {arguments}")).succeeded();
        let first = shown.stdout.lines().next().unwrap_or_default();
        let count = first.strip_prefix("# model: ").expect("a count");
        let plan = sandbox
            .run(&format!("train {arguments} --dry-run"))
            .succeeded();
        assert!(
            plan.stdout.contains(count),
            "{arguments}: {count}\n{}",
            plan.stdout
        );
    }
}

#[test]
fn a_quiet_command_prints_results_and_a_verbose_one_what_it_reads() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    let quiet = sandbox
        .run("train c.toml --set train.max_steps=2 --set optim.warmup_steps=1 --quiet")
        .succeeded();
    assert_eq!(quiet.stderr, "");
    assert!(quiet.stdout.contains("finished"), "{}", quiet.stdout);
    let verbose = "train c.toml --set train.max_steps=2 --name other -v";
    let verbose = sandbox.run(verbose).succeeded();
    for part in [
        "debug: reading c.toml",
        "debug: device cpu",
        "debug: checkpoint of step 2 written",
    ] {
        assert!(verbose.stderr.contains(part), "{part}: {}", verbose.stderr);
    }
    sandbox
        .run("-q train nowhere.toml")
        .failed(2, &["error: ", "hint:"]);
    let mut command = sandbox.command(["config", "show", "c.toml"]);
    command.env("RUST_LOG", "kinegrad_train=debug");
    let shown = kinegrad_tests::sandbox::finish(command).succeeded();
    assert!(
        shown.stderr.contains("debug: reading c.toml"),
        "{}",
        shown.stderr
    );
}
