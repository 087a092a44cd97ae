//! Other prediction targets for phase and orientation, statistics of crops, and the selection of
//! the best step and of a fine-tuning's split.

use std::fs;
use std::path::Path;

use kinegrad_data::read_motion;
use kinegrad_motion::phrase::PHASE;
use kinegrad_tests::sandbox::{SMALLEST, Sandbox};
use serde_json::Value;

/// Every option of this page. Clips of 10 to 24 frames give batches of different lengths.
const OPTIONS: &str = "--set model.phase_target=sin_cos --set model.orientation_target=rotation_6d \
    --set data.statistics=crops --set data.augment.rotate_yaw=true \
    --set data.augment.min_frames=10 --set optim.weight_decay_groups=matrices";

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
}

fn base(name: &str, settings: &str) -> String {
    format!(
        "train c.toml --name {name} --set train.max_steps=8 --set validation.every_steps=4 \
         {settings}"
    )
}

fn decoder(name: &str, settings: &str) -> String {
    format!(
        "train c.toml --name {name} --set train.recipe=decoder --set init.diffusion=runs/base \
         --set decoder.hidden_dim=32 --set rollout.steps=3 --set train.max_steps=6 {settings}"
    )
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).expect("a file")).expect("JSON")
}

/// `state.json` of the last checkpoint.
fn state(run: &Path) -> Value {
    let folder = fs::read_dir(run.join("checkpoints")).expect("checkpoints");
    let mut steps: Vec<_> = folder
        .map(|entry| entry.expect("an entry").path())
        .collect();
    steps.retain(|path| path.is_dir());
    steps.sort();
    json(&steps.last().expect("a checkpoint").join("state.json"))
}

fn metrics(run: &Path) -> Vec<Value> {
    let text = fs::read_to_string(run.join("metrics.jsonl")).expect("metrics");
    let lines = text.lines();
    lines
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect()
}

/// Motion of 25 channels with a phase in the bar and quaternions of one continuous sign.
fn assert_stored_channels(path: &Path, frames: usize) {
    let motion = read_motion(path).expect("a motion");
    assert_eq!(motion.frames(), frames);
    assert_eq!(motion.first_non_finite(), None);
    for t in 0..frames {
        assert!((0.0..1.0).contains(&motion.frame(t)[PHASE]), "frame {t}");
        assert!(
            (motion.quaternion(t).norm() - 1.0).abs() < 1e-4,
            "frame {t}"
        );
        if t > 0 {
            assert!(motion.quaternion(t).dot(motion.quaternion(t - 1)) >= 0.0);
        }
    }
}

#[test]
fn all_recipes_train_on_targets_and_files_keep_25_channels() {
    let sandbox = sandbox();
    sandbox.run(&base("base", OPTIONS)).succeeded();
    let found = state(&sandbox.path("runs/base"));
    let channels = |statistics: &str| found[statistics]["mean"].as_array().map(Vec::len);
    assert_eq!(channels("statistics"), Some(25));
    assert_eq!(channels("network_statistics"), Some(28));
    sandbox
        .run("sample runs/base --frames 17 --steps 4 --out base")
        .succeeded();
    assert_stored_channels(&sandbox.path("base.raw.npy"), 17);
    assert_stored_channels(&sandbox.path("base.npy"), 17);

    let augment = "--set data.augment.min_frames=10 --set data.augment.rotate_yaw=true";
    sandbox.run(&decoder("decoder", augment)).succeeded();
    let tuning = format!(
        "train c.toml --name tuned --set train.recipe=e2e --set init.diffusion=runs/base \
         --set init.decoder=runs/decoder --set rollout.steps=3 --set train.max_steps=4 \
         --set decoder.coherence=projection --set lora.rank=2 {augment}"
    );
    sandbox.run(&tuning).succeeded();
    let tuned = state(&sandbox.path("runs/tuned"));
    assert_eq!(tuned["config"]["model"]["phase_target"], "sin_cos");
    assert_eq!(
        tuned["config"]["model"]["orientation_target"],
        "rotation_6d"
    );
    for statistics in ["mean", "std"] {
        let network = |state: &Value| state["network_statistics"][statistics].clone();
        assert_eq!(network(&tuned), network(&found), "{statistics}");
    }
    for line in metrics(&sandbox.path("runs/tuned")) {
        for (key, value) in line.as_object().expect("a table") {
            assert!(value.as_f64().is_some_and(f64::is_finite), "{key}: {value}");
        }
    }
    sandbox
        .run("sample runs/tuned --frames 17 --steps 4 --out tuned")
        .succeeded();
    assert_stored_channels(&sandbox.path("tuned.raw.npy"), 17);
    sandbox
        .run("eval runs/tuned --set sampling.sampler.num_inference_steps=3")
        .succeeded();
    sandbox
        .run("merge runs/tuned --out runs/merged")
        .succeeded();
    sandbox
        .run("sample runs/merged --frames 17 --steps 4 --out merged")
        .succeeded();
    assert_stored_channels(&sandbox.path("merged.raw.npy"), 17);
}

#[test]
fn a_canonical_sample_begins_facing_z() {
    let sandbox = sandbox();
    let settings = "--set model.orientation_target=canonical_quaternion";
    sandbox.run(&base("base", settings)).succeeded();
    sandbox
        .run("sample runs/base --steps 4 --out dance")
        .succeeded();
    let motion = read_motion(&sandbox.path("dance.raw.npy")).expect("a motion");
    for t in 0..motion.frames() {
        assert!((motion.quaternion(t).norm() - 1.0).abs() < 1e-5);
    }
    assert!(motion.quaternion(0).w >= 0.0);
    let found = state(&sandbox.path("runs/base"));
    let range = ["min", "max"].map(|end| found["network_statistics"][end][9].as_f64().unwrap());
    assert!(range[0] > -1.0 && range[1] <= 1.0, "{range:?}");
}

#[test]
fn runs_without_the_options_hold_one_set_of_statistics() {
    let sandbox = sandbox();
    sandbox.run(&base("base", "")).succeeded();
    let found = state(&sandbox.path("runs/base"));
    assert!(found.get("network_statistics").is_none());
    assert!(found["progress"].get("best_score").is_none());
    // A config without these options.
    let path = sandbox.path("runs/base/config.toml");
    let text = fs::read_to_string(&path).expect("a config");
    let new = [
        "_target = ",
        "statistics = ",
        "weight_decay_groups",
        "select_",
    ];
    let old: Vec<&str> = text
        .lines()
        .filter(|line| !new.iter().any(|key| line.contains(key)))
        .collect();
    assert_eq!(text.lines().count(), old.len() + 6, "{text}");
    fs::write(&path, old.join("\n")).expect("written");
    let longer = base("base", "").replace("max_steps=8", "max_steps=10");
    sandbox.run(&format!("{longer} --resume")).succeeded();
    sandbox
        .run("sample runs/base --steps 3 --out dance")
        .succeeded();
}

#[test]
fn options_that_do_not_go_together_are_refused_in_words() {
    let sandbox = sandbox();
    sandbox.run(&base("base", OPTIONS)).succeeded();
    let flips = "--set data.augment.flip_quaternion=true --set \
                 model.orientation_target=rotation_6d";
    sandbox.run(&base("x", flips)).failed(
        2,
        &[
            "`data.augment.flip_quaternion` is true",
            "q and -q are one rotation",
        ],
    );
    let turns = "--set data.augment.rotate_yaw=true --set \
                 model.orientation_target=canonical_quaternion";
    sandbox.run(&base("x", turns)).failed(
        2,
        &["`data.augment.rotate_yaw` is true", "turned to face +z"],
    );
    sandbox
        .run(&decoder("x", "--set model.phase_target=scalar"))
        .failed(
            2,
            &["`model.phase_target` is \"scalar\", allowed: \"sin_cos\""],
        );
    let narrow = "--set decoder.hidden_dim=27";
    sandbox
        .run(&decoder("x", narrow).replace("--set decoder.hidden_dim=32", ""))
        .failed(2, &["`decoder.hidden_dim` is 27"]);
    sandbox
        .run(&base("x", "--set validation.select_samples=1"))
        .failed(2, &["`validation.select_samples` is 1"]);
    let one = "--set validation.select_by=frechet --set \
               data.validation.patterns=[\"synthetic_00003\"]";
    sandbox
        .run(&base("x", one))
        .failed(2, &["`validation.select_by`", "one phrase is held out"]);
    assert!(!sandbox.path("runs/x").exists());
}

#[test]
fn a_start_that_training_makes_worse_stays_the_best() {
    let sandbox = sandbox();
    sandbox.run(&base("base", "")).succeeded();
    let ruin = "--set optim.learning_rate=0.1 --set optim.warmup_steps=0 \
                --set validation.every_steps=2";
    sandbox.run(&decoder("ruined", ruin)).succeeded();
    let lines = metrics(&sandbox.path("runs/ruined"));
    let losses: Vec<f64> = lines
        .iter()
        .filter_map(|l| l["val_loss"].as_f64())
        .collect();
    assert!(
        losses[1..].iter().all(|loss| *loss > losses[0]),
        "{losses:?}"
    );
    let best = json(&sandbox.path("runs/ruined/checkpoints/best.json"));
    assert_eq!(best["step"], 0);
    let start = sandbox.path("runs/ruined/checkpoints/step-00000000");
    assert!(start.join("ema.safetensors").exists());
    let drawn = sandbox
        .run("sample runs/ruined --steps 3 --out dance")
        .succeeded();
    let record = json(&sandbox.path("dance.json"));
    assert_eq!(record["step"], 0, "{} {record}", drawn.stderr);
}

#[test]
fn the_best_step_may_be_that_of_the_best_samples() {
    let sandbox = sandbox();
    let settings = "--set data.validation.fraction=0.4 --set train.max_steps=24 \
                    --set sampling.sampler.num_inference_steps=3";
    for (by, metric) in [("frechet", "val_frechet"), ("diversity", "val_diversity")] {
        let select = format!("--set validation.select_by={by} --set validation.select_samples=3");
        let settings = format!("{settings} {select}").replace("max_steps=8", "");
        sandbox.run(&base(by, &settings)).succeeded();
        let lines = metrics(&sandbox.path(format!("runs/{by}")));
        let measured: Vec<(u64, f64)> = lines
            .iter()
            .filter_map(|line| Some((line["step"].as_u64()?, line[metric].as_f64()?)))
            .collect();
        assert_eq!(measured.len(), 6, "{measured:?}");
        let best = json(&sandbox.path(format!("runs/{by}/checkpoints/best.json")));
        if by == "frechet" {
            let least = measured.iter().min_by(|a, b| a.1.total_cmp(&b.1));
            assert_eq!(
                best["step"].as_u64(),
                least.map(|least| least.0),
                "{measured:?}"
            );
        }
        let progress = &state(&sandbox.path(format!("runs/{by}")))["progress"];
        assert!(progress["best_score"].is_number(), "{progress}");
    }
}

#[test]
fn fine_tuning_holds_out_what_its_base_did_or_says_what_leaks() {
    let sandbox = sandbox();
    let held = "--set data.validation.patterns=[\"synthetic_00002\",\"synthetic_00005\"]";
    sandbox.run(&base("base", held)).succeeded();
    let quiet = sandbox.run(&decoder("alike", "")).succeeded();
    assert!(!quiet.stderr.contains("was trained on"), "{}", quiet.stderr);
    let patterns = &state(&sandbox.path("runs/alike"))["config"]["data"]["validation"]["patterns"];
    assert_eq!(patterns.as_array().map(Vec::len), Some(2), "{patterns}");

    let other = "--set data.validation.patterns=[\"synthetic_00002\",\"synthetic_00007\"]";
    let told = sandbox.run(&decoder("other", other)).succeeded().stderr;
    let words: Vec<&str> = told.split_whitespace().collect();
    let told = words.join(" ");
    let expected = "`init.diffusion` was trained on 1 of the 2 phrases that are held out here";
    assert!(told.contains(expected), "{told}");
    assert!(told.contains("synthetic_00007"), "{told}");
    assert!(!told.contains("synthetic_00002"), "{told}");

    // Phrases of another seed differ, whatever their names.
    let made = format!("{other} --set data.synthetic.seed=77");
    let quiet = sandbox.run(&decoder("made", &made)).succeeded();
    assert!(!quiet.stderr.contains("was trained on"), "{}", quiet.stderr);
}

#[test]
fn other_phrases_of_a_held_out_song_are_told_too() {
    let sandbox = sandbox();
    sandbox
        .run("data synth --out set --phrases 6 --frames 40")
        .succeeded();
    // Three songs of two phrases.
    for folder in ["motion", "audio_features"] {
        for name in sandbox.list(&format!("set/{folder}")) {
            let number = name.trim_matches(|c: char| !c.is_ascii_digit());
            let number: u32 = number.parse().expect("a number");
            let song = ["A_1", "B_2", "C_3"][number as usize / 2];
            let renamed = name.replace(
                &format!("synthetic_{number:05}"),
                &format!("{song}_{:05}", 10 * number),
            );
            let [from, to] = [&name, &renamed].map(|name| format!("set/{folder}/{name}"));
            fs::rename(sandbox.path(from), sandbox.path(to)).expect("renamed");
        }
    }
    let data = |held_out: &str| {
        format!(
            "--set data.kind=phrases --set data.source=set \
             --set data.validation.patterns=[{held_out}]"
        )
    };
    let settings = data("\"B_2_00020\",\"A_1_*\"");
    sandbox.run(&base("base", &settings)).succeeded();
    let told = |name: &str, held_out: &str| {
        let told = sandbox.run(&decoder(name, &data(held_out))).succeeded();
        let words: Vec<&str> = told.stderr.split_whitespace().collect();
        words.join(" ")
    };
    let found = told("phrases", "\"B_*\"");
    let expected = "was trained on 1 of the 2 phrases that are held out here";
    assert!(found.contains(expected), "{found}");
    let found = told("songs", "\"B_2_00020\",\"A_1_00000\"");
    let expected = "was trained on other phrases of 1 of the 2 songs that are held out here";
    assert!(
        found.contains(expected) && found.contains(": B_2."),
        "{found}"
    );
    let found = told("new", "\"A_1_00000\"");
    assert!(!found.contains("was trained on"), "{found}");
}

#[test]
fn samples_longer_than_training_saw_are_drawn_in_windows_or_told() {
    let sandbox = sandbox();
    sandbox.run(&base("base", "")).succeeded();
    let drawn = sandbox
        .run("sample runs/base --frames 40 --steps 3 --out long")
        .succeeded();
    assert!(!drawn.stderr.contains("training saw"), "{}", drawn.stderr);
    let record = json(&sandbox.path("long.json"));
    assert_eq!(
        (&record["frames"], &record["windows"]["frames"]),
        (&40.into(), &24.into())
    );
    // Windows with independent headings do not fit together.
    let headings = "--set model.orientation_target=canonical_quaternion";
    sandbox.run(&base("headings", headings)).succeeded();
    let told = sandbox
        .run("sample runs/headings --frames 40 --steps 3 --out turned")
        .succeeded();
    let words: Vec<&str> = told.stderr.split_whitespace().collect();
    let expected = "1 of 1 samples are of 40 frames, and training saw at most 24 frames";
    assert!(words.join(" ").contains(expected), "{}", told.stderr);
    let quiet = sandbox
        .run("sample runs/base --frames 24 --steps 3 --out short")
        .succeeded();
    assert!(!quiet.stderr.contains("training saw"), "{}", quiet.stderr);
}
